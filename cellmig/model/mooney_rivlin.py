"""Nucleus: modified Mooney-Rivlin solid, equations (8) and (9) of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from numpy import cbrt, log, sqrt

from ..case.registry import law, quantity
from .continuum import Continuum
from .tensors import SPACE, cofactors, combined, contracted, product, transposed


@law("material", "mooney-rivlin")
class MooneyRivlin(Continuum):
    r"""Hyperelastic solid with the energy W = C1 (I1 - 3 I3^{1/3}) + C2 (I2 - 3 I3^{2/3}) + λ/2 (ln I3)² [Pa].

    C = FᵀF has the invariants I1 = tr C, I2 = (I1² - tr C²)/2 and I3 = det C > 0; in plane strain the third principal
    stretch is 1.  At rest, the shear modulus is G = 2 (C1 + C2) and the bulk modulus K = 4 λ [Pa].
    Source: equations (8) and (9) of Bai, Lin & Zeng (2019), after Fried & Johnson (1988).
    """

    density: float = quantity("kg/m^3", "mass density ρ0", "1000 kg/m^3", above=0)
    C1: float = quantity("Pa", "first constant C1 of equation (8)", above=0)
    C2: float = quantity("Pa", "second constant C2 of equation (8)", minimum=0)
    volumetric_modulus: float = quantity("Pa", "volumetric constant λ of equation (8), a quarter of the bulk modulus",
                                         above=0, formerly="lame")
    stabilisation: float = quantity("", "viscosity of the stabilisation over ρ c h, with c = sqrt(G/ρ)", 0.05,
                                    minimum=0)
    hourglass_modulus: float = quantity("", "modulus of the stabilisation over G", 0.16, minimum=0,
                                        formerly="stiffening")

    energy_column = "elastic"
    viscosity = 0.0

    @property
    def shear_modulus(self) -> float:
        """Shear modulus at rest G = 2 (C1 + C2) [Pa]."""
        return 2.0 * (self.C1 + self.C2)

    @property
    def bulk_modulus(self) -> float:
        """Bulk modulus at rest K = 4 λ [Pa]."""
        return 4.0 * self.volumetric_modulus

    @property
    def sound_speed(self) -> float:
        """Speed of compression waves at rest, sqrt((K + 4G/3)/ρ) [µm/µs]."""
        return float(sqrt((self.bulk_modulus + 4.0 / 3.0 * self.shear_modulus) / self.density))

    @property
    def numerical_modulus(self) -> float:
        """Modulus of the elastic stabilisation [Pa]."""
        return self.hourglass_modulus * self.shear_modulus

    def numerical_viscosity(self, spacing: float) -> float:
        """Viscosity of the stabilisation [Pa µs], in proportion to the `spacing` of particles [µm]."""
        return self.stabilisation * float(sqrt(self.density * self.shear_modulus)) * spacing

    def energy(self, F):
        """Energy W per reference volume [Pa], equation (8)."""
        C = product(transposed(F), F)
        I1, I3 = self.first_invariant(F), self.volume_ratio(F) ** 2
        I2 = 0.5 * (I1 * I1 - contracted(C, C) - float(SPACE - len(F)))
        a = cbrt(I3)
        volume = 0.5 * self.volumetric_modulus * log(I3) ** 2
        return self.C1 * (I1 - 3.0 * a) + self.C2 * (I2 - 3.0 * a * a) + volume

    def stress(self, F):
        """First Piola-Kirchhoff stress P = F S [Pa], with S of equation (9)."""
        J = self.volume_ratio(F)
        I3 = J * J
        a = cbrt(I3)
        first = 2.0 * (self.C1 + self.C2 * self.first_invariant(F))
        third = 2.0 * (self.volumetric_modulus * log(I3) - self.C1 * a - 2.0 * self.C2 * a * a) / J
        FC = product(F, product(transposed(F), F))
        return combined((first, F), (-2.0 * self.C2, FC), (third, cofactors(F)))

    def out_of_plane(self, F):
        """Cauchy stress normal to the plane, σ33 = S33 / J [Pa]."""
        J, I1 = self.volume_ratio(F), self.first_invariant(F)
        I3 = J * J
        a = cbrt(I3)
        third = self.C1 * a + 2.0 * self.C2 * a * a - self.volumetric_modulus * log(I3)
        return 2.0 * (self.C1 + self.C2 * (I1 - 1.0) - third) / J
