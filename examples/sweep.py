"""A sweep and a plot of one's own: how far a cell spreads, against the density of bonds.  Run it again: it is kept.

.venv/bin/python examples/sweep.py
"""

from matplotlib.figure import Figure

import cellmig

rows = cellmig.sweep(
    cellmig.CASES / "one_cell.toml",
    {"adhesion.substrate.bond_density": ["4000 /um^2", "8000 /um^2", "16000 /um^2"],
     "cortex.line_tension": ["20 pN/um", "80 pN/um"]},
    out="output/example_sweep", sets=["particles.per_cell=150", "time.end=20 us", "time.samples=20", "time.frames=1"])

cells = [row for row in rows if row["cell"] == 1]
figure = Figure(figsize=(4, 3), layout="constrained")
ax = figure.subplots()
for tension in (20.0, 80.0):
    line = [row for row in cells if row["cortex.line_tension [pN/um]"] == tension]
    bonds = [row["adhesion.substrate.bond_density [/um^2]"] for row in line]
    contact = [row["substrate_contact_um"] for row in line]
    ax.plot(bonds, contact, "o-", label=f"cortical tension {tension:g} pN/µm")
    print(f"tension {tension:g} pN/um: contact {', '.join(f'{length:.2f}' for length in contact)} um after 20 us")
ax.set(xlabel="bonds per area [1/µm²]", ylabel="contact with the substrate [µm]")
ax.legend()
figure.savefig("output/example_sweep/contact.png", dpi=200)
