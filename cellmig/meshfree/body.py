"""Reference configuration of a cell: a template for each kind of cell, shared by all its copies.

The number of dimensions D is 2 or 3; in the plane, volumes and masses are per unit thickness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from scipy import sparse

from ..case.expression import Expression, evaluate
from ..geometry import polygons
from ..geometry.even_surface import unevenness
from ..geometry.polyhedra import Polyhedron
from . import rkpm
from .operators import largest, strain_operator
from .recovery import recovery
from .simplices import Gradient, averaged, by_area, edges_of, exchanged, facet_sizes, nodal_volumes, shape_gradients
from .stabilisation import laplacian, missed

STRIP = 3.0  # height [spacings] of the strips in which particles are numbered, so that neighbours are close in memory


@dataclass(frozen=True)
class Template:
    """A discretised cell, with its centre as origin; particles are numbered by material, then in strips.

    Attributes
    ----------
    X : (n, D) -- reference positions [µm].
    V : (n,) -- volumes in nodal integrals [µm^D].
    heaviness : (n,) -- masses over ρ0 V [-].
    nucleus : (n,) bool -- whether a particle belongs to the nucleus.
    surface : (m,) int -- surface particles; in the plane along closed loops, the outer one counterclockwise, holes
        clockwise.
    after : (m,) int -- in the plane, index in `surface` of the next particle on the loop; none in space.
    triangles : (t, 3) int -- triangles of the surface, counterclockwise from outside; none in the plane.
    simplices : (k, D + 1) int -- triangles or tetrahedra that fill the body; those of cocircular particles overlap.
    parts : dict of (k,) int -- by name of a part of the boundary, indices of its facets.
    G : (n, n) CSR for each direction -- derivatives of the shape functions at the particles, of one pattern [1/µm].
    C : (n, n) CSR -- Laplacians at the particles, zero for linear fields [1/µm²].
    bending_weight : (n,) -- dissipation of the stabilisation over |C v|² at rest [Pa µs µm^(D + 2)].
    bending_modulus : (n,) -- twice the energy of the elastic stabilisation over |C u|² [Pa µm^(D + 2)].
    missed : (n,) -- what nodal integrals of |∇f|² miss over |C f|² [µm^(D + 2)].
    R : (n, n) CSR -- recovery of stress [-].
    spacing : float -- mean distance of particles h [µm].
    laws : tuple -- material laws of body and nucleus; the latter is None if there is no nucleus.
    damping : (n,) -- bulk viscosity of the numerical damping [Pa µs].
    dilation : float -- support radius of RKPM over the spacing, 0 for averages of finite elements [-].
    grade : (n,) or None -- elastic moduli over those of the laws [-]; None where they are those.
    x0, F0 : (n, D) [µm], (n, D, D) [-], or None -- positions from the centre and deformation gradients when the
        neighbours were found, where that was not in the reference configuration: see `renewal.renewed`.
    along : (m,) or (m, 3) [µm] or None -- places of the surface particles along the reference outline, ascending along
        each loop from its first particle, in space on the reference surface, where the surface was divided anew: see
        `division.divided` and `division_space.divided_in_space`.
    present : (t, 3) int or None -- triangles of the surface since it was divided anew in space.
    """

    X: np.ndarray
    V: np.ndarray
    heaviness: np.ndarray
    nucleus: np.ndarray
    surface: np.ndarray
    after: np.ndarray
    triangles: np.ndarray
    simplices: np.ndarray
    parts: dict[str, np.ndarray]
    G: Gradient
    C: sparse.csr_matrix
    bending_weight: np.ndarray
    bending_modulus: np.ndarray
    missed: np.ndarray
    R: sparse.csr_matrix
    spacing: float
    laws: tuple
    damping: np.ndarray
    dilation: float
    grade: np.ndarray | None = None
    x0: np.ndarray | None = None
    F0: np.ndarray | None = None
    along: np.ndarray | None = None
    present: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only: all cells of a kind share them."""
        of_matrices = [a for m in (*self.G, self.C, self.R) for a in (m.data, m.indices, m.indptr)]
        for one in (*vars(self).values(), *self.parts.values(), *of_matrices):
            if isinstance(one, np.ndarray):
                one.setflags(write=False)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the fields that another rank has sent."""
        vars(self).update(state)
        self.__post_init__()

    @cached_property
    def base(self) -> np.ndarray:
        """Deformation gradients [-] and a row of Laplacians C x [1/µm] where u = 0 (n, D + 1, D), to which G u and C u
        add: the identity and zero but where neighbours were found anew.  Source: derived here.
        """
        n, D = self.X.shape
        at_zero = np.concatenate([np.eye(D), np.zeros((1, D))])
        if self.x0 is None or self.F0 is None:
            return np.broadcast_to(at_zero, (n, D + 1, D))
        u = self.x0 - self.X
        gradient = np.stack([g @ u for g in self.G], axis=2)
        return np.concatenate([self.F0 - gradient, -(self.C @ u)[:, None]], axis=1)

    @cached_property
    def places(self) -> np.ndarray:
        """Indices in `surface` of the corners of the facets (m, D) int."""
        if self.X.shape[1] == 2:
            return np.column_stack([np.arange(len(self.after)), self.after])
        return np.searchsorted(self.surface, self.triangles if self.present is None else self.present)

    @cached_property
    def polyhedron(self) -> Polyhedron:
        """Edges of the surface, and neighbours of its particles, by indices in `surface`; in space only."""
        return Polyhedron.of(self.places)

    @cached_property
    def facets(self) -> np.ndarray:
        """Particles at the corners of the segments or triangles of the surface (m, D) int."""
        return self.surface[self.places]

    @cached_property
    def outer(self) -> np.ndarray:
        """Whether facets are on the outer surface (m,) bool; bodies in space have no cavities."""
        return self.loop == 0 if self.X.shape[1] == 2 else np.ones(len(self.triangles), bool)

    @cached_property
    def before(self) -> np.ndarray:
        """Index in `surface` of the previous particle on the loop (m,) int."""
        return np.argsort(self.after)

    @cached_property
    def loop(self) -> np.ndarray:
        """Number of the loop of each surface particle, 0 for the outer one (m,) int."""
        return np.append(0, np.cumsum(self.after[:-1] != np.arange(1, len(self.after))))

    def _by_law(self, attribute: str, *default: float) -> np.ndarray:
        body, nucleus = self.laws
        inside = getattr(nucleus if nucleus is not None else body, attribute, *default)
        return np.where(self.nucleus, inside, getattr(body, attribute, *default))

    @cached_property
    def mass(self) -> np.ndarray:
        """Lumped masses ρ0 V times the heaviness (n,) [fg], in the plane per unit thickness [fg/µm]."""
        return self._by_law("density") * self.V * self.heaviness

    @cached_property
    def radius(self) -> float:
        """Radius of the disc of the same area, or the ball of the same volume [µm]."""
        content = float(self.V.sum())
        return float(np.sqrt(content / np.pi) if self.X.shape[1] == 2 else np.cbrt(0.75 * content / np.pi))

    @cached_property
    def facet_size(self) -> np.ndarray:
        """Reference lengths [µm] or areas [µm²] of the facets (m,)."""
        if self.X.shape[1] == 3:
            size = facet_sizes(self.on_reference[self.places])
            return size if self.along is None else size * (facet_sizes(self.X[self.triangles]).sum() / size.sum())
        size = facet_sizes(self.X[self.facets])
        if self.along is None:
            return size
        closes = self.after <= np.arange(len(self.after))
        return self.along[self.after] - self.along + np.where(closes, np.bincount(self.loop, size)[self.loop], 0.0)

    @property
    def on_reference(self) -> np.ndarray:
        """Places of the surface particles on the reference surface (m, 3) [µm]; in space only."""
        return self.X[self.surface] if self.along is None else self.along

    @cached_property
    def unevenness(self) -> float:
        """Longest edge of the surface over least height of its triangles when neighbours were found [-]; in space."""
        return unevenness((self.X if self.x0 is None else self.x0)[self.facets])

    @cached_property
    def size_per_mass(self) -> np.ndarray:
        """Share of the facets' sizes over the mass (n,), zero inside [µm²/fg]."""
        share = np.zeros(len(self.X))
        np.add.at(share, self.facets, self.facet_size[:, None] / self.X.shape[1])
        return share / self.mass

    @cached_property
    def drawn_per_mass(self) -> np.ndarray:
        """Row sums of the stiffness of a surface under tension, over tension and mass (n,), zero inside [1/fg].

        A segment of length L has the stiffness 1/L; a triangle of area A with the edges e has |eᵢ·eⱼ|/4A, where its
        surface was divided anew with those of then.
        """
        x = (self.X if self.x0 is None or self.present is None else self.x0)[self.facets]
        if self.X.shape[1] == 2:
            rows = 2.0 / self.facet_size[:, None].repeat(2, axis=1)
        else:
            edges = np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1)  # opposite of each corner
            rows = np.abs(edges @ edges.transpose(0, 2, 1)).sum(axis=2) / (4.0 * facet_sizes(x)[:, None])
        total = np.zeros(len(self.X))
        np.add.at(total, self.facets, rows)
        return total / self.mass

    @cached_property
    def viscosity(self) -> np.ndarray:
        """Shear viscosities μ (n,) [Pa µs]."""
        return self._by_law("viscosity")

    @cached_property
    def shear_modulus(self) -> np.ndarray:
        """Shear moduli at rest (n,) [Pa]."""
        return self._by_law("shear_modulus") * self.grades

    @property
    def grades(self) -> np.ndarray:
        """Elastic moduli over those of the laws (n,) [-]."""
        return np.ones(len(self.X)) if self.grade is None else self.grade

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
        return self._by_law("density") * self._by_law("sound_speed") ** 2 * self.grades

    @cached_property
    def bound(self) -> np.ndarray:
        """Components of K = Σ_J G⊗G/m_J (n, 3) or (n, 6): squared frequency per volume and modulus.

        First those of the diagonal, then 01, or 01, 02, 12; their unit is 1/(µm fg), or 1/(µm² fg) in space.  Source:
        derived here.
        """
        G, by_mass = self.G, sparse.diags(1.0 / self.mass)
        pairs = [(k, k) for k in range(len(G))] + list(combinations(range(len(G)), 2))
        return np.column_stack([np.asarray((G[i].multiply(G[j]) @ by_mass).sum(axis=1)).ravel() for i, j in pairs])

    def local_bound(self, weight: np.ndarray) -> float:
        """Largest V_I w_I λmax(Σ_J G⊗G/m_J) at rest, for a `weight` w (n,) [Pa] in [1/µs²], or [Pa µs] in [1/µs].

        The step control follows its change with the deformation.  Source: derived here, a bound on the rate of each
        particle's own mode.
        """
        if len(self.G) == 2:
            a, b, c = self.bound.T
            top = 0.5 * (a + b) + np.sqrt(0.25 * (a - b) ** 2 + c**2)
        else:
            top = np.linalg.eigvalsh(self.bound[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]])[:, -1]
        return float((self.V * weight * top).max())

    @cached_property
    def S(self) -> sparse.csr_matrix:
        """Viscous stabilisation at rest (n, n) CSR [Pa µs]: the forces are -S v, the dissipated power is v·S v."""
        return (self.C.T @ sparse.diags(self.bending_weight) @ self.C).tocsr()

    @cached_property
    def E(self) -> sparse.csr_matrix:
        """Elastic stabilisation (n, n) CSR [Pa]: the forces are -E u, the energy is u·E u/2."""
        return (self.C.T @ sparse.diags(self.bending_modulus) @ self.C).tocsr()

    @cached_property
    def director_modulus(self) -> np.ndarray:
        """What nodal integrals miss of twice the energy of a director in space, over |C h|² (n,) [pN µm^(D + 2)]."""
        return self.missed * self._by_law("eta", 0.0)

    @cached_property
    def diffusion(self) -> float:
        """Largest eigenvalue of -V⁻¹ div V grad [1/µm²], rounded up: the fastest relaxation rate per diffusivity."""
        return largest(self._relaxation, len(self.X))

    @property
    def _relaxation(self) -> sparse.csr_matrix:
        """Operator of -V⁻¹ div V grad (n, n) [1/µm²], made symmetric; in space with what nodal integrals miss."""
        V, root = sparse.diags(self.V), sparse.diags(1.0 / np.sqrt(self.V))
        parts = [(V, g @ root) for g in self.G]
        parts += [(sparse.diags(self.missed), self.C @ root)] if len(self.G) == 3 else []
        return sum(g.T @ weight @ g for weight, g in parts)

    @cached_property
    def relaxation(self) -> np.ndarray:
        """Rates per diffusivity at which single values relax (n,) [1/µm²]."""
        return np.asarray(self._relaxation.diagonal())

    @cached_property
    def rates(self) -> tuple[float, float, float, float]:
        """Largest damping rates of the stabilisation and of the viscosities [1/µs], and largest frequencies² of sound
        and of the elastic stabilisation [1/µs²].

        These are the largest eigenvalues, rounded up, of M⁻¹ times the operators linearised at rest.
        """
        n, D = self.X.shape
        scale = sparse.diags(1.0 / np.sqrt(self.mass))
        G = tuple(g @ scale for g in self.G)
        viscous = strain_operator(G, self.V, self.viscosity, self.damping)
        elastic = strain_operator(G, self.V, self.shear_modulus, self.dilation_modulus)
        return (largest(scale @ self.S @ scale, n), largest(viscous, D * n), largest(elastic, D * n),
                largest(scale @ self.E @ scale, n))


