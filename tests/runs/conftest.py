"""What tests of reports before a run share."""

from __future__ import annotations

import pytest

from cellmig.runs import preflight, timed, trial


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports take a few steps to measure: for tests of what they say, not of how well they measure."""
    for module, least in ((preflight, {"PATIENCE": 0.0, "TRIAL": 2}), (trial, {"GROWING": 1e9}),
                          (timed, {"STEPS": 2e4})):
        for name, value in least.items():
            monkeypatch.setattr(module, name, value)
