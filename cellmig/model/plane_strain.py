"""Invariants of a deformation in plane strain, from which material laws compute energy and stress."""

from __future__ import annotations


class PlaneStrain:
    """Base class of material laws: the deformation gradient is F (2, 2, ...) in the plane, and F33 = 1 [-]."""

    def volume_ratio(self, F):
        """Current over reference volume, J = det F [-].  Source: Holzapfel (2000)."""
        (F00, F01), (F10, F11) = F
        return F00 * F11 - F01 * F10

    def pulled_back(self, F, a):
        """F⁻¹ a, of a vector a in the current configuration, in its unit.  Source: Holzapfel (2000)."""
        (F00, F01), (F10, F11) = F
        a0, a1 = a
        rJ = 1.0 / self.volume_ratio(F)
        return (F11 * a0 - F01 * a1) * rJ, (F00 * a1 - F10 * a0) * rJ

    def first_invariant(self, F):
        """I1 = tr FᵀF [-], in which F33 adds 1.  Source: Holzapfel (2000)."""
        (F00, F01), (F10, F11) = F
        return F00 * F00 + F10 * F10 + F01 * F01 + F11 * F11 + 1.0
