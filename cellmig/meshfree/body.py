"""Reference configuration: a template for each kind of cell, shared by all its copies, and the scene of all cells."""

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
from .stabilisation import MISSED, laplacian

STRIP = 3.0  # height [spacings] of the strips in which particles are numbered, so that neighbours are close in memory


@dataclass(frozen=True)
class Template:
    """A discretised cell, with its centre as origin; particles are numbered by material, then in strips.

    Attributes
    ----------
    X : (n, 2) -- reference positions [µm].
    V : (n,) -- volumes per unit thickness [µm²].
    nucleus : (n,) bool -- whether a particle belongs to the nucleus.
    surface : (m,) int -- surface particles along closed loops, the outer one counterclockwise, holes clockwise.
    after : (m,) int -- index in `surface` of the next particle on the loop.
    parts : dict of (k,) int -- by name of a part of the boundary, indices in `surface` where its segments begin.
    G : (n, n) CSR for each direction -- derivatives of the shape functions at the particles, of one pattern [1/µm].
    C : (n, n) CSR -- Laplacians at the particles, zero for linear fields [1/µm²].
    bending_weight : (n,) -- dissipation of the stabilisation over |C v|² at rest [pN µs µm²].
    bending_modulus : (n,) -- twice the energy of the elastic stabilisation over |C u|² [pN µm²].
    R : (n, n) CSR -- recovery of stress [-].
    spacing : float -- mean distance of particles h [µm].
    laws : tuple -- material laws of body and nucleus; the latter is None if there is no nucleus.
    damping : (n,) -- bulk viscosity of the numerical damping [Pa µs].
    """

    X: np.ndarray
    V: np.ndarray
    nucleus: np.ndarray
    surface: np.ndarray
    after: np.ndarray
    parts: dict[str, np.ndarray]
    G: rkpm.Gradient
    C: sparse.csr_matrix
    bending_weight: np.ndarray
    bending_modulus: np.ndarray
    R: sparse.csr_matrix
    spacing: float
    laws: tuple
    damping: np.ndarray

    @cached_property
    def facets(self) -> np.ndarray:
        """Indices in `surface` of the ends of its segments (m, 2) int."""
        return np.column_stack([np.arange(len(self.after)), self.after])

    @cached_property
    def segments(self) -> np.ndarray:
        """Particles at both ends of the segments of the surface (m, 2) int."""
        return self.surface[self.facets]

    @cached_property
    def outer(self) -> np.ndarray:
        """Whether segments are on the outer loop (m,) bool."""
        return self.loop == 0

    @cached_property
    def before(self) -> np.ndarray:
        """Index in `surface` of the previous particle on the loop (m,) int."""
        return np.argsort(self.after)

    @cached_property
    def loop(self) -> np.ndarray:
        """Number of the loop of each surface particle, 0 for the outer one (m,) int."""
        return np.append(0, np.cumsum(self.after[:-1] != np.arange(1, len(self.after))))

    def _by_law(self, attribute: str) -> np.ndarray:
        body, nucleus = self.laws
        inside = getattr(nucleus if nucleus is not None else body, attribute)
        return np.where(self.nucleus, inside, getattr(body, attribute))

    @cached_property
    def mass(self) -> np.ndarray:
        """Lumped masses ρ0 V (n,) [fg/µm], per unit thickness."""
        return self._by_law("density") * self.V

    @cached_property
    def facet_size(self) -> np.ndarray:
        """Reference lengths of the segments from each surface particle to the next (m,) [µm]."""
        return polygons.sides(self.X[self.segments])

    @cached_property
    def viscosity(self) -> np.ndarray:
        """Shear viscosities μ (n,) [Pa µs]."""
        return self._by_law("viscosity")

    @cached_property
    def shear_modulus(self) -> np.ndarray:
        """Shear moduli at rest (n,) [Pa]."""
        return self._by_law("shear_modulus")

    @property
    def dilation_modulus(self) -> np.ndarray:
        """P-wave moduli less twice the shear moduli (n,) [Pa]."""
        return self.elastic_weight - 2.0 * self.shear_modulus

    @cached_property
    def viscous_weight(self) -> np.ndarray:
        """Viscosity against uniaxial stretching (n,) [Pa µs]: 2 μ and the numerical bulk viscosity."""
        return 2.0 * self.viscosity + self.damping

    @cached_property
    def elastic_weight(self) -> np.ndarray:
        """P-wave modulus ρ c² (n,) [Pa]."""
        return self._by_law("density") * self._by_law("sound_speed") ** 2

    @cached_property
    def bound(self) -> np.ndarray:
        """Components 00, 11, 01 of Σ_J G⊗G/m_J (n, 3) [1/(µm fg)]: squared frequency per volume and modulus."""
        g = self.G
        by_mass = sparse.diags(1.0 / self.mass)
        return np.column_stack([np.asarray((a.multiply(b) @ by_mass).sum(axis=1)).ravel()
                                for a, b in ((g[0], g[0]), (g[1], g[1]), (g[0], g[1]))])

    def local_bound(self, weight: np.ndarray) -> float:
        """Largest V_I w_I λmax(Σ_J G⊗G/m_J) at rest, for a `weight` w (n,) [Pa] in [1/µs²], or [Pa µs] in [1/µs].

        The step control follows its change with the deformation.  Source: derived here, a bound on the rate of each
        particle's own mode.
        """
        a, b, c = self.bound.T
        return float((self.V * weight * (0.5 * (a + b) + np.sqrt(0.25 * (a - b) ** 2 + c**2))).max())

    @cached_property
    def S(self) -> sparse.csr_matrix:
        """Viscous stabilisation at rest (n, n) CSR [Pa µs]: the forces are -S v, the dissipated power is v·S v."""
        return (self.C.T @ sparse.diags(self.bending_weight) @ self.C).tocsr()

    @cached_property
    def E(self) -> sparse.csr_matrix:
        """Elastic stabilisation (n, n) CSR [Pa]: the forces are -E u, the energy is u·E u/2."""
        return (self.C.T @ sparse.diags(self.bending_modulus) @ self.C).tocsr()

    @cached_property
    def diffusion(self) -> float:
        """Largest eigenvalue of -V⁻¹ div V grad [1/µm²], rounded up: the fastest relaxation rate per diffusivity."""
        V, root = sparse.diags(self.V), sparse.diags(1.0 / np.sqrt(self.V))
        parts = [g @ root for g in self.G]
        return _largest(sum(g.T @ V @ g for g in parts), len(self.X))

    @cached_property
    def rates(self) -> tuple[float, float, float, float]:
        """Largest damping rates of the stabilisation and of the viscosities [1/µs], and largest frequencies² of sound
        and of the elastic stabilisation [1/µs²].

        These are the largest eigenvalues, rounded up, of M⁻¹ times the operators linearised at rest.
        """
        n, root = len(self.X), 1.0 / np.sqrt(self.mass)
        scale = sparse.diags(root)
        gx, gy = (g @ scale for g in self.G)
        viscous = _strain_operator(gx, gy, self.V, self.viscosity, self.damping)
        elastic = _strain_operator(gx, gy, self.V, self.shear_modulus, self.dilation_modulus)
        return (_largest(scale @ self.S @ scale, n), _largest(viscous, 2 * n), _largest(elastic, 2 * n),
                _largest(scale @ self.E @ scale, n))


