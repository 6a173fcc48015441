"""OBJ files (Wavefront): faces between points, by the name of their object and groups.

meshio refuses those with normals, which most have, and counts no points from the end.
"""

from __future__ import annotations

from itertools import groupby
from typing import Any

import numpy as np


def read(path: str) -> Any:
    """Mesh of the faces in an OBJ file; its cell sets are objects and groups.

    Raises ValueError for a line that cannot be read; the message is for the user.
    """
    import meshio

    points: list[list[float]] = []
    faces: list[tuple[list[int], tuple]] = []
    of: dict[str, tuple] = {"o": (), "g": ()}
    with open(path, encoding="utf-8", errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            key, *words = line.split() or [""]
            try:
                if key == "v":
                    points.append([float(word) for word in words[:3]])
                    if len(points[-1]) != len(points[0]) or len(words) < 2:
                        raise ValueError("a point has as many coordinates as the first one, two or three")
                elif key == "f":
                    if len(words) < 3:
                        raise ValueError("a face has at least three corners")
                    corners = [int(word.partition("/")[0]) for word in words]
                    faces.append(([c - 1 if c > 0 else len(points) + c for c in corners], of["o"] + of["g"]))
                elif key in of:
                    of[key] = tuple(words)
            except ValueError as error:
                raise ValueError(f"line {number}: {error}") from None
    blocks = [list(rows) for _, rows in groupby(faces, key=lambda face: len(face[0]))]
    kinds = {3: "triangle", 4: "quad"}
    cells = [(kinds.get(len(rows[0][0]), "polygon"), np.array([row for row, _ in rows])) for rows in blocks]
    names = dict.fromkeys(name for _, of_face in faces for name in of_face)
    sets = {name: [np.array([k for k, (_, of_face) in enumerate(rows) if name in of_face], int) for rows in blocks]
            for name in names}
    if not points:
        raise ValueError("it has no points")
    return meshio.Mesh(np.array(points), cells, cell_sets=sets)
