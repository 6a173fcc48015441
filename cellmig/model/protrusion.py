"""Protrusion F_d of equation (2) of Bai, Lin & Zeng (2019): the push of the leading edge."""

from __future__ import annotations

from dataclasses import dataclass

from numpy import maximum, minimum, sqrt, where

from ..case.pointwise import Vector, between
from ..case.registry import law, parameter, quantity
from .adhesion import Pieces, SegmentBonds
from .protocols import ProtrusionLaw

LEVEL = 1e-6  # of the height of the pushing edge: segments less inclined are level


@law("protrusion", "edge")
class EdgeProtrusion:
    r"""Push along a direction p̂, proportional to the adhesion energy, on the front half of a cell near the substrate.

    The direction is `direction`, +x by default, or where cells have a polarity p that of p, and |p| is then a factor.

    The force per reference length is β α c N σ S'(g) [pN/µm] at the height g, with S = u² (3 - 2u), u = g/ℓ in [0, 1]:
    it vanishes at the substrate (g = 0) and where the membrane is high (g >= ℓ; ℓ is at most the cutoff of the bonds).
    Bonded membrane, at g = ε, has S' = 6 ε/ℓ² and less: 0.06 per µm for bonds of 10 nm and ℓ = 1 µm, so that the edge
    pushes; 0.29 per µm for those of 50 nm, so that the front half of a spread cell pushes more than its edge.
    The factor α in [0, 1] varies along the surface.  The factor c = min(1, B/ℓ), where B is the length of closed bonds
    under the front half, makes the push depend on adhesion: without bonds there is none, and at a height of 30 ε it is
    less than 0.2 % of the full one.  The front half begins gradually, over ℓ, at the mean of the surface along p̂, which
    is computed in every step.  A share `basal` pushes outwards on every side besides: on both in the plane, in space in
    eight directions.
    With a `stall` the push saturates with the density of bonds, while their friction goes on to grow: a cell is fastest
    on some of the ligands (DiMilla, Barbee & Lauffenburger 1991, Biophys. J. 60:15-37).
    S' and B are integrated exactly along surface segments, so that the push converges with the spacing; the attraction
    N U'(g) itself would not, as its range ε is far less than a segment.
    Source: derived here from F_d of Bai, Lin & Zeng (2019), which acts on the front half, is proportional to the
    adhesion and has a random factor.
    """

    cells: tuple = parameter("names of the cells that protrude", items="cell")
    protrusion_ratio: float = quantity("", "push over adhesion energy β", 0.06, minimum=0,
                                       formerly="strength")
    height: float = quantity("um", "height ℓ of the pushing edge, at most the cutoff of the bonds", "1 um", above=0)
    random: bool = parameter("whether α is random in [0, 1]; otherwise it is 1/2", True)
    correlation_length: float = quantity("um", "distance of the points at which α is drawn; it is linear between them",
                                         "0.4 um", above=0, formerly="patch")
    direction: tuple = quantity("", "direction p̂ along the substrate, of any length: [1] or [-1], in space [x, y]; by "
                                "default +x; a polarity takes its place", (), shape=(None,))
    basal: float = quantity("", "push outwards on every side, whatever the polarity, over that of |p| = 1", 0.0,
                            minimum=0)
    gate: float | None = quantity("um", "distance from other cells below which the membrane does not push; from half "
                                  "of it on gradually", None, above=0)

    stall: float | None = quantity("pN/um", "push F_s of bonds without end: β N σ becomes F_s N/(N + F_s/(β σ)); by "
                                   "default it grows with the bonds without limit", None, above=0)

    def push(self, work):
        """Push β N σ [pN/µm] of α = 1, up to its stall, for the work of adhesion N σ [pN/µm]."""
        push = self.protrusion_ratio * work
        return push if self.stall is None else push / (1.0 + push / self.stall)

    def front(self, x):
        """Factor of the front half [-], from 0 to 1, at a distance x ahead of the mean of the surface [µm]."""
        return minimum(maximum(0.5 + x / self.height, 0.0), 1.0)

    def hold(self, bonded):
        """Factor c [-] for the length `bonded` of closed bonds under the front half, B [µm]."""
        return minimum(bonded / self.height, 1.0)

    def ramp(self, g):
        """S(g) [-] at the height g [µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return u * u * (3.0 - 2.0 * u)

    def ramp_slope(self, g):
        """Derivative dS/dg [1/µm] at the height g [µm]."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return 6.0 * u * (1.0 - u) / self.height

    def ramp_primitive(self, g):
        """Primitive of S [µm] at the height g [µm], zero below g = 0."""
        u = minimum(maximum(g / self.height, 0.0), 1.0)
        return self.height * u * u * u * (1.0 - 0.5 * u) + maximum(g - self.height, 0.0)


