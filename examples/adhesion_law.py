"""A new law of adhesion, in use from the moment its class is there: bonds that pull to 30 nm and then let go.

It is written here so that the example is whole.  In a file of its own in cellmig/model it is found by its name from
every case file, listed by `cellmig schema`, and checked by the tests that go over all laws.

.venv/bin/python examples/adhesion_law.py
"""

from numpy import where

import cellmig
from cellmig.case.registry import law, quantity


@law("adhesion", "spring")
class Spring:
    r"""Bonds with U(r) = -σ (1 - s²)², s = (r - ε)/(c - ε), from ε to the cutoff c; below ε a spring as stiff."""

    bond_density: float = quantity("1/um^2", "bond density N", minimum=0)
    well_depth: float = quantity("pN um", "depth of the well σ", minimum=0)
    equilibrium_distance: float = quantity("um", "equilibrium distance ε", above=0)
    cutoff: float = quantity("um", "distance c at which a bond lets go", "30 nm", above=0)

    @property
    def work(self) -> float:
        """Work of adhesion w = N σ [pN/µm]."""
        return self.bond_density * self.well_depth

    @property
    def cap(self) -> float:
        """Distance below which the potential is quadratic, ε [µm]."""
        return self.equilibrium_distance

    @property
    def width(self) -> float:
        """Width of the well, c - ε [µm]."""
        return self.cutoff - self.equilibrium_distance

    def stiffness(self, least: float) -> float:
        """Largest N U'' [Pa/µm] of a contact whose gaps are at least `least` [µm]: the time step follows it."""
        s = max(0.0, (least - self.equilibrium_distance) / self.width)
        return self.work / self.width**2 * max(0.0, 4.0 - 12.0 * s * s)

    def potential(self, r):
        """U, the energy of a bond of length r [pN µm]."""
        s = (r - self.equilibrium_distance) / self.width
        well = where(s > 0.0, (1.0 - s * s) * (1.0 - s * s), 1.0 - 2.0 * s * s)
        return where(s < 1.0, -self.well_depth * well, 0.0)

    def slope(self, r):
        """dU/dr, minus the bond's force [pN]."""
        s = (r - self.equilibrium_distance) / self.width
        pull = where(s > 0.0, 4.0 * s * (1.0 - s * s), 4.0 * s)
        return where(s < 1.0, self.well_depth / self.width * pull, 0.0)

    def primitive(self, r):
        """Primitive of U, zero from the cutoff on [pN µm²]: integrates it along a surface exactly."""
        s = (r - self.equilibrium_distance) / self.width
        area = s - s * s * s * (2.0 / 3.0) + where(s > 0.0, 0.2 * s * s * s * s * s, 0.0)
        return where(s < 1.0, self.well_depth * self.width * (8.0 / 15.0 - area), 0.0)


case = cellmig.load(cellmig.CASES / "one_cell.toml")
coarse = cellmig.change(case, {"particles.per_cell": 300, "time.end": "40 us", "time.frames": 4, "time.samples": 40})
bonds = {"bond_density": "8000 /um^2", "well_depth": "0.03 pN um", "equilibrium_distance": "10 nm"}

contact = {}
for name in ("seifert", "spring"):
    changed = cellmig.change(coarse, {"adhesion.substrate": {"law": name, **bonds}})
    record = cellmig.run(changed, out=f"output/adhesion_law/{name}", quiet=True)
    contact[name] = record.table("history")["substrate_contact_um"][-1]
    error = record.table("ledger")["energy_error"].max()
    print(f"{name}: contact with the substrate {contact[name]:.2f} um after 40 us; "
          f"energy error {100 * error:.2g} %")
