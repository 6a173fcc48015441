"""The tangent of anchored directors: they turn with the membrane, while all others are still."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import cos, sin
from scipy import sparse

from ..case.pointwise import between, pointwise
from ..model.director import Anchor, Couple
from ..model.tensors import cross
from .mechanics import Mechanics
from .tangent import derivative


class AnchorTangent:
    """Derivatives -∂f/∂u [Pa], in space [pN/µm], of forces as far as anchored directors change with displacements.

    The energy is one of F and of the director's gradients, values and Laplacians, which are A (u, h) for displacements
    u and anchored directors h, with a constant A.  With its second derivatives S, but those by F twice, which
    `Stiffness.internal` has, and with T = ∂h/∂u, the part is

        (I, T)ᵀ Aᵀ S A (I, T) - τ · ∂²h/∂u²

    where τ are the torques on h.  Active stresses have no energy: with them S is not symmetric.

    Source: derived here, by the chain rule.
    """

    def __init__(self, mechanics: Mechanics, gradients: list[sparse.csr_matrix], laplacian: sparse.csr_matrix):
        """Find A from `gradients` [1/µm] and a `laplacian` [1/µm²] (n_owned, size), with columns in PETSc's order;
        collective.
        """
        self._mechanics, m = mechanics, mechanics
        self._director: Any = m.director
        d, k, on = m.scene.dimension, self._director.numbers, self._director.anchors.owned
        anchors = np.concatenate(m.comm.allgather(m.state.in_petsc[on]))
        self._near = near = np.flatnonzero(np.diff(gradients[0][:, anchors].indptr))
        G, own = [g[near] for g in gradients], sparse.eye(m.n_owned, m.scene.size, m.part.first, format="csr")[near]
        of_directors = [_of_numbers([g[:, anchors] for g in parts], k) for parts in (G, [own], [laplacian[near]])]
        self._A = sparse.block_diag([_of_numbers(G, d), sparse.vstack(of_directors)], "csr")
        self._mine = k * sum(m.comm.allgather(len(on))[: m.comm.rank]) + np.arange(k * len(on)).reshape(-1, k)
        self._begin = d * np.cumsum([0, *m.comm.allgather(m.n_owned)])
        self._material = m.part.owned.material[near]
        self._volume, missed = (m.part.owned.field(name)[near] for name in ("V", "director_modulus"))
        self._missed = missed if d == 3 else np.zeros(len(near))

    def __call__(self) -> sparse.csr_matrix:
        """The rows of this rank in the current state, after F was updated; collective."""
        m, A, n = self._mechanics, self._A, self._begin[-1]
        slope, S = self._derivatives()
        torque = -m.comm.allreduce((A.T @ slope)[n:])[self._mine].T
        turned, bent = (_in_plane if m.scene.dimension == 2 else _in_space)(m, torque)
        P = sparse.vstack([sparse.eye(n), *m.comm.allgather(turned)], "csr")
        K = P.T @ (A.T @ S @ A) @ P + bent
        return sum(m.comm.alltoall([K[a:b] for a, b in zip(self._begin, self._begin[1:], strict=False)]))

    def _derivatives(self) -> tuple[np.ndarray, sparse.csr_matrix]:
        """First derivatives of the energy by what A yields, number by number, and S."""
        m, near, h = self._mechanics, self._near, self._director.values
        F, gradient = m.state.tensors()[0][..., near], self._director.of_rows()["gradient"][..., near]
        d, k, n = len(F), h.shape[1], len(near)
        known = d * d + k * d
        bend = np.arange(known + k, known + 2 * k)
        first, S = np.zeros((known + 2 * k, n)), np.zeros((known + 2 * k, known + 2 * k, n))
        for number, law in enumerate(m.scene.materials):
            on = np.flatnonzero(self._material == number)
            if hasattr(law, "director_flux") and len(on):
                value, by = derivative(lambda *at, law=law: _conjugate(law, m.terms.active, *at), F[..., on],
                                       gradient[..., on], h[near[on]].T)
                first[:known, on], S[:known, : known + k, on] = self._volume[on] * value, self._volume[on] * by
        first[bend] = self._missed * m.state.by_row(m.kernel["director_bend"])[near, :k].T
        S[: d * d, : d * d], S[bend, bend] = 0.0, self._missed
        at = np.arange(len(S) * n).reshape(len(S), n)
        out = _of_blocks(S, at, at, (at.size, at.size))
        out.eliminate_zeros()
        return first.ravel(), out


def _conjugate(law: Any, active: bool, F: Any, gradient: Any, h: Any) -> tuple:
    """Stress by the director [Pa] and flux of its numbers h [rad], [-] of a law [pN/µm], row by row."""
    given = {"F": F, "gradient": gradient, "director": h if len(h) == 3 else (cos(h[0]), sin(h[0]))}
    stress, acting = (_flat(pointwise(law, name, given)) for name in ("director_stress", "active_stress"))
    both = tuple(a + b for a, b in zip(stress, acting, strict=True)) if active else stress
    return *both, *_flat(law.director_flux(F, gradient))


def _in_plane(m: Mechanics, torque: np.ndarray) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """T (n, 2 size) [rad/µm] of this rank's n anchors and the part [Pa] of ∂²h/∂u², for torques (1, n) [pN].

    An angle turns with the chord from the particle before to that after.
    """
    anchor = m.kernel["anchor"][m.kernel["anchor_owned"] > 0][:, [0, 2]]
    at, x = _components(m, anchor), m.state.x(anchor).transpose(1, 2, 0)

    def force(x: tuple, y: tuple, torque: Any) -> tuple:
        return sum(Couple().force(torque, between(x, y)), ())

    _, slope = derivative(force, *x, torque[0])
    size = 2 * m.scene.size
    return (_of_blocks(slope[:, 4:].transpose(1, 0, 2), np.arange(len(anchor))[None], at, (len(anchor), size)),
            _of_blocks(-slope[:, :4], at, at, (size, size)))


def _in_space(m: Mechanics, torque: np.ndarray) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """T (3 n, 3 size) [1/µm] of this rank's n anchors and the part [pN/µm] of ∂²h/∂u², for torques (3, n) [pN µm].

    A vector turns with the frame of `Anchor`, which is a sum over the triangles around.
    """
    k, law = m.kernel, Anchor()
    mine = np.flatnonzero(k["anchor_owned"])
    n, size = len(mine), 3 * m.scene.size
    place, count = np.full(len(k["anchor"]), -1), np.diff(k["first_anchor_ring"])
    place[mine] = np.arange(n)
    of = np.repeat(place, count)
    corners = np.column_stack([np.repeat(k["anchor"], count), k["anchor_ring"]])[of >= 0]
    weight, of = k["anchor_weight"][of >= 0], of[of >= 0]
    across, along = k["anchor_offset"][mine].T
    frame = k["anchor_frame"][mine].transpose(1, 2, 0)

    def reaction(normal: tuple, tangent: tuple) -> tuple:
        return _flat(law.reaction(normal, tangent, law.direction(normal, tangent, across, along), tuple(torque)))

    def part(at: tuple, first: tuple, second: tuple) -> tuple:
        edges = between(at, first), between(at, second)
        return *cross(*edges), *(weight * x for x in edges[0])

    def pulls(at: tuple, first: tuple, second: tuple) -> tuple:
        one, other = cross(between(at, second), by_normal), cross(by_normal, between(at, first))
        return *(-a - b for a, b in zip(one, other, strict=True)), *one, *other

    turn = derivative(lambda normal, tangent: law.direction(normal, tangent, across, along), *frame)[1]
    react, bend = derivative(reaction, *frame)
    by_normal = tuple(react[:3, of])
    at, x = _components(m, corners), m.state.x(corners).transpose(1, 2, 0)
    rows = np.arange(6 * n).reshape(6, n)
    Q = _of_blocks(derivative(part, *x)[1], rows[:, of], at, (6 * n, size))
    bent = Q.T @ _of_blocks(bend, rows, rows, (6 * n, 6 * n)) @ Q
    bent += _of_blocks(derivative(pulls, *x)[1], at, at, (size, size))
    return _of_blocks(turn, np.arange(3 * n).reshape(-1, 3).T, rows, (3 * n, 6 * n)) @ Q, -bent


def _of_numbers(parts: list[sparse.csr_matrix], k: int) -> sparse.csr_matrix:
    """What matrices make of each of k numbers of every particle, in turn."""
    return sparse.vstack([sparse.kron(part, unit) for unit in np.eye(k)[:, None] for part in parts], "csr")


def _components(m: Mechanics, nodes: np.ndarray) -> np.ndarray:
    """Columns (k d, n) int of the displacements of k particles each, by local numbers (n, k) int."""
    d = m.scene.dimension
    return (d * m.state.in_petsc[nodes][:, :, None] + np.arange(d)).reshape(len(nodes), d * nodes.shape[1]).T


def _of_blocks(values: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple) -> sparse.csr_matrix:
    """Matrix of the sum of n blocks (a, b, n) in `rows` (a, n) int and `columns` (b, n) int."""
    i, j = np.broadcast_arrays(rows[:, None], columns[None])
    return sparse.csr_matrix((values.ravel(), (i.ravel(), j.ravel())), shape)


def _flat(rows: tuple) -> tuple:
    """The numbers of a tuple of rows in turn."""
    return tuple(x for row in rows for x in row)
