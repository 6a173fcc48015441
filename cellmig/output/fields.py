"""Declarations of the fields of frames and the columns of tables: meaning, symbol, unit, shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Field:
    """A field of a frame, by particle.

    symbol, unit, meaning : text;  shape : () scalar, (2,) vector in the plane, (3, 3) tensor;  term : the term of the
    scene that it needs, or "".
    """

    symbol: str
    unit: str
    shape: tuple[int, ...]
    meaning: str
    term: str = ""

    @property
    def stored(self) -> int:
        """Size of a particle in files, where vectors have three components [B]."""
        return 8 * int(np.prod([3 if n == 2 else n for n in self.shape]))


FIELDS = {
    "id": Field("", "1", (), "number of the particle, the same in all frames and on any number of ranks"),
    "cell": Field("", "1", (), "number of its cell, from 1, as in history.csv"),
    "material": Field("", "1", (), "number of its material, from 0, in the order of the case"),
    "surface": Field("", "1", (), "place along the outline of its cell, loop by loop with one number left out between; "
                                  "-1 inside"),
    "X": Field("X", "um", (2,), "position at the start"),
    "u": Field("u", "um", (2,), "displacement: it is at X + u, which is where the files have their points"),
    "v": Field("v", "um/us", (2,), "velocity; of the leapfrog half a step before"),
    "stress": Field("σ", "Pa", (3, 3), "Cauchy stress, recovered: linear fits over neighbours in the same material"),
    "effective_stress": Field("σₑ", "Pa", (), "von Mises stress of it"),
    "J": Field("J", "1", (), "volume over that at the start"),
    "pressure": Field("p", "Pa", (), "minus a third of the trace of the stress"),
    "director": Field("h", "1", (2,), "director, of length 1", "director"),
    "adhesion_force": Field("F_cs", "pN/um", (2,), "force of the bonds to the substrate, at the instant", "substrate"),
    "contact_force": Field("F_cc", "pN/um", (2,), "force of other cells but their drag, at the instant", "contact"),
    "sliding_force": Field("", "pN/um", (2,), "drag of the bonds to other cells or bodies, at the instant", "sliding"),
    "push_off_force": Field("", "pN/um", (2,), "push of cells off other bodies, and its reaction, at the instant",
                            "push_off"),
    "friction_force": Field("", "pN/um", (2,), "drag of the bonds to the substrate, at the instant", "friction"),
    "protrusion_force": Field("F_d", "pN/um", (2,), "push of the protrusion, at the instant", "protrusion"),
}


def field_unit(name: str, dimension: int) -> str:
    """Unit of a field: forces are per µm of thickness in two dimensions."""
    unit = FIELDS[name].unit
    return unit.removesuffix("/um") if dimension > 2 and unit == "pN/um" else unit


# Columns of tables besides time, names and instants.
_TRACTION = (("`x_um`; in 3D also `y_um`", "middle of a piece of the substrate, in three dimensions of a square; all "
              "are as wide as the largest spacing of particles"),
             ("`normal_pa`", "traction of the cell away from the substrate: > 0 where it pulls it up, < 0 where it "
              "presses"),
             ("`tangential_pa`; in 3D `tangential_x_pa`, `tangential_y_pa`", "traction along the substrate: drag of "
              "the bonds, and the reaction to the push of the protrusion"),
             ("`friction_pa`; in 3D `friction_x_pa`, `friction_y_pa`", "the part of it that is drag; nan without "
              "friction"))
_PAIR = (("`cell`, `neighbour`", "numbers of two cells that touch, from 1, the lower first"),
         ("`force_x_pn_per_um`, `force_y_pn_per_um`; in 3D `force_x_pn`, `force_y_pn`, `force_z_pn`",
          "force on `cell` by `neighbour`, which has the opposite"),
         ("`pull_pn_per_um`; in 3D `pull_pn`",
          "that along the line of their centres, > 0 where it draws them together"),
         ("`cell_contact_um`; in 3D `cell_contact_um2`",
          "contact at the sample, as in `history.csv`: mean of both sides"))

_TRACK = (("`id`, `time_us`, `x_um`, `y_um`; in 3D also `z_um`", "name of a cell, time, its centre of mass, in the "
           "order of celltrackR: `read.tracks.csv(\"tracks.csv\", sep = \",\", pos.columns = 3:4)`"),)
_CUE = (("`polarity`; in 3D `polarity_x`, `polarity_y`", "polarity of the cell"),
        ("`push_pn_per_um`; in 3D `push_x_pn`, `push_y_pn`", "push of its protrusion along the substrate"),
        ("number and law of each cue, such as `0_occupancy` for `cues.0`; in 3D with `_x`, `_y`", "its part in the sum "
         "towards which the polarity relaxes, at the last knot"))
_MOLECULES = (("time", "up to which the field is known: that of its last knot"),
              ("`field`", "name of the field; all amounts are since the start, in 2D per µm of thickness: "
                          "`secreted_per_um`"),
              ("`secreted`, `taken_up`", "molecules that the cell, or all of them, secreted and took up"),
              ("`inside`, `start`", "molecules in the box, then and at the start; 0 for a field that is steady"),
              ("`out`", "molecules that left through walls, less those that came in"),
              ("`decayed`", "molecules that decayed"),
              ("`lost`", "error of the account: inside + taken_up + out + decayed - secreted - start; a run ends in "
                         "which it is more than 1e-12 of their sizes, with all that passed walls"))


_ABOUT_FIELDS = """
## Fields of a frame

