"""Elements of a mesh file: the types that are read, and the edges around each element.

A side of an element of second order is a parabola through its middle node; it is divided into straight edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import polygons

# Nodes in the order around an element; for those of second order, the middle of each side follows its first corner.
AROUND = {"triangle": (0, 1, 2), "quad": (0, 1, 2, 3)}
AROUND_SECOND = {"triangle6": (0, 3, 1, 4, 2, 5), "triangle7": (0, 3, 1, 4, 2, 5),
                 "quad8": (0, 4, 1, 5, 2, 6, 3, 7), "quad9": (0, 4, 1, 5, 2, 6, 3, 7)}
ALONG = {"line": (0, 1), "line3": (0, 2, 1)}
AREAS = {"polygon", *AROUND, *AROUND_SECOND}
READ = "triangles and quadrilaterals of first or second order, polygons, lines of two or three points, and vertices"
PIECES = 16  # edges of a parabola: together they miss 1/256 of the area between it and its chord
TINY = 1e-9  # lengths below this fraction of the size are rounding errors


def dimensions(mesh: Any) -> np.ndarray:
    """Dimension of each element of a mesh (elements,) int: 0 of vertices, 1 of lines, 2 of areas, 3 of all others."""
    of = {"vertex": 0, **dict.fromkeys(ALONG, 1), **dict.fromkeys(AREAS, 2)}
    return np.repeat([of.get(block.type, 3) for block in mesh.cells], [len(block.data) for block in mesh.cells])


def refuse_others(mesh: Any, path: str) -> None:
    """Check that all elements of a mesh can be read, as those left out would be holes.

    Raises ValueError for other types, or if there is no area element; the message is for the user.
    """
    known = {*AREAS, *ALONG, "vertex"}
    others: dict[str, int] = {}
    for block in mesh.cells:
        if block.type not in known:
            others[block.type] = others.get(block.type, 0) + len(block.data)
    if others:
        listed = ", ".join(f"{n} of type {kind}" for kind, n in sorted(others.items()))
        raise ValueError(f"'{path}' has elements that are not read: {listed}; a cell is made of {READ}, all in a plane")
    if not AREAS & {block.type for block in mesh.cells if len(block.data)}:
        kinds = sorted({block.type for block in mesh.cells if len(block.data)})
        raise ValueError(f"'{path}' has no triangles{': only ' + ', '.join(kinds) if kinds else ''}")


def rings(mesh: Any, path: str) -> tuple[list[tuple], list[tuple]]:
    """Nodes around the area elements and along the lines of a mesh, by type of element.

    Returns
    -------
    areas, lines : list of (order, number, nodes) -- order of the type, number of each element in the file (k,) int, and
    its nodes (k, m) int.

    Raises ValueError where node numbers are not valid; the message is for the user.
    """
    areas: list[tuple] = []
    lines: list[tuple] = []
    first = 0
    for block in mesh.cells:
        data, number = whole(block.data, len(mesh.points), path), first + np.arange(len(block.data))
        first += len(block.data)
        kind, order = block.type, 2 if block.type in (*AROUND_SECOND, "line3") else 1
        if kind in AREAS and len(data):
            columns = (AROUND | AROUND_SECOND).get(kind, slice(None))
            areas.append((order, number, data[:, columns]))
        elif kind in ALONG:
            lines.append((order, number, data[:, ALONG[kind]]))
    return areas, lines


def whole(data: Any, n_points: int, path: str) -> np.ndarray:
    """Node numbers (k, m) int; files may hold them as floats.

    Raises ValueError where they are no numbers of nodes; the message is for the user.
    """
    data = np.asarray(data)
    if data.ndim != 2 or data.dtype.kind not in "iuf" or (data.dtype.kind == "f" and (data != np.rint(data)).any()):
        raise ValueError(f"'{path}' cannot be read: the points of its elements are no whole numbers")
    if data.size and (data.min() < 0 or data.max() >= n_points):
        raise ValueError(f"'{path}' cannot be read: it names points that it does not have")
    return data.astype(np.int64)


def representatives(areas: list[tuple], group: np.ndarray) -> np.ndarray:
    """Number of the first element with the same nodes (elements,) int, for each element of the file.

    A file may list an element once in each `group`, given by number (elements,) int.  One that a single group lists
    twice represents itself both times.
    """
    first_of = np.arange(len(group))
    for width in {points.shape[1] for _, _, points in areas}:
        number, points = (np.concatenate([part[k] for part in areas if part[2].shape[1] == width]) for k in (1, 2))
        _, first, same = np.unique(np.sort(points, axis=1), axis=0, return_index=True, return_inverse=True)
        one = number[first[same.reshape(-1)]]
        first_of[number] = np.where(group[number] != group[one], one, number)
    return first_of


def edges(areas: list[tuple], lines: list[tuple], points: np.ndarray, path: str) -> tuple[np.ndarray, ...]:
    """Straight edges around the elements that have an area, and along the lines.

    Parameters
    ----------
    areas, lines : list -- as `rings` returns them.
    points : (n, 2) -- positions of the nodes [unit of the file].

    Returns
    -------
    around : (k, 2) int -- edges around the elements, counterclockwise.
    of : (k,) int -- number of the element of each of these.
    along : (m, 2) int -- edges along the lines.
    line : (m,) int -- number of the line of each of these.
    points : (n', 2) -- positions, with those of the new points on parabolas [unit of the file].

    Raises ValueError for an element that crosses itself, or if none has an area; the message is for the user.
    """
    for _, _, ring in areas:
        _refuse_crossed(ring, points, path)
    closed = [(order, number, np.column_stack([ring, ring[:, :1]])) for order, number, ring in areas]
    found, of, points = _divided([(order, np.repeat(number, (way.shape[1] - 1) // order), _sides(way, order))
                                  for order, number, way in (*closed, *lines)], points)
    thin = np.isin(of, np.concatenate([np.zeros(0, int), *(number for _, number, _ in lines)]))
    along, line = found[thin], of[thin]
    around, of = (part[~thin & (found[:, 0] != found[:, 1])] for part in (found, of))
    p, q = (points[end] - points[areas[0][2][0, 0]] for end in around.T)
    area, size = np.bincount(of, 0.5 * polygons.cross(p, q)), np.zeros(of.max(initial=-1) + 1)
    np.maximum.at(size, of, ((q - p)**2).sum(axis=1))
    around = np.where((area[of] < 0)[:, None], around[:, ::-1], around)
    whole = (np.abs(area) > TINY * size)[of]
    if not whole.any():
        raise ValueError(f"'{path}' has no triangles with an area")
    return around[whole], of[whole], along, line, points


def _sides(ring: np.ndarray, order: int) -> np.ndarray:
    """Sides of rows of nodes (n, m): their ends (k, 2), or for order 2 with the middle node (k, 3)."""
    starts = range(0, ring.shape[1] - 1, order)
    return np.stack([ring[:, s:s + order + 1] for s in starts], axis=1).reshape(-1, order + 1)


def _refuse_crossed(ring: np.ndarray, points: np.ndarray, path: str) -> None:
    """Raise ValueError if an element, of nodes `ring` (k, m), crosses itself."""
    corners, m = points[ring], ring.shape[1]
    for i in range(m):
        for j in range(i + 2, m - (i == 0)):
            p, q, r, s = corners[:, i], corners[:, (i + 1) % m], corners[:, j], corners[:, (j + 1) % m]
            size = TINY * ((q - p)**2).sum(-1) + TINY * ((s - r)**2).sum(-1)
            one, two, three, four = (np.where(np.abs(c) > size, np.sign(c), 0.0) for c in (
                polygons.cross(q - p, r - p), polygons.cross(q - p, s - p),
                polygons.cross(s - r, p - r), polygons.cross(s - r, q - r)))
            if len(crossed := np.flatnonzero((one * two < 0) & (three * four < 0))):
                x, y = corners[crossed[0]].mean(axis=0)
                raise ValueError(f"'{path}' has an element that crosses itself, at ({x:.4g}, {y:.4g})")


def _divided(sides: list[tuple], points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (k, 2) of sides (order, number, nodes (k, 2 or 3)), the number of each, and points with the new ones.

    A curved side is divided into PIECES edges, by the same points wherever it occurs, in either direction.
    """
    edges, of = ([part[k] for part in sides if part[0] == 1] for k in (2, 1))
    curved = [part for part in sides if part[0] == 2]
    if curved:
        number, side = (np.concatenate([part[k] for part in curved]) for k in (1, 2))
        back = side[:, 0] > side[:, 2]
        known, which = np.unique(np.where(back[:, None], side[:, ::-1], side), axis=0, return_inverse=True)
        which = which.reshape(-1)
        a, m, b = points[known].transpose(1, 0, 2)
        bent = np.abs(polygons.cross(b - a, m - a)) > TINY * ((b - a)**2).sum(axis=1)
        t = np.arange(1, PIECES)[:, None] / PIECES
        curve = [p * (1 - t) * (1 - 2 * t) + q * 4 * t * (1 - t) + r * t * (2 * t - 1)
                 for p, q, r in zip(a[bent], m[bent], b[bent], strict=True)]
        new = len(points) + np.arange(len(curve) * (PIECES - 1)).reshape(-1, PIECES - 1)
        points = np.concatenate([points, *curve])
        new[:, PIECES // 2 - 1] = known[bent, 1]
        for chosen, way in ((bent, np.column_stack([known[bent, 0], new, known[bent, 2]])), (~bent, known[~bent])):
            here, row = np.flatnonzero(chosen[which]), np.cumsum(chosen) - 1
            way = way[row[which[here]]]
            way = np.where(back[here, None], way[:, ::-1], way)
            edges.append(_sides(way, 1))
            of.append(np.repeat(number[here], way.shape[1] - 1))
    return np.concatenate(edges), np.concatenate(of), points
