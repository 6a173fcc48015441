"""Clutches between flowing actin and a substrate that yields: motors, and bonds that load and fail."""

from __future__ import annotations

import math

from ..case.registry import law, parameter, quantity


@law("response", "clutches")
class Clutches:
    r"""Push of an edge from the traction of a motor-clutch module on the substrate there.

    Motors with the stall force F_s = n_m F_m move actin backwards at v = v_u (1 - F/F_s), F being the traction.  An
    open one of n_c clutches closes at the rate k_on, and is then a spring κ_c between actin and the substrate, at rest
    when it closes; under its force f it opens at the rate k_off exp(f/F_b).  The substrate is a spring κ_s that all
    closed clutches of a module share: F = κ_s x_s = Σ κ_c (x_i - x_s).  Each side of a cell that protrudes has a
    module of its own, on the substrate below the edge there.  Its mean traction over F_s from one knot of the polarity
    to the next is the factor of the push on that side until the knot after.  Times between knots should be longer than
    cycles of load and fail, which take 1/k_on and more.

    On a soft substrate the clutches let go before the motors have loaded it, on a stiff one each is torn off before
    others have closed to share the load; in between the traction is largest.  Nothing in the law says at which
    stiffness.

    An incompressible half-space with the modulus E, pulled evenly along a disc of radius a, is the spring
    κ_s = 4π a E/9 at its centre, by Cerruti's solution: ∫ (1 - ν/2)/(2π G r) dA/(π a²) = 9/(4π a E).  Under a post of
    a micropillar array κ_s is the spring of the post itself.

    The parameters by default are those of filopodia of neurons.

    Source: Chan & Odde (2008), Science 322:1687-1691; what moves the optimum: Bangasser, Rosenfeld & Odde (2013),
    Biophys. J. 105:581-592; cells on gradients: Isomursu et al. (2022), Nature Materials 21:1081-1090; Cerruti's
    solution: Johnson (1985), Contact Mechanics, section 3.6.
    """

    motors: int = parameter("number n_m of motors in a module", 75, minimum=1, maximum=100_000)
    motor_force: float = quantity("pN", "force F_m at which a motor stalls", "2 pN", above=0)
    speed: float = quantity("nm/s", "speed v_u of actin that nothing holds", "120 nm/s", above=0)
    clutches: int = parameter("number n_c of clutches in a module", 75, minimum=1, maximum=100_000)
    stiffness: float = quantity("pN/nm", "stiffness κ_c of a clutch", "5 pN/nm", above=0)
    on: float = quantity("1/s", "rate k_on at which an open clutch closes", "1 1/s", above=0)
    off: float = quantity("1/s", "rate k_off at which a closed clutch without force opens", "0.1 1/s", above=0)
    force: float = quantity("pN", "force F_b that makes a clutch open e times as fast", "2 pN", above=0)
    adhesion_radius: float = quantity("um", "radius a of the adhesion by which a module pulls on the substrate",
                                      "0.5 um", above=0)

    @property
    def stall(self) -> float:
        """Stall force F_s = n_m F_m of all motors [pN]."""
        return self.motors * self.motor_force

    def spring(self, modulus):
        """Spring κ_s [pN/µm] of a substrate with Young's modulus E [Pa]."""
        return 4.0 * math.pi / 9.0 * self.adhesion_radius * modulus

    def modulus(self, spring):
        """Young's modulus E [Pa] of a substrate that is a spring κ_s [pN/µm]."""
        return spring / self.spring(1.0)