By particle, under these names in `rankNNNN/s*.h5`, where each has its unit as an attribute, in `cells.xdmf` (for
ParaView) and in `rankNNNN.xdmf` (for meshio, too), where `Unit` tells it.  Vectors have a third component there, in two
dimensions 0.  Forces are per µm of thickness, in three dimensions in pN.  A field whose term the scene lacks is not
there.  The unit of times, here µs, is that of the case, in which it writes `time.end`; each file has it as `time_unit`.

| field | symbol | unit | shape | term | meaning |
|---|---|---|---|---|---|
"""
_ABOUT_TABLES = """
## Tables of a run

Units are in the names of the columns; that of times is the one in which the case writes `time.end`: a case of hours has
`time_h` and `vx_um_per_h`.  `name` is the cell's, `all` that of the aggregate.

- `history.csv`: `vx_um_per_us`, `vy_um_per_us`, `speed_um_per_us`: mean since the last sample, displacement over time.
- `history.csv`: `neighbours` is the number of cells that touch it, of the aggregate their mean.
- `history.csv` where bodies drag on each other, or push off each other, such as cells and a gel: `strain_energy_pn` is
  the energy of the strain of a body, `dipole_pn` is ∫ (x - x̄) T dx, T the drag and push of others on it along x, at the
  sample, in space both in pN µm; that of a gel is below zero where cells contract it. A rigid substrate is not
  displaced: it has none of both.
- `history.csv` in three dimensions: `height_um` is that of a cell's top over the substrate, of the aggregate the
  largest; `sphericity` is the surface of a ball of the same volume over that of the cell, 1 for a ball (Wadell 1935).
- `ledger.csv` is in pN, energy per µm of thickness: `external_work` is that of the protrusion, loads, plates, supports,
  activity and body forces, `friction_loss` what drag on the substrate and between bodies took,
  `medium_loss` what the liquid around the cells did, `network_loss` what bonds of a network lost that broke,
  `renewal_loss` the energy that was lost where neighbours were found anew (`numerics.renewal`).
- `substrate.csv` and `neighbours.csv` have forces as means since the last sample: impulse over time, of every step that
  was taken.  At an instant forces ring with each bond that snaps; columns with `now` have those at the sample itself.
  The first sample has no means; a place or a pair without a row had no force.  The mean force on a particle is spread
  over the way that it went, in three dimensions over the rectangle around it.  Tractions of all places times their
  width, in three dimensions its square, are the whole force on the substrate.
- `tracks.csv`: the way of each cell, of every run without inertia or with `[polarity]`.  Bodies without a cortex, or
  that others push off, are no cells, and have none.
- `cues.csv`: who steers whom, of every run with `[polarity]`.

"""


def handbook_of_fields() -> str:
    """Fields and tables of a run as Markdown."""
    shapes = {(): "scalar", (2,): "vector", (3, 3): "tensor"}
    fields: list[tuple[str, ...]] = [
        (f"`{name}`", f.symbol, f.unit if f.unit != "1" else "", shapes[f.shape], f.term, f.meaning)
        for name, f in FIELDS.items()]
    tables: list[tuple[str, ...]] = [("`substrate.csv`", column, meaning) for column, meaning in _TRACTION]
    tables += [("`neighbours.csv`", column, meaning) for column, meaning in _PAIR]
    tables += [("`tracks.csv`", column, meaning) for column, meaning in _TRACK]
    tables += [("`cues.csv`", column, meaning) for column, meaning in _CUE]
    tables += [("`molecules.csv`", column, meaning) for column, meaning in _MOLECULES]
    head = "| table | column | meaning |\n|---|---|---|\n"
    return _ABOUT_FIELDS + _rows(fields) + _ABOUT_TABLES + head + _rows(tables)


def _rows(rows: list[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
