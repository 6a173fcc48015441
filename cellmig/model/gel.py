"""Cytoplasm with an elastic cytoskeleton: an addition to the model of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from numpy import cbrt, sqrt

from ..case.registry import law, quantity
from .nematic import Nematic
from .tensors import cofactors, combined


@law("material", "gel")
class Gel(Nematic):
    r"""The fluid of equation (7) and an elastic network, W = G (J^{-2/3} I1 - 3) / 2 with I1 = tr C + 1 in the plane.

    G is the shear modulus [Pa], and J > 0; the fluid has the parameters of the law nematic.
    Source: the neo-Hookean network of Treloar (1943), with the isochoric deformation of Flory (1961).
    """

    energy_column = "elastic"  # of the ledger, for the energies of fluid and network
    fluid = False

    shear_modulus: float = quantity("Pa", "shear modulus G of the network", minimum=0)

    @property
    def sound_speed(self) -> float:
        """Speed of compression waves, sqrt((k + 4G/3)/ρ), with the reduced modulus k [µm/µs]."""
        return float(sqrt((self.reduced_bulk_modulus + 4.0 / 3.0 * self.shear_modulus) / self.density))

    def energy(self, F):
        """Energy of compression and of the network, per reference volume [Pa]."""
        J, I1 = self.volume_ratio(F), self.first_invariant(F)
        return self.compression(F) + 0.5 * self.shear_modulus * (I1 / cbrt(J * J) - 3.0)

    def stress(self, F):
        """First Piola-Kirchhoff stress of pressure and network, P = -J p F⁻ᵀ + G J^{-2/3} (F - I1/3 F⁻ᵀ) [Pa]."""
        J, I1 = self.volume_ratio(F), self.first_invariant(F)
        g = self.shear_modulus / cbrt(J * J)
        return combined((1.0, self.pressure_stress(F)), (g, F), (-g * I1 / (3.0 * J), cofactors(F)))

    def out_of_plane(self, F):
        """Cauchy stress normal to the plane, σ33 = -p + G J^{-5/3} (1 - I1/3) [Pa]."""
        J, I1 = self.volume_ratio(F), self.first_invariant(F)
        network = self.shear_modulus / (cbrt(J * J) * J) * (1.0 - I1 / 3.0)
        return self.mean_stress(F) + network
