"""Triangles in well-known text, "TIN (((0 0, 1 0, 0 1, 0 0)), …)", read in a time linear in the length of the text."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..case.messages import show


def read(path: str) -> Any:
    """Triangles of a file as a meshio.Mesh; each has three points of its own.

    Raises ValueError, OSError and UnicodeDecodeError; the message is for the user.
    """
    import meshio

    with open(path, encoding="utf-8-sig") as stream:
        text = " ".join(stream.read().split())  # one blank between words
    for mark in "(),":
        text = text.replace(f" {mark}", mark).replace(f"{mark} ", mark)
    head, _, body = text.partition("(")
    if head.rpartition(";")[2].upper() not in ("TIN", "TIN Z", "TINZ"):
        raise ValueError(f"it holds {show(head)}, not TIN, which is the triangles of well-known text")
    *found, end = body.split("))")
    if end != ")":
        raise ValueError("it does not end with ')))', as TIN does")
    points = [c for n, triangle in enumerate(found, 1) for c in _corners(triangle.removeprefix("," * (n > 1)), n)]
    if len({len(point) for point in points}) > 1:
        raise ValueError("some of its points have two coordinates, others three")
    return meshio.Mesh(np.array(points), [("triangle", np.arange(len(points)).reshape(-1, 3))])


def _corners(text: str, n: int) -> list[list[float]]:
    """The three corners of the n-th triangle, of which `text` is "((x y, x y, x y, x y"."""
    try:
        corners = [[float(number) for number in corner.split()] for corner in text.removeprefix("((").split(",")]
    except ValueError as error:
        raise ValueError(f"triangle {n}: {error}") from None
    sizes = {len(corner) for corner in corners}
    if not text.startswith("((") or len(corners) != 4 or corners[0] != corners[3] or sizes not in ({2}, {3}):
        raise ValueError(f"triangle {n} is not written as ((x y, x y, x y, x y)), closed: {show(text)}")
    return corners[:3]
