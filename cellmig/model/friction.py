"""Friction on the substrate: an addition to the paper's model, absent unless a case asks for it."""

from __future__ import annotations

from ..case.registry import law, quantity


@law("friction", "bonds")
class BondFriction:
    """Drag of the bonds on a membrane that slides along the substrate, in proportion to how far they are closed."""

    coefficient: float = quantity("Pa us/um", "drag c of fully bonded membrane, over reference area and speed",
                                  minimum=0)

    def drag(self, share, speed):
        """Traction against the motion [Pa] for a share of closed bonds [-] and a speed along the substrate [µm/µs]."""
        return self.coefficient * share * speed