def template(shape: Any, count: int, dilation: float, laws: tuple, bulk_viscosity: float,
             refinement: float = 1.0, solve: Callable[..., np.ndarray] = rkpm.factorised,
             grade: float | Expression = 1.0) -> Template:
    """Discretise a shape.

    Parameters
    ----------
    shape : law of kind shape -- gives layout and, in the plane, area.
    count : int -- number of particles.
    dilation : float -- support radius of RKPM over the spacing; 0 for averaged gradients of linear finite elements [-].
    laws : tuple -- material laws of body and nucleus, the latter None without one.
    bulk_viscosity : float -- of the numerical damping, over ρ c h [-].
    refinement : float -- density of particles along the surface over that inside [-].
    solve : function -- as for `rkpm.consistent`.
    grade : float or formula -- elastic moduli over those of the laws [-].
    """
    layout = shape.particles(count, refinement)
    X, D = polygons.snapped(layout.X), layout.X.shape[1]
    spacing = float(np.sqrt(shape.area / count)) if D == 2 else _spacing(X, layout)
    order = _order(X, spacing, layout.nucleus if laws[1] is not None else np.zeros(count, bool))
    place = np.empty(count, int)
    place[order] = np.arange(count)
    X, nucleus = X[order], layout.nucleus[order] & (laws[1] is not None)
    if D == 2:
        surface, after, triangles = place[layout.surface], layout.next, np.zeros((0, 3), int)
        facets = np.column_stack([surface, surface[after]])
        simplices, share = rkpm.triangulated(X, facets)
    else:
        facets = triangles = place[layout.triangles]
        surface, after, simplices = np.unique(facets), np.zeros(0, int), place[layout.tetrahedra]
        share = np.ones(len(simplices))
    V = nodal_volumes(count, simplices, share * np.abs(shape_gradients(X, simplices)[1]))
    edges = edges_of(simplices)
    support = rkpm.supports(X, edges, dilation * spacing)
    if dilation:
        across = (facets, None) if D == 2 else (None, edges)
        G = rkpm.consistent(rkpm.gradients(X, support, *across), X, V, support, facets, solve)
    else:
        G = averaged(X, simplices, share)
    body, inner = laws
    inner = inner if inner is not None else body
    viscosity = np.where(nucleus, inner.numerical_viscosity(spacing), body.numerical_viscosity(spacing))
    C, square = laplacian(X, edges)
    weight = missed(D, dilation) * V * square
    modulus = np.where(nucleus, inner.numerical_modulus, body.numerical_modulus)
    wave = np.where(nucleus, inner.density * inner.sound_speed, body.density * body.sound_speed)
    relative = None if grade == 1.0 else evaluate(grade, X)
    R = recovery(X, G[0], support, nucleus)
    parts = {"surface": np.arange(len(facets)), **(getattr(layout, "parts", None) or {})}
    density = np.where(nucleus, inner.density, body.density)
    heaviness = exchanged(V, density, X, edges) / (density * V) if D == 2 else by_area(X, V, triangles) / V
    return Template(X, V, heaviness, nucleus, surface, after, triangles, simplices, parts, G, C, weight * viscosity,
                    weight * modulus * (1.0 if relative is None else relative), weight, R, spacing, laws,
                    bulk_viscosity * spacing * wave, dilation, relative)


def _spacing(X: np.ndarray, layout: Any) -> float:
    """Spacing h [µm] in space: h³ is the volume of a particle, of which those on the surface have half."""
    volume = np.abs(shape_gradients(X, layout.tetrahedra)[1]).sum()
    return float(np.cbrt(volume / (len(X) - 0.5 * len(np.unique(layout.triangles)))))


def _order(X: np.ndarray, spacing: float, nucleus: np.ndarray) -> np.ndarray:
    """Order (n,) int of particles: those of the nucleus first, then in strips along x, which near ones share."""
    place = np.rint(X / (1e-6 * spacing)).T  # the order does not depend on the last bits
    strips = np.floor(place[1:] / (1e6 * STRIP) + 0.5)
    return np.lexsort((*place[:0:-1], place[0], *strips, ~nucleus))
