"""Kinematics of a continuum, from which material laws compute energy and stress."""

from __future__ import annotations

from .tensors import SPACE, applied, cofactors, combined, contracted, determinant, product, transposed, with_transpose


class Continuum:
    """Base class of material laws: the deformation gradient is F (2, 2, ...) in plane strain or (3, 3, ...) [-]."""

    fluid = False

    def volume_ratio(self, F):
        """Current over reference volume, J = det F [-].  Source: Holzapfel (2000)."""
        return determinant(F)

    def pulled_back(self, F, a):
        """F⁻¹ a, of a vector a in the current configuration, in its unit.  Source: Holzapfel (2000)."""
        rJ = 1.0 / self.volume_ratio(F)
        return tuple(x * rJ for x in applied(transposed(cofactors(F)), a))

    def pushed_forward(self, F, a):
        """F⁻ᵀ a, of a gradient a in the reference configuration, in its unit.  Source: Holzapfel (2000)."""
        rJ = 1.0 / self.volume_ratio(F)
        return tuple(x * rJ for x in applied(cofactors(F), a))

    def first_invariant(self, F):
        """I1 = tr FᵀF [-], to which the third direction of plane strain adds 1.  Source: Holzapfel (2000)."""
        return contracted(F, F) + float(SPACE - len(F))

    def shear_stress(self, viscosity, F, Fdot):
        """First Piola-Kirchhoff stress 2 μ J d F⁻ᵀ [Pa], with d = sym(Ḟ F⁻¹), of a viscosity μ [Pa µs].

        Source: Holzapfel (2000).
        """
        cofactor = cofactors(F)
        k = viscosity * (1.0 / self.volume_ratio(F))  # 1/J is that of the pressure: one division in C
        return product(combined((k, with_transpose(product(Fdot, transposed(cofactor))))), cofactor)