def mean_slope(law: ProtrusionLaw, gap1, gap2):
    """Mean of S' [1/µm] along a straight piece from one gap to the other [µm]."""
    rise = gap2 - gap1
    inclined = abs(rise) > LEVEL * law.height
    return where(inclined, (law.ramp(gap2) - law.ramp(gap1)) / where(inclined, rise, 1.0),
                 law.ramp_slope(0.5 * (gap1 + gap2)))


@dataclass(frozen=True)
class ProtrusionForce:
    """Push of a cell on a segment of its surface along one direction, which is x in what follows.

    law : of protrusion, as EdgeProtrusion is;  bonds : SegmentBonds of the substrate.
    """

    law: ProtrusionLaw
    bonds: SegmentBonds

    def grip(self, length, ahead, gap1, gap2):
        """Length of closed bonds [µm] that counts to the front half; `ahead` of the middle of the cell [µm]."""
        return maximum(self.bonds.closed(gap1, gap2), 0.0) * length * self.law.front(ahead)

    def hold(self, bonded):
        """Share of the push [-] for a length of closed bonds [µm] under the front half."""
        return self.law.hold(bonded)

    def force(self, size: Vector, hold, length, ahead: Vector, gap: Vector):
        """Forces on both ends [pN/µm]; `size` : β α N σ/2 [pN/µm]; `hold` : see there; lengths in µm."""
        (size1, size2), (ahead1, ahead2) = size, ahead
        share, edge = hold * length, mean_slope(self.law, *gap)
        return ((size1 * share * self.law.front(ahead1) * edge, 0.0),
                (size2 * share * self.law.front(ahead2) * edge, 0.0))


@dataclass(frozen=True)
class PushOff(Pieces):
    """Push of a cell off another body, such as a gel: of a segment S of its surface beside an edge of that.

    It is the push off the substrate, with the gap to the edge as the height, and the bonds between both bodies.  On the
    cell it acts along the edge, as much as that is along p̂; on the edge it is opposite, with a couple, so that forces
    and moments are in balance to rounding.  Membrane beside a vertex does not push.

    Source: derived here.

    law : of protrusion, as EdgeProtrusion is;  bonds : SegmentBonds of the two bodies.
    """

    law: ProtrusionLaw
    bonds: SegmentBonds

    def grip(self, length, low, high, ahead: Vector, end1: Vector, end2: Vector, start: Vector, end: Vector):
        """Length of closed bonds [µm] of the piece that counts to the front half; `ahead` as in `force`."""
        limits = self.limits(low, high, (end1, end2), (start, end))
        middle, (ahead1, ahead2) = 0.5 * (low + high), ahead
        closed = maximum(self.bonds.closed(limits[0][2], limits[1][2]), 0.0)
        return closed * length * (high - low) * self.law.front((1.0 - middle) * ahead1 + middle * ahead2)

    def hold(self, bonded):
        """Share of the push [-] for a length of closed bonds [µm] under the front half."""
        return self.law.hold(bonded)

    def force(self, size: Vector, hold, way, length, low, high, ahead: Vector,
              end1: Vector, end2: Vector, start: Vector, end: Vector):
        """Forces on both ends of S and of the edge [pN/µm] of the piece from ξ = low to high, half of it at either.

        size : β α N σ/2 at both ends of S [pN/µm];  hold : see there;  way : p along x [-];  length : of S at rest
        [µm];  ahead : of both ends of S, along p̂ from the middle of the cell [µm];  places of S and of the edge [µm].
        """
        limits = self.limits(low, high, (end1, end2), (start, end))
        (size1, size2), (ahead1, ahead2), (ex, ey) = size, ahead, between(start, end)
        share = hold * length * (high - low) * mean_slope(self.law, limits[0][2], limits[1][2])
        along = way * ex / sqrt(ex * ex + ey * ey)
        forces = [share * along * ((1.0 - xi) * size1 + xi * size2)
                  * self.law.front((1.0 - xi) * ahead1 + xi * ahead2) for xi, *_ in limits]
        return self.opposed(limits, forces, (start, end))