def _strain_operator(gx: sparse.csr_matrix, gy: sparse.csr_matrix, V: np.ndarray, shear: np.ndarray,
                     volumetric: np.ndarray) -> LinearOperator:
    """Operator v ↦ Σ_I V_I (2 shear d + volumetric tr(d) I) ∇N_J on vectors of x components, then y (2 n,)."""
    n = len(V)

    def apply(v: np.ndarray) -> np.ndarray:
        x, y = v[:n], v[n:]
        d00, d11, d01 = gx @ x, gy @ y, 0.5 * (gy @ x + gx @ y)
        p = volumetric * (d00 + d11)
        s00, s11, s01 = V * (2 * shear * d00 + p), V * (2 * shear * d11 + p), V * 2 * shear * d01
        return np.concatenate([gx.T @ s00 + gy.T @ s01, gx.T @ s01 + gy.T @ s11])

    return LinearOperator((2 * n, 2 * n), apply, dtype=float)


def _largest(operator: Any, n: int) -> float:
    """Largest eigenvalue of a symmetric operator (n, n), rounded up to three digits: its last bits do not matter."""
    start = np.cos(np.arange(n) ** 1.5)
    if not (operator @ start).any():  # versions of ARPACK differ in what they make of a zero matrix
        return 0.0
    top = eigsh(operator, 1, which="LA", tol=1e-4, v0=start, return_eigenvectors=False)[0]
    return float(f"{max(top, 0.0) * 1.01:.2e}")


