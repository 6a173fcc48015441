"""Cytoplasm: nematic liquid crystal by a simplified Ericksen-Leslie theory, equation (7) of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from numpy import log, sqrt

from ..case.registry import law, quantity
from .continuum import Continuum
from .tensors import cofactors, combined, contracted, outer, product, transposed


@law("material", "nematic")
class Nematic(Continuum):
    r"""Viscous liquid crystal with the Cauchy stress σ = -p I + 2 μ d - η (∇h)ᵀ∇h - ζ h⊗h [Pa].

    d is the rate of deformation [1/µs] and h the director [-].  The pressure is that of a slightly compressible fluid,
    p = -k (J - 1/J) / 2, for J > 0.  A run uses the reduced modulus for k, on which flow and shape depend as little as
    J departs from 1.  With the current gradients g of the angle of h, in space of its three components, the η term is
    -(η/J) Σ g⊗g, the stress of the energy η Σ |g|² / 2 per reference volume.
    Source: equation (7) of Bai, Lin & Zeng (2019), after Lin & Liu (2000); the pressure is Simo & Hughes's (1998).
    """

    density: float = quantity("kg/m^3", "mass density ρ0", "1000 kg/m^3", above=0)
    viscosity: float = quantity("Pa s", "shear viscosity μ", above=0)
    bulk_modulus: float = quantity("Pa", "bulk modulus k of the fluid", above=0)
    reduced_bulk_modulus: float = quantity("Pa", "bulk modulus that a run uses in place of k", above=0)
    eta: float = quantity("pN", "coupling coefficient η of director gradients", "0 pN", minimum=0)
    zeta: float = quantity("Pa", "activity ζ; > 0 extensile, < 0 contractile", "0 Pa")
    stabilisation: float = quantity("", "share that the stabilisation restores of the viscous loss which nodal "
                                    "integration misses", 1.0, minimum=0)

    energy_column = "compression"
    fluid = True
    shear_modulus = 0.0
    numerical_modulus = 0.0  # a fluid has no elastic stabilisation

    @property
    def sound_speed(self) -> float:
        """Speed of sound with the reduced modulus, sqrt(k/ρ) [µm/µs]."""
        return float(sqrt(self.reduced_bulk_modulus / self.density))

    def numerical_viscosity(self, spacing: float) -> float:
        """Viscosity whose loss, as far as nodal integration misses it, is restored [Pa µs], for any `spacing` [µm]."""
        return self.stabilisation * self.viscosity

    def energy(self, F):
        """Energy of compression, per reference volume [Pa]."""
        return self.compression(F)

    def compression(self, F):
        """Energy of compression k (J² - 1 - 2 ln J) / 4, per reference volume [Pa]."""
        J = self.volume_ratio(F)
        return 0.25 * self.reduced_bulk_modulus * (J * J - 1.0 - 2.0 * log(J))

    def stress(self, F):
        """First Piola-Kirchhoff stress of the pressure [Pa], the derivative of the energy by F."""
        return self.pressure_stress(F)

    def pressure_stress(self, F):
        """First Piola-Kirchhoff stress of the pressure, P = -J p F⁻ᵀ [Pa]."""
        return combined((self.mean_stress(F), cofactors(F)))

    def mean_stress(self, F):
        """Cauchy stress -p = k (J - 1/J) / 2 of compression [Pa]."""
        J = self.volume_ratio(F)
        return 0.5 * self.reduced_bulk_modulus * (J - 1.0 / J)

    def viscous_stress(self, F, Fdot):
        """First Piola-Kirchhoff stress P = 2 μ J d F⁻ᵀ [Pa], with d = sym(Ḟ F⁻¹); its power P : Ḟ is dissipated."""
        return self.shear_stress(self.viscosity, F, Fdot)

    def director_energy(self, F, gradient):
        """Energy of the director field η g : g / 2, per reference volume [Pa]."""
        g = self.current_gradient(F, gradient)
        return 0.5 * self.eta * contracted(g, g)

    def director_flux(self, F, gradient):
        """Derivative of the energy of the director field by the reference gradient, a row η F⁻¹ g for each [pN/µm]."""
        return tuple(tuple(self.eta * k for k in self.pulled_back(F, g)) for g in self.current_gradient(F, gradient))

    def director_stress(self, F, gradient):
        """Derivative of the energy of the director field by F, the sum of P = -g⊗(η F⁻¹ g) over its numbers [Pa]."""
        g = self.current_gradient(F, gradient)
        return combined((-1.0, product(transposed(g), self.director_flux(F, gradient))))

    def current_gradient(self, F, gradient):
        """Current gradients F⁻ᵀ g [1/µm] of a director's numbers, from those in the reference configuration [1/µm]."""
        return tuple(self.pushed_forward(F, g) for g in gradient)

    def active_stress(self, F, director):
        """First Piola-Kirchhoff stress of -ζ h⊗h, P = -ζ J h⊗(F⁻¹ h) [Pa]; the `director` h is a unit vector [-]."""
        return combined((-self.zeta * self.volume_ratio(F), outer(director, self.pulled_back(F, director))))

    def out_of_plane(self, F):
        """Cauchy stress normal to the plane, σ33 = -p [Pa]."""
        return self.mean_stress(F)
