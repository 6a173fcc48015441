"""Friction on the substrate: an addition to the model of Bai, Lin & Zeng (2019), absent by default."""

from __future__ import annotations

from ..case.registry import law, quantity


@law("friction", "bonds")
class BondFriction:
    """Viscous drag t = c s v of a membrane on the substrate, with the share s of closed bonds and the sliding speed v.

    Source: derived here, as the friction of bonds that break and form again, linear in the speed.
    """

    coefficient: float = quantity("Pa us/um", "drag c of a fully bonded membrane, per reference area and speed",
                                  minimum=0)

    def drag(self, share, speed):
        """Traction t [Pa] against the motion; `share` of closed bonds s [-], `speed` along the substrate v [µm/µs]."""
        return self.coefficient * share * speed