def template(shape: Any, count: int, dilation: float, laws: tuple, bulk_viscosity: float,
             refinement: float = 1.0, solve: Callable[..., np.ndarray] = rkpm.factorised) -> Template:
    """Discretise a shape.

    Parameters
    ----------
    shape : law of kind shape -- gives layout and area.
    count : int -- number of particles.
    dilation : float -- support radius over the spacing [-].
    laws : tuple -- material laws of body and nucleus, the latter None without one.
    bulk_viscosity : float -- of the numerical damping, over ρ c h [-].
    refinement : float -- density of particles along the surface over that inside [-].
    solve : function -- as for `rkpm.consistent`.
    """
    layout = shape.particles(count, refinement)
    spacing = float(np.sqrt(shape.area / count))
    placed = polygons.snapped(layout.X)
    x, y = np.rint(placed / (1e-6 * spacing)).T  # the order does not depend on the last bits
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
    viscosity = np.where(nucleus, inner.numerical_viscosity(spacing), body.numerical_viscosity(spacing))
    C, square = laplacian(X, edges)
    missed = MISSED * V * square
    modulus = np.where(nucleus, inner.numerical_modulus, body.numerical_modulus)
    wave = np.where(nucleus, inner.density * inner.sound_speed, body.density * body.sound_speed)
    R = recovery(X, G[0], support, nucleus)
    parts = {"surface": np.arange(len(surface)), **(layout.parts or {})}
    return Template(X, V, nucleus, surface, after, parts, G, C, missed * viscosity, missed * modulus, R, spacing, laws,
                    bulk_viscosity * spacing * wave)


@dataclass(frozen=True)
class Scene:
    """All cells in the reference configuration; global ids count the particles cell by cell, each as its template does.

    Attributes
    ----------
    templates : list of Template -- one for each kind of cell.
    kind : (cells,) int -- index of the template of each cell.
    centre : (cells, d) -- centres of the cells [µm].
    materials : list -- the material laws that occur.
    material_of : list -- for each template, the indices of the laws of body and nucleus in `materials`.
    """

    templates: list
    kind: np.ndarray
    centre: np.ndarray
    materials: list
    material_of: list

    @cached_property
    def offset(self) -> np.ndarray:
        """First global id of each cell, and at the end the number of all particles (cells + 1,) int."""
        return np.concatenate([[0], np.cumsum([len(self.templates[k].X) for k in self.kind])])

    @property
    def dimension(self) -> int:
        """Number of dimensions, 2 or 3."""
        return self.centre.shape[1]

    @property
    def size(self) -> int:
        """Number of particles."""
        return int(self.offset[-1])

    @cached_property
    def cell(self) -> np.ndarray:
        """Cell of each particle, from 0 (size,) int."""
        return np.repeat(np.arange(len(self.kind), dtype=np.int32), np.diff(self.offset))

    def field(self, attribute: str) -> np.ndarray:
        """An `attribute` of the templates, such as "V", for all particles by global id (size, ...), in its unit."""
        return np.concatenate([getattr(self.templates[k], attribute) for k in self.kind])

    @cached_property
    def X(self) -> np.ndarray:
        """Reference positions (size, d) [µm]."""
        return self.field("X") + self.centre[self.cell]

    @cached_property
    def material(self) -> np.ndarray:
        """Index in `materials` of the law of each particle (size,) int."""
        parts = [np.where(self.templates[k].nucleus, self.material_of[k][1], self.material_of[k][0]) for k in self.kind]
        return np.concatenate(parts).astype(np.int32)

    def surface(self, cell: int) -> np.ndarray:
        """Global ids of the surface particles of a cell, loop by loop (m,) int."""
        return self.offset[cell] + self.templates[self.kind[cell]].surface
