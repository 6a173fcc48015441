"""The laws and shapes that come with cellmig."""

from __future__ import annotations

from . import geometry, model
from .case.registry import discover


def register() -> None:
    """Import every module of a law or a shape, whereby it registers itself; a second call costs nothing."""
    discover(model)
    discover(geometry)
