"""Invariants of a deformation in plane strain, from which material laws compute energy and stress."""

from __future__ import annotations


class PlaneStrain:
    """Base class of material laws: the deformation gradient is F (2, 2, ...) in the plane, and F33 = 1 [-]."""

    def volume_ratio(self, F):
        """Current over reference volume, J = det F [-].  Source: Holzapfel (2000)."""
        (F00, F01), (F10, F11) = F
        return F00 * F11 - F01 * F10

    def first_invariant(self, F):
        """I1 = tr FᵀF [-], in which F33 adds 1.  Source: Holzapfel (2000)."""
        (F00, F01), (F10, F11) = F
        return F00 * F00 + F10 * F10 + F01 * F01 + F11 * F11 + 1.0
