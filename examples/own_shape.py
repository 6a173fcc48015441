"""A cell of one's own shape, from an outline: points of a picture, of a CSV file or, as here, of a formula.

.venv/bin/python examples/own_shape.py
"""

from pathlib import Path

import numpy as np

import cellmig

out = Path("output/own_shape")
out.mkdir(parents=True, exist_ok=True)

# An outline about the cell's centre [um], in either sense, as dense as it comes: a cell with a broad front.
angle = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
radius = 4.5 * (1.0 + 0.12 * np.cos(angle) - 0.08 * np.cos(2.0 * angle) + 0.05 * np.sin(3.0 * angle))
outline = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
np.savetxt(out / "outline.csv", outline, "%.4f", ",", header="x_um,y_um", comments="")

rest = 0.01 - outline[:, 1].min()  # height of the centre: the lowest point is 10 nm above the substrate
cell = {"name": "Cell-1", "shape": "polygon", "corners": str(out / "outline.csv"), "nucleus_ratio": 0.283,
        "material": "cytoplasm", "nucleus": "nucleus", "centre": ["0 um", f"{rest:.6f} um"]}
case = cellmig.load(cellmig.CASES / "one_cell.toml")
case = cellmig.change(case, {"cells": [cell], "protrusion.cells": ["Cell-1"], "particles.per_cell": 400,
                             "time.end": "40 us", "time.frames": 4, "time.samples": 40})

record = cellmig.run(case, out=out / "run", quiet=True)
frame = record.frame(0.0)
print(f"{len(frame['x'])} particles, of which {int((frame['surface'] >= 0).sum())} on the surface")
history = record.table("history")
print(f"moved by {history['ux_um'][-1]:.2f} um in {history['time_us'][-1]:g} us")
record.picture([0.0, 40.0]).savefig(out / "shapes.png")
