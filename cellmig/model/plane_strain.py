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

    def shear_stress(self, viscosity, F, Fdot):
        """First Piola-Kirchhoff stress 2 μ J d F⁻ᵀ [Pa], with d = sym(Ḟ F⁻¹), of a viscosity μ [Pa µs]."""
        (F00, F01), (F10, F11) = F
        (R00, R01), (R10, R11) = Fdot
        k = 2.0 * viscosity * (1.0 / self.volume_ratio(F))  # 1/J is that of the pressure: one division in C
        s00 = k * (R00 * F11 - R01 * F10)
        s11 = k * (R11 * F00 - R10 * F01)
        s01 = 0.5 * k * (R01 * F00 - R00 * F01 + R10 * F11 - R11 * F10)
        return ((s00 * F11 - s01 * F01, s01 * F00 - s00 * F10),
                (s01 * F11 - s11 * F01, s11 * F00 - s01 * F10))
