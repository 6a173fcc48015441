"""Cost of a step by cell, from which particles are dealt out: rows by their neighbours, and contacts at the start."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..meshfree.scene import Scene, ranges

# Cost of a surface particle near another cell, over that of a neighbour of a row: measured 90 to 100 in the plane and
# 1,010 to 1,220 in space, at 300 to 3,000 particles a cell.  A neighbour costs the same in all materials.
CONTACT = {2: 95.0, 3: 1100.0}
MOST = 300_000  # surface particles that are looked at: of more, each second, third …


def cost_of_cells(scene: Scene, reach: float = 0.0) -> np.ndarray:
    """Cost of each cell in a step, in neighbours of a row (cells,) [-].

    reach : largest distance at which surfaces of two cells act on each other [µm], 0 without contacts.
    """
    rows = np.array([t.G[0].nnz for t in scene.templates], float)[scene.kind]
    return rows + CONTACT[scene.dimension] * near_others(scene, reach) if reach else rows


def near_others(scene: Scene, reach: float, most: int = MOST) -> np.ndarray:
    """Number of surface particles of each cell within `reach` [µm], and half a spacing, of those of another one, in the
    reference configuration (cells,) [-].  Of more than about `most` in all, some stand for all.
    """
    of_kind = [len(t.surface) for t in scene.templates]
    every = -(-int(scene.first_surface[-1]) // most)
    looked = [t.surface[::every] for t in scene.templates]
    count = np.array([len(at) for at in looked])[scene.kind]
    end = np.cumsum(count)
    cell, at = np.repeat(np.arange(len(count)), count), np.zeros(end[-1], np.int64)
    for kind, some in enumerate(looked):
        mine = np.flatnonzero(scene.kind == kind)
        at[ranges(end[mine] - len(some), end[mine])] = np.tile(some, len(mine))
    x = scene.particles(scene.offset[cell] + at).X
    apart = max(t.spacing for t in scene.templates) * every ** (1.0 / (scene.dimension - 1))
    pairs = cKDTree(x).query_pairs(reach + 0.5 * apart, output_type="ndarray")
    near = np.zeros(len(x), bool)
    near[pairs[cell[pairs[:, 0]] != cell[pairs[:, 1]]]] = True
    share = np.bincount(cell[near], minlength=len(count)) / np.maximum(count, 1)
    return share * np.array(of_kind)[scene.kind]
