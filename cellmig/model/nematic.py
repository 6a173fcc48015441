"""Cytoplasm: simplified Ericksen-Leslie nematic, equation (7)."""

from __future__ import annotations

from numpy import log, sqrt

from ..case.registry import law, quantity


@law("material", "nematic")
class Nematic:
    r"""Viscous liquid crystal, σ = -p I + 2 μ d - η (∇h)ᵀ∇h - ζ h⊗h.   (7)

    The pressure is that of a slightly compressible fluid, p = -k (J - 1/J) / 2.  A run uses the *reduced* modulus
    for k: flow and shape depend on it no more than J departs from 1.  With h = (cos θ, sin θ) the η term is
    -(η/J) g⊗g, g the current gradient of θ: the stress of the energy η |g|² / 2 per reference volume.
    """

    density: float = quantity("kg/m^3", "mass density ρ0", "1000 kg/m^3", above=0)
    viscosity: float = quantity("Pa s", "shear viscosity μ", above=0)
    bulk_modulus: float = quantity("Pa", "bulk modulus k of the fluid", above=0)
    reduced_bulk_modulus: float = quantity("Pa", "bulk modulus that the run uses in place of k", above=0)
    eta: float = quantity("pN", "coupling coefficient η of director gradients", "0 pN", minimum=0)
    zeta: float = quantity("Pa", "activity ζ; > 0 extensile, < 0 contractile", "0 Pa")
    stabilisation: float = quantity("", "viscosity of the numerical stabilisation over μ", 4.0, minimum=0)

    energy_column = "compression"
    shear_modulus = 0.0
    numerical_modulus = 0.0  # a fluid has no shape to go back to

    @property
    def sound_speed(self) -> float:
        """Speed of sound with the reduced modulus, sqrt(k/ρ) [µm/µs]."""
        return float(sqrt(self.reduced_bulk_modulus / self.density))

    def numerical_viscosity(self, spacing: float) -> float:
        """Viscosity of the viscous stabilisation [Pa µs], whatever the `spacing` [µm]: calibrated on shear waves."""
        return self.stabilisation * self.viscosity

    def energy(self, F):
        """Energy per reference volume, that of compression [Pa]."""
        return self.compression(F)

    def compression(self, F):
        """Energy of compression, k (J² - 1 - 2 ln J) / 4 [Pa]."""
        (F00, F01), (F10, F11) = F
        J = F00 * F11 - F01 * F10
        return 0.25 * self.reduced_bulk_modulus * (J * J - 1.0 - 2.0 * log(J))

    def stress(self, F):
        """First Piola-Kirchhoff stress of the energy, that of the pressure [Pa]."""
        return self.pressure_stress(F)

    def pressure_stress(self, F):
        """Stress of the pressure, P = -J p F⁻ᵀ [Pa]."""
        (F00, F01), (F10, F11) = F
        J = F00 * F11 - F01 * F10
        mean = 0.5 * self.reduced_bulk_modulus * (J - 1.0 / J)
        return (mean * F11, -mean * F10), (-mean * F01, mean * F00)

    def viscous_stress(self, F, Fdot):
        """First Piola-Kirchhoff stress P = J 2μ d F⁻ᵀ [Pa], with d = sym(Ḟ F⁻¹); its power P : Ḟ is lost."""
        (F00, F01), (F10, F11) = F
        (R00, R01), (R10, R11) = Fdot
        k = 2.0 * self.viscosity * (1.0 / (F00 * F11 - F01 * F10))  # the pressure's 1/J, divided once
        s00 = k * (R00 * F11 - R01 * F10)
        s11 = k * (R11 * F00 - R10 * F01)
        s01 = 0.5 * k * (R01 * F00 - R00 * F01 + R10 * F11 - R11 * F10)
        return ((s00 * F11 - s01 * F01, s01 * F00 - s00 * F10),
                (s01 * F11 - s11 * F01, s11 * F00 - s01 * F10))

    def current_gradient(self, F, gradient):
        """Current gradient of θ, g = F⁻ᵀ ∇₀θ, from its reference gradient [1/µm]."""
        (F00, F01), (F10, F11) = F
        a, b = gradient
        rJ = 1.0 / (F00 * F11 - F01 * F10)
        return (F11 * a - F10 * b) * rJ, (F00 * b - F01 * a) * rJ

    def director_energy(self, F, gradient):
        """Energy of the director field η |g|² / 2 per reference volume [Pa]."""
        g0, g1 = self.current_gradient(F, gradient)
        return 0.5 * self.eta * (g0 * g0 + g1 * g1)

    def director_flux(self, F, gradient):
        """η F⁻¹ g [pN/µm]: derivative of the director's energy by ∇₀θ."""
        (F00, F01), (F10, F11) = F
        g0, g1 = self.current_gradient(F, gradient)
        rJ = 1.0 / (F00 * F11 - F01 * F10)
        return self.eta * rJ * (F11 * g0 - F01 * g1), self.eta * rJ * (F00 * g1 - F10 * g0)

    def director_stress(self, F, gradient):
        """P = -g⊗(η F⁻¹ g) [Pa]: derivative of the director's energy by F."""
        g0, g1 = self.current_gradient(F, gradient)
        k0, k1 = self.director_flux(F, gradient)
        return (-g0 * k0, -g0 * k1), (-g1 * k0, -g1 * k1)

    def active_stress(self, F, director):
        """P of -ζ h⊗h [Pa]: -ζ J h⊗(F⁻¹ h), director h of unit length [-]."""
        (F00, F01), (F10, F11) = F
        h0, h1 = director
        k0 = -self.zeta * (F11 * h0 - F01 * h1)
        k1 = -self.zeta * (F00 * h1 - F10 * h0)
        return (h0 * k0, h0 * k1), (h1 * k0, h1 * k1)

    def out_of_plane(self, F):
        """Cauchy stress across the plane σ33 = -p [Pa]."""
        (F00, F01), (F10, F11) = F
        J = F00 * F11 - F01 * F10
        return 0.5 * self.reduced_bulk_modulus * (J - 1.0 / J)
