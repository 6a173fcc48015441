"""Cytoplasm with a network whose bonds break and form again: an addition to the model of Bai, Lin & Zeng (2019)."""

from __future__ import annotations

from numpy import exp, log, maximum, sqrt, tanh

from ..case.registry import law, quantity
from .nematic import Nematic
from .tensors import cofactors, combined, contracted, determinant, identity, product, transposed


@law("material", "maxwell")
class Maxwell(Nematic):
    r"""The fluid of equation (7) and a network whose bonds break at the rate 1/τ, and form again without stress.

    A material point remembers A, the mean of C⁻¹ at which its present bonds formed; A = I at first, and

        dA/dt = (C⁻¹ - A)/τ,   b = F A Fᵀ,   W = G (tr b - 3 - ln det b) / 2,   σ = G (b - I) / J.

    This is the upper-convected Maxwell model of shear modulus G and viscosity G τ: an elastic solid within τ, a fluid
    for longer.  What bonds lose is G (tr b + tr b⁻¹ - 6) / 2τ ≥ 0.  In plane strain A33 stays 1.

    A step replaces a share of the bonds at its begin, and another at its end, by bonds without stress.  The shares are
    such that A is exact where C⁻¹ changes linearly in time: at a constant strain, and to second order at any other.
    A stays positive definite, and steps far longer than τ leave the stress of the viscosity G τ.

    Source: Green & Tobolsky (1946); Lubliner (1985) for A = C_v⁻¹; shares of a step: derived here.
    """

    energy_column = "elastic"  # of the ledger, for the energies of fluid and network

    shear_modulus: float = quantity("Pa", "shear modulus G of the network", above=0)
    relaxation_time: float = quantity("us", "relaxation time τ, the mean life of a bond", above=0)

    @property
    def sound_speed(self) -> float:
        """Speed of compression waves far faster than τ, sqrt((k + 2 G)/ρ), with the reduced modulus k [µm/µs]."""
        return float(sqrt((self.reduced_bulk_modulus + 2.0 * self.shear_modulus) / self.density))

    @property
    def slow_viscosity(self) -> float:
        """Viscosity μ + G τ of flows far slower than τ [Pa µs]."""
        return self.viscosity + self.shear_modulus * self.relaxation_time

    def energy(self, F, network=None):
        """Energy of compression and of the network A [-], by default A = I, per reference volume [Pa]."""
        A = identity(len(F)) if network is None else network
        b = contracted(product(transposed(F), F), A)
        stretched = b - float(len(F)) - 2.0 * log(self.volume_ratio(F)) - log(determinant(A))
        return self.compression(F) + 0.5 * self.shear_modulus * stretched

    def stress(self, F, network=None, share=0.0):
        """First Piola-Kirchhoff stress of pressure and network, P = -J p F⁻ᵀ + (1 - share) G (F A - F⁻ᵀ) [Pa].

        `share` [-] : of the bonds of A, those that form anew at F.
        """
        A = identity(len(F)) if network is None else network
        g = (1.0 - share) * self.shear_modulus
        return combined((1.0, self.pressure_stress(F)), (g, product(F, A)),
                        (-g / self.volume_ratio(F), cofactors(F)))

    def network_shares(self, time):
        """Shares [-] of the bonds that form anew at the begin and at the end of a step of a `time` [µs].

        With r = time/τ and κ = (1 - exp(-r))/r they are 1 - exp(-r)/κ and 1 - κ; tanh keeps digits of a small r.
        """
        r = maximum(time / self.relaxation_time, 1e-300)
        left, slope = exp(-r), tanh(0.5 * r) / (0.5 * r)
        return 1.0 - 2.0 * left / ((1.0 + left) * slope), 1.0 - 0.5 * (1.0 + left) * slope

    def network_renewed(self, F, network, share):
        """A [-] after a `share` of the bonds has formed anew at F, (1 - share) A + share C⁻¹."""
        return combined((1.0 - share, network), (share, self.unstressed(F)))

    def unstressed(self, F):
        """C⁻¹, the A of a network without stress [-]."""
        c, J = cofactors(F), self.volume_ratio(F)
        return combined((1.0 / (J * J), product(transposed(c), c)))

    def network_loss(self, F, network):
        """Dissipation G (tr b + tr b⁻¹ - 6) / 2τ of the network A, per reference volume [Pa/µs]."""
        C, rJ = product(transposed(F), F), 1.0 / determinant(network)
        b, inverse = contracted(C, network), contracted(self.unstressed(F), cofactors(network)) * rJ
        return 0.5 * self.shear_modulus / self.relaxation_time * (b + inverse - 2.0 * float(len(F)))

    def out_of_plane(self, F):
        """Cauchy stress normal to the plane, σ33 = -p [Pa]: there the network has no stretch."""
        return self.mean_stress(F)
