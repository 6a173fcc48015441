"""Bodies: the reference configuration of the scene, one template per kind of cell, shared by all its copies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from ..geometry import polygons
from . import rkpm
from .recovery import recovery
from .stabilisation import stabilisation

STRIP = 3.0  # height in spacings of the strips in which particles are numbered: neighbours stay close in memory


@dataclass(frozen=True)
class Template:
    """Discretised kind of cell about its centre; particles are numbered by material, then in strips.

    X : (n, 2) [µm];  V : (n,) [µm²];  nucleus : (n,) bool;  surface : (m,) int -- particles of its closed loops, the
    outer one counterclockwise, holes clockwise;  after : (m,) int -- position in `surface` of the one that follows;
    parts : by name, where in `surface` the segments of a part of the boundary begin;
    G : (n, n) complex CSR, ∂/∂X + i ∂/∂Y [1/µm];  S, E : (n, n) CSR, viscous and elastic stabilisation [Pa µs], [Pa];
    R : (n, n) CSR, recovery of stress;  spacing : mean distance h [µm];
    laws : (body, nucleus) material laws;  damping : (n,) -- bulk viscosity of the numerical damping [Pa µs].
    """

    X: np.ndarray
    V: np.ndarray
    nucleus: np.ndarray
    surface: np.ndarray
    after: np.ndarray
    parts: dict[str, np.ndarray]
    G: sparse.csr_matrix
    S: sparse.csr_matrix
    E: sparse.csr_matrix
    R: sparse.csr_matrix
    spacing: float
    laws: tuple
    damping: np.ndarray

    @cached_property
    def segments(self) -> np.ndarray:
        """Particles at the ends of the segments of the surface (m, 2) int."""
        return np.column_stack([self.surface, self.surface[self.after]])

    @cached_property
    def before(self) -> np.ndarray:
        """Position in `surface` of the one that each surface particle follows (m,) int."""
        return np.argsort(self.after)

    @cached_property
    def loop(self) -> np.ndarray:
        """Number of the closed loop that each surface particle is on, 0 for the outer one (m,) int."""
        return np.append(0, np.cumsum(self.after[:-1] != np.arange(1, len(self.after))))

    def _by_law(self, attribute: str) -> np.ndarray:
        body, nucleus = self.laws
        inside = getattr(nucleus if nucleus is not None else body, attribute)
        return np.where(self.nucleus, inside, getattr(body, attribute))

    @cached_property
    def mass(self) -> np.ndarray:
        """Lumped masses ρ0 V (n,) [fg/µm]."""
        return self._by_law("density") * self.V

    @cached_property
    def segment_length(self) -> np.ndarray:
        """Reference length of the surface segment from each surface particle to the next (m,) [µm]."""
        return polygons.sides(self.X[self.segments])

    @cached_property
    def viscous_weight(self) -> np.ndarray:
        """2 μ and the bulk damping (n,) [Pa µs]: what resists stretching."""
        return 2.0 * self._by_law("viscosity") + self.damping

    @cached_property
    def elastic_weight(self) -> np.ndarray:
        """Modulus of compression waves ρ c² (n,) [Pa]."""
        return self._by_law("density") * self._by_law("sound_speed") ** 2

    @cached_property
    def bound(self) -> np.ndarray:
        """Σ_J G⊗G/m_J, components 00, 11, 01 (n, 3) [1/(µm fg)]: local stiffness per modulus and volume."""
        g = [abs_part(self.G, part) for part in ("real", "imag")]
        by_mass = sparse.diags(1.0 / self.mass)
        return np.column_stack([np.asarray((a.multiply(b) @ by_mass).sum(axis=1)).ravel()
                                for a, b in ((g[0], g[0]), (g[1], g[1]), (g[0], g[1]))])

    def local_bound(self, weight: np.ndarray) -> float:
        """Largest V_I w_I λmax(Σ_J G⊗G/m_J) at rest, which the step control follows through the deformation."""
        a, b, c = self.bound.T
        return float((self.V * weight * (0.5 * (a + b) + np.sqrt(0.25 * (a - b) ** 2 + c**2))).max())

    @cached_property
    def diffusion(self) -> float:
        """Largest eigenvalue of -V⁻¹ div V grad [1/µm²], rounded up: how fast a field can relax per diffusivity."""
        V, root = sparse.diags(self.V), sparse.diags(1.0 / np.sqrt(self.V))
        parts = [abs_part(self.G, part) @ root for part in ("real", "imag")]
        return _largest(sum(g.T @ V @ g for g in parts), len(self.X))

    @cached_property
    def rates(self) -> tuple[float, float, float]:
        """Largest damping of the stabilisation and of the viscosities [1/µs], and frequency² of the elasticity [1/µs²].

        Largest eigenvalues of M⁻¹ times the linear operators on the reference configuration, rounded up.
        """
        n, root = len(self.X), 1.0 / np.sqrt(self.mass)
        scale = sparse.diags(root)
        stab = _largest(scale @ self.S @ scale, n)
        gx, gy = abs_part(self.G, "real") @ scale, abs_part(self.G, "imag") @ scale
        shear = self._by_law("shear_modulus")
        viscous = _largest(_strain_operator(gx, gy, self.V, self._by_law("viscosity"), self.damping), 2 * n)
        elastic = _largest(_strain_operator(gx, gy, self.V, shear, self.elastic_weight - 2.0 * shear), 2 * n)
        return stab, viscous, elastic + _largest(scale @ self.E @ scale, n)


def abs_part(G: sparse.csr_matrix, part: str) -> sparse.csr_matrix:
    """Real or imaginary part of a complex CSR matrix, with its sparsity."""
    return sparse.csr_matrix((np.ascontiguousarray(getattr(G.data, part)), G.indices, G.indptr), G.shape)


def _strain_operator(gx, gy, V: np.ndarray, shear: np.ndarray, volumetric: np.ndarray) -> LinearOperator:
    """V -> Σ_I V (2 shear d + volumetric tr d) ∇N: linear operator on (n, 2) fields, flattened by components."""
    n = len(V)

    def apply(v: np.ndarray) -> np.ndarray:
        x, y = v[:n], v[n:]
        d00, d11, d01 = gx @ x, gy @ y, 0.5 * (gy @ x + gx @ y)
        p = volumetric * (d00 + d11)
        s00, s11, s01 = V * (2 * shear * d00 + p), V * (2 * shear * d11 + p), V * 2 * shear * d01
        return np.concatenate([gx.T @ s00 + gy.T @ s01, gx.T @ s01 + gy.T @ s11])

    return LinearOperator((2 * n, 2 * n), apply, dtype=float)


def _largest(operator: Any, n: int) -> float:
    """Largest eigenvalue, rounded up to three digits so that no last bit of it matters."""
    start = np.cos(np.arange(n) ** 1.5)
    if not (operator @ start).any():  # ARPACK differs by version in what it makes of no matrix at all
        return 0.0
    top = eigsh(operator, 1, which="LA", tol=1e-4, v0=start, return_eigenvectors=False)[0]
    return float(f"{max(top, 0.0) * 1.01:.2e}")


def template(shape: Any, count: int, dilation: float, laws: tuple, bulk_viscosity: float,
             refinement: float = 1.0, solve: Callable[..., np.ndarray] = rkpm.factorised) -> Template:
    """Discretise a shape with `count` particles, a support of `dilation` spacings and materials (body, nucleus).

    Along the surface the particles are `refinement` times as dense as within.  `solve` : see `rkpm.consistent`.
    """
    layout = shape.particles(count, refinement)
    spacing = float(np.sqrt(shape.area / count))
    placed = polygons.snapped(layout.X)
    x, y = np.rint(placed / (1e-6 * spacing)).T  # so that no last bit changes the order
    strip = np.floor(y / (1e6 * STRIP) + 0.5)
    order = np.lexsort((y, x, strip, ~layout.nucleus if laws[1] is not None else strip))
    place = np.empty(count, int)
    place[order] = np.arange(count)
    X = placed[order]
    nucleus = layout.nucleus[order] & (laws[1] is not None)
    surface, after = place[layout.surface], layout.next
    segments = np.column_stack([surface, surface[after]])
    V, edges = rkpm.dual_cells(X, segments)
    support = rkpm.supports(X, edges, dilation * spacing)
    G = rkpm.consistent(rkpm.gradients(X, support, segments), X, V, support, segments, solve)
    body, inner = laws
    inner = inner if inner is not None else body
    S = stabilisation(X, V, edges, np.where(nucleus, *(m.numerical_viscosity(spacing) for m in (inner, body))))
    E = stabilisation(X, V, edges, np.where(nucleus, inner.numerical_modulus, body.numerical_modulus))
    wave = np.where(nucleus, inner.density * inner.sound_speed, body.density * body.sound_speed)
    R = recovery(X, G, support, nucleus)
    parts = {"surface": np.arange(len(surface)), **(layout.parts or {})}
    return Template(X, V, nucleus, surface, after, parts, G, S, E, R, spacing, laws, bulk_viscosity * spacing * wave)


@dataclass(frozen=True)
class Scene:
    """All cells in the reference configuration.  Global ids run through the cells, as the template's numbers do.

    templates : one per kind of cell;  kind : (cells,) -- its template;  centre : (cells, 2) [µm];
    materials : the laws that occur;  material_of : per template, the indices (body, nucleus) into `materials`.
    """

    templates: list
    kind: np.ndarray
    centre: np.ndarray
    materials: list
    material_of: list

    @cached_property
    def offset(self) -> np.ndarray:
        """First global id of each cell, and the number of all particles at the end (cells + 1,)."""
        return np.concatenate([[0], np.cumsum([len(self.templates[k].X) for k in self.kind])])

    @property
    def size(self) -> int:
        """Number of particles."""
        return int(self.offset[-1])

    @cached_property
    def cell(self) -> np.ndarray:
        """Cell of each particle, from 0 (size,)."""
        return np.repeat(np.arange(len(self.kind), dtype=np.int32), np.diff(self.offset))

    def field(self, attribute: str) -> np.ndarray:
        """A template's field ("V", "mass", …) for all particles, in global-id order (size, ...)."""
        return np.concatenate([getattr(self.templates[k], attribute) for k in self.kind])

    @cached_property
    def X(self) -> np.ndarray:
        """Reference positions (size, 2) [µm]."""
        return self.field("X") + self.centre[self.cell]

    @cached_property
    def material(self) -> np.ndarray:
        """Index into `materials` of each particle (size,)."""
        parts = [np.where(self.templates[k].nucleus, self.material_of[k][1], self.material_of[k][0]) for k in self.kind]
        return np.concatenate(parts).astype(np.int32)

    def surface(self, cell: int) -> np.ndarray:
        """Global ids of a cell's surface particles, loop by loop (m,)."""
        return self.offset[cell] + self.templates[self.kind[cell]].surface
