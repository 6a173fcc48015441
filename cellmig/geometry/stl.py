"""STL files: triangles with corners of their own, as text or binary; a text may hold several named solids.

meshio leaves out what it does not know in a text, and says of no line what is wrong with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..case.messages import show

HEAD, FACET = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])  # of a binary file


def read(path: str) -> Any:
    """Mesh of the triangles in an STL file; its cell sets are the solids of a text, if there are several.

    Raises ValueError for a file that cannot be read; the message is for the user.
    """
    import meshio

    with open(path, "rb") as stream:
        raw = stream.read()
    solids: list[str] = []
    number = int.from_bytes(raw[HEAD - 4:HEAD], "little")
    if len(raw) == HEAD + number * FACET.itemsize:
        corners = np.frombuffer(raw[HEAD:], FACET)["corners"].astype(float)
    elif raw.lstrip()[:5].lower() == b"solid":
        corners, solids = _text(raw.decode(errors="replace"))
    else:
        raise ValueError("it is no text, which begins with 'solid', and has not the length of a binary file, "
                         f"{HEAD} + {FACET.itemsize} x {number} bytes for {number} triangles, but {len(raw)} bytes")
    names = dict.fromkeys(solids)
    sets = {name: [np.array([k for k, one in enumerate(solids) if one == name])] for name in names if len(names) > 1}
    return meshio.Mesh(corners.reshape(-1, 3), [("triangle", np.arange(3 * len(corners)).reshape(-1, 3))],
                       cell_sets=sets)


def _text(text: str) -> tuple[np.ndarray, list[str]]:
    """Corners (n, 3, 3) of the triangles of a text, and the name of the solid of each."""
    corners: list[list[float]] = []
    solids: list[str] = []
    solid = ""
    for number, line in enumerate(text.splitlines(), 1):
        key, *words = line.split() or [""]
        match key.lower():
            case "solid":
                solid = " ".join(words)
            case "vertex":
                try:
                    x, y, z = map(float, words)
                except ValueError:
                    raise ValueError(f"line {number} has no three coordinates: {show(line.strip())}") from None
                corners.append([x, y, z])
            case "endfacet":
                solids.append(solid)
                if len(corners) != 3 * len(solids):
                    raise ValueError(f"line {number} ends a facet of {len(corners) - 3 * len(solids) + 3} corners, "
                                     "not three")
    if len(corners) != 3 * len(solids):
        raise ValueError("it ends within a facet")
    return np.array(corners).reshape(-1, 3, 3), solids
