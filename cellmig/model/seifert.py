"""Adhesion between surfaces by bonds with Seifert's potential, equations (3) to (6) of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any, ClassVar

from numpy import log, maximum, minimum, where

from ..case.registry import law, laws, quantity
from .protocols import Adhesion

WALL = 24.0  # least N σ of the repulsion between surfaces [pN/µm], also if they have fewer bonds or none


@law("adhesion", "seifert")
class Seifert:
    r"""Bonds of length r with the energy U(r) = σ [(ε/r)⁴ - 2 (ε/r)²] [pN µm], -σ at r = ε; N per reference area.

    There are three additions.  Below 0.8 ε the potential continues as its quadratic Taylor polynomial, with continuous
    second derivative, so that its stiffness is bounded.  A linear function makes it reach zero with zero slope at the
    cutoff.  For bodies that repel but do not adhere, the attraction beyond ε is multiplied by a, from 1 (the original
    bonds) to 0 (repulsion alone, U = σ [(ε/r)² - 1]² below ε).
    Source: Seifert (1991); equations (3) to (6) of Bai, Lin & Zeng (2019).
    """

    bond_density: float = quantity("1/um^2", "bond density N", minimum=0, formerly="bonds")
    well_depth: float = quantity("pN um", "depth σ of the well", minimum=0, formerly="energy")
    equilibrium_distance: float = quantity("um", "equilibrium distance ε", above=0, formerly="range")
    cutoff: float = quantity("um", "distance beyond which surfaces do not interact", "1 um", above=0)
    attraction: float = quantity("", "factor a of the attraction; the repulsion has none", 1, minimum=0, maximum=1)

    quadratic: ClassVar[float] = 0.8  # length over ε below which the potential is quadratic [-]

    @property
    def work(self) -> float:
        """Work of adhesion w = a N σ [pN/µm]."""
        return self.attraction * self.bond_density * self.well_depth

    @property
    def solid(self: Any) -> Any:
        """The same adhesion with a repulsion of at least WALL [pN/µm], which keeps surfaces with few bonds apart."""
        if self.bond_density * self.well_depth >= WALL:
            return self
        depth = self.well_depth or 1.0
        return replace(self, well_depth=depth, bond_density=WALL / depth, attraction=self.work / WALL)

    @property
    def cap(self) -> float:
        """Length below which the potential is quadratic, 0.8 ε [µm]."""
        return self.quadratic * self.equilibrium_distance

    def stiffness(self, least: float) -> float:
        """Largest stiffness N U'' [Pa/µm] for gaps of at least `least` [µm]."""
        eps = self.equilibrium_distance
        q = (eps / max(least, self.cap)) ** 2
        share = 1.0 if least < eps else self.attraction
        return share * self.bond_density * self.well_depth / eps**2 * max(q * q * (20.0 * q - 12.0), 0.0)

    @property
    def lift(self) -> float:
        """Energy (1 - a) σ [pN µm], added below ε, which makes the potential continuous there."""
        return (1.0 - self.attraction) * self.well_depth

    @property
    def well_primitive(self) -> float:
        """Constant, added below ε, which makes the primitive continuous there [pN µm²]."""
        eps = self.equilibrium_distance
        return -(1.0 - self.attraction) * self.pair_primitive(eps) - self.lift * eps

    @property
    def shift(self) -> float:
        """Slope of the attraction at the cutoff [pN], which is subtracted."""
        return self.attraction * self.cut_slope

    @property
    def cap_potential(self) -> float:
        """U at the cap [pN µm]."""
        return float(self.pair(self.cap))

    @property
    def cap_slope(self) -> float:
        """U' at the cap [pN]."""
        return float(self.pair_slope(self.cap))

    @property
    def cap_curvature(self) -> float:
        """U'' at the cap [pN/µm]."""
        return self.well_depth / self.equilibrium_distance**2 * (20.0 / self.quadratic**6 - 12.0 / self.quadratic**4)

    @property
    def cut_potential(self) -> float:
        """U at the cutoff [pN µm]."""
        return float(self.pair(self.cutoff))

    @property
    def cut_slope(self) -> float:
        """U' at the cutoff [pN]."""
        return float(self.pair_slope(self.cutoff))

    @property
    def cap_primitive(self) -> float:
        """Primitive of the uncut potential at the cap [pN µm²]."""
        return float(self.pair_primitive(self.cap))

    @property
    def cut_primitive(self) -> float:
        """Primitive of the uncut potential at the cutoff [pN µm²]."""
        return float(self.pair_primitive(self.cutoff))

    @property
    def cap_second(self) -> float:
        """Second primitive of the uncut potential at the cap [pN µm³]."""
        return float(self.pair_second(self.cap))

    @property
    def cut_second(self) -> float:
        """Second primitive of the uncut potential at the cutoff [pN µm³]."""
        return float(self.pair_second(self.cutoff))

    @property
    def well_second(self) -> float:
        """Constant, added below ε, which makes the second primitive continuous there [pN µm³]."""
        eps = self.equilibrium_distance
        raised = eps * (self.well_primitive + 0.5 * eps * self.lift)
        return float((self.attraction - 1.0) * self.pair_second(eps)) - raised

    def pair(self, r):
        """Energy U [pN µm] of a bond of length r [µm], equation (3) without additions."""
        q = (self.equilibrium_distance / r) ** 2
        return self.well_depth * (q * q - 2.0 * q)

    def pair_slope(self, r):
        """Derivative dU/dr [pN] of equation (3) at the length r [µm]; the force of equation (4) is its negative."""
        q = (self.equilibrium_distance / r) ** 2
        return -4.0 * self.well_depth * (q * q - q) / r

    def pair_primitive(self, r):
        """Primitive of equation (3), σ [2 ε²/r - ε⁴/(3 r³)] [pN µm²], at the length r [µm]."""
        q = (self.equilibrium_distance / r) ** 2
        return self.well_depth * r * (2.0 * q - q * q / 3.0)

    def pair_second(self, r):
        """Second primitive of equation (3), σ [2 ε² ln(r/rc) + ε⁴/(6 r²)] [pN µm³], at the length r [µm]."""
        e2 = self.equilibrium_distance * self.equilibrium_distance
        return self.well_depth * e2 * (2.0 * log(r / self.cutoff) + e2 / (6.0 * r * r))

    def potential(self, r):
        """Energy of a bond of length r [µm], with all additions [pN µm]."""
        s = r - self.cap
        inner = self.cap_potential + s * (self.cap_slope + 0.5 * s * self.cap_curvature)
        uncut = where(r < self.cap, inner, self.pair(where(r < self.cap, self.cap, r)))
        shared = where(r < self.equilibrium_distance, uncut + self.lift, self.attraction * uncut)
        cut = shared - self.attraction * self.cut_potential - self.shift * (r - self.cutoff)
        return where(r < self.cutoff, cut, 0.0)

    def slope(self, r):
        """Derivative of the potential at the length r [µm], minus the force of a bond [pN]."""
        inner = self.cap_slope + (r - self.cap) * self.cap_curvature
        uncut = where(r < self.cap, inner, self.pair_slope(where(r < self.cap, self.cap, r)))
        shared = where(r < self.equilibrium_distance, uncut, self.attraction * uncut)
        return where(r < self.cutoff, shared - self.shift, 0.0)

    def closed_form(self, gap1, gap2):
        """Positive [µm] where `mean` holds: between cap and cutoff, with weaker attraction on one side of ε."""
        least, most, eps = minimum(gap1, gap2), maximum(gap1, gap2), self.equilibrium_distance
        one_side = where(self.attraction < 1.0, maximum(least - eps, eps - most), 1.0)
        return minimum(minimum(least - self.cap, self.cutoff - most), one_side)

    def mean(self, gap1, gap2):
        """Mean of the potential [pN µm] over gaps that go linearly from gap1 to gap2, and its derivatives [pN].

        Source: ∫ r⁻² dr and ∫ r⁻⁴ dr, divided by the change of r without cancellation.
        """
        p, q, eps = 1.0 / gap1, 1.0 / gap2, self.equilibrium_distance
        pq, near = p * q, gap1 + gap2 < 2.0 * eps
        share = where(near, 1.0, self.attraction)
        e2, size = eps * eps, share * self.well_depth * pq
        third = e2 * e2 / 3.0
        mean = size * (third * (p * p + pq + q * q) - 2.0 * e2)
        by_gap1 = -size * p * (third * (3.0 * p * p + 2.0 * pq + q * q) - 2.0 * e2)
        by_gap2 = -size * q * (third * (3.0 * q * q + 2.0 * pq + p * p) - 2.0 * e2)
        offset = where(near, self.lift, 0.0) - self.attraction * self.cut_potential
        return (mean + offset - self.shift * (0.5 * (gap1 + gap2) - self.cutoff), by_gap1 - 0.5 * self.shift,
                by_gap2 - 0.5 * self.shift)

    def primitive(self, r):
        """Primitive Ψ of the potential, zero beyond the cutoff [pN µm²], for its exact integral along a segment."""
        s = r - self.cap
        inner = self.cap_primitive + s * (
            self.cap_potential + s * (0.5 * self.cap_slope + s * self.cap_curvature / 6.0)
        )
        uncut = where(r < self.cap, inner, self.pair_primitive(where(r < self.cap, self.cap, r)))
        raised = uncut + self.lift * r + self.well_primitive
        shared = where(r < self.equilibrium_distance, raised, self.attraction * uncut)
        t = r - self.cutoff
        cut = shared - self.attraction * (self.cut_primitive + t * self.cut_potential) - 0.5 * t * t * self.shift
        return where(r < self.cutoff, cut, 0.0)

    def second_primitive(self, r):
        """Primitive of that, zero beyond the cutoff [pN µm³], for the exact integral of the potential over a triangle.

        Source: equation (3) and its additions, integrated twice.
        """
        s = r - self.cap
        inner = self.cap_second + s * (self.cap_primitive + s * (
            0.5 * self.cap_potential + s * (self.cap_slope / 6.0 + s * self.cap_curvature / 24.0)))
        uncut = where(r < self.cap, inner, self.pair_second(where(r < self.cap, self.cap, r)))
        raised = uncut + r * (0.5 * self.lift * r + self.well_primitive) + self.well_second
        shared = where(r < self.equilibrium_distance, raised, self.attraction * uncut)
        t = r - self.cutoff
        beyond = self.cut_second + t * (self.cut_primitive + 0.5 * t * self.cut_potential)
        cut = shared - self.attraction * beyond - t * t * t * self.shift / 6.0
        return where(r < self.cutoff, cut, 0.0)


class BetweenCells(Seifert):
    """The same bonds with a higher wall: the corner of a cell, on which few of them act, is pressed closer."""

    quadratic = 0.3

    @classmethod
    def of(cls, law: Adhesion) -> Adhesion:
        """The bonds of a law between cells; those of other laws stay as they are."""
        bonds: Any = law
        if isinstance(law, Seifert):
            bonds = cls(**asdict(bonds))
        return bonds


def solid(law: Adhesion) -> Adhesion:
    """The law of adhesion, of bonds or without any, with a repulsion that keeps surfaces apart."""
    if law.work == 0.0:
        eps = law.equilibrium_distance
        law = laws("adhesion")["seifert"](bond_density=0.0, well_depth=0.0, equilibrium_distance=eps, cutoff=law.cutoff)
    return getattr(law, "solid", law)
