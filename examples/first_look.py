"""Load a case, change it, run it, and look at what it left: a pandas frame, arrays, a picture.

.venv/bin/python examples/first_look.py
"""

import numpy as np

import cellmig

case = cellmig.load(cellmig.CASES / "one_cell.toml")
coarse = cellmig.change(case, {"particles.per_cell": 300, "time.end": "20 us", "time.frames": 4, "time.samples": 40})
record = cellmig.run(coarse, out="output/first_look")

history = record.history  # a row for each sample and cell; cell 0 is the aggregate
cell = history[history["cell"] == 1].set_index("time_us")
print(cell[["substrate_contact_um", "effective_stress_pa"]].iloc[::10].round(2))

frame = record.frame(20.0)  # the fields of all particles, as arrays
nucleus = frame["material"] == 0  # materials count in the order of the case file
height = np.ptp(frame["x"][:, 1])
mean = frame["effective_stress"][nucleus].mean()
print(f"at {frame['time']:g} us: {height:.2f} um high, effective stress in the nucleus {mean:.0f} Pa")

record.picture([0.0, 20.0]).savefig("output/first_look/shapes.png")
