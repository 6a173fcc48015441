"""Registration of the laws and shapes of cellmig."""

from __future__ import annotations

from . import cues, geometry, model
from .case.registry import discover


def register() -> None:
    """Import every module of laws and shapes, which registers them; a second call has no effect."""
    discover(model)
    discover(geometry)
    discover(cues)
