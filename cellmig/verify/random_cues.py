"""Random polarities, cues, fields and substrates for the cells that protrude in the scenes of `verify --stress`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .random_bodies import Tables, decades, text

AFFINITY = {"signal": "10 nM", "made": "10 nM", "ligand": "0.5", "stiffness": "10 kPa"}  # by field


def guide(rng: np.random.Generator, tables: Tables, low: np.ndarray, high: np.ndarray) -> None:
    """Add what turns the cells of a scene that protrude, all of which lie from `low` to `high` (d,) [µm].

    Most have a polarity with up to three cues and fields, one of which may diffuse; some a substrate that varies, a
    gate, a basal push, a stall, and pushes of their own.  Times and lengths are those of the scene.
    """
    push, d = tables["protrusion"], len(low)
    end, unit = tables["time"]["end"].split()
    about = Scales(float(end), unit, low, high)
    _pushes(rng, tables, about)
    if rng.random() < 0.5:
        tables["substrate"] = _substrate(rng, about)
    if rng.random() < 0.85:
        tables["polarity"] = found = _polarity(rng, about, push["cells"])
        for cell in tables["cells"]:
            if cell["name"] in found.get("cells", push["cells"]):
                cell.get("push", {}).pop("direction", None)  # it pushes along its polarity
        tables["fields"] = {"signal": {"formula": _formula(rng, about)}}
        if rng.random() < 0.3:
            tables["fields"]["made"] = _diffusing(rng, about)
            tables["exchange"] = _exchange(rng, about, [cell["name"] for cell in tables["cells"]])
        known = [*tables["fields"], *(key for key in ("ligand", "stiffness") if key in tables.get("substrate", {}))]
        polar = tables["polarity"].get("cells", push["cells"])
        tables["cues"] = [_cue(rng, about, known, polar) for _ in range(rng.integers(0, 4))]
        if not tables["cues"]:
            del tables["cues"]
    elif rng.random() < 0.5:
        push["direction"] = _vector(rng, d - 1)


@dataclass(frozen=True, eq=False)
class Scales:
    """Scales of a scene: its end in a unit of time, and the box from `low` to `high` (d,) [µm] around its cells."""

    end: float
    unit: str
    low: np.ndarray
    high: np.ndarray

    @property
    def size(self) -> float:
        """Largest side of the box [µm]."""
        return float((self.high - self.low).max())

    def time(self, share: float) -> str:
        """A share of the end, with its unit."""
        return text(share * self.end, self.unit)


def _vector(rng: np.random.Generator, n: int) -> list[float]:
    """A vector along the substrate [-]: of chance, or a unit vector along an axis."""
    unit = [0.0] * n
    unit[int(rng.integers(n))] = float(rng.choice([-1.0, 1.0]))
    return unit if rng.random() < 0.5 else [float(x) for x in rng.normal(size=n)]


def _some(rng: np.random.Generator, names: list[str]) -> Tables:
    """In a third of all calls some of the names, as `cells`; else nothing, which means all."""
    some = [name for name in names if rng.random() < 0.6]
    return {"cells": some} if some and rng.random() < 0.33 else {}


def _pushes(rng: np.random.Generator, tables: Tables, about: Scales) -> None:
    """What changes the push of all cells, or of one."""
    push = tables["protrusion"]
    if rng.random() < 0.4:
        push["basal"] = float(rng.uniform(0.0, 2.0))
    if rng.random() < 0.4:
        push["gate"] = text(decades(rng, -1, 0.3), "um")
    if rng.random() < 0.15:
        push["stall"] = text(decades(rng, 0, 3), "pN/um")
    for cell in tables["cells"]:
        if cell["name"] in push["cells"] and rng.random() < 0.25:
            begin, end = np.sort(rng.uniform(0.0, 1.0, 2))
            cell["push"] = {"strength": float(rng.choice([0.0, rng.uniform(0, 3)], p=[0.1, 0.9]))}
            cell["push"] |= {"direction": _vector(rng, len(about.low) - 1)} if rng.random() < 0.5 else {}
            cell["push"] |= {"begin": about.time(begin)} if rng.random() < 0.5 else {}
            cell["push"] |= {"end": about.time(end)} if rng.random() < 0.5 else {}


def _polarity(rng: np.random.Generator, about: Scales, names: list[str]) -> Tables:
    """Polarity with 4 to 60 knots in the scene, at times that may be those of the samples, too."""
    found: Tables = {"law": str(rng.choice(["relaxing", "switching"])),
                     "persistence": about.time(float(rng.choice([decades(rng, -0.5, 0.7), 1.0, 0.5]))),
                     "spread": float(rng.choice([0.0, 1.0, rng.uniform(0.0, 3.0)])), **_some(rng, names)}
    return found | ({"start": _vector(rng, len(about.low) - 1)} if rng.random() < 0.3 else {})


def _cue(rng: np.random.Generator, about: Scales, fields: list[str], names: list[str]) -> Tables:
    """A cue of any law, for all cells or for some."""
    law = str(rng.choice(["occupancy", "contact", "neighbours", "motion", "given"]))
    found: Tables = {"law": law, **_some(rng, names)}
    if law in ("contact", "neighbours"):
        found["reach"] = text(decades(rng, -1, 0.5), "um")
    if law == "occupancy" or (law == "contact" and rng.random() < 0.4):
        found["field"] = str(rng.choice(fields))
        found["affinity"] = AFFINITY[found["field"]]
    if law == "occupancy":
        found["gain"] = decades(rng, 0, 2)
        return found | ({"receptors": max(30.0, decades(rng, 1, 5))} if rng.random() < 0.5 else {})
    if law == "motion":
        found["speed"] = text(about.size / about.end * decades(rng, -3, 0), f"um/{about.unit}")
    if law == "given":
        found["vector"] = [_of_place(rng, about) if rng.random() < 0.4 else x for x in _vector(rng, len(about.low) - 1)]
    if law == "neighbours":  # at most 10 in sum
        return found | {"gain": decades(rng, -1, 0.5)}
    return found | {"gain": float(rng.choice([-1.0, 1.0], p=[0.2, 0.8])) * decades(rng, -1, 1)}


def _of_place(rng: np.random.Generator, about: Scales) -> str:
    """A formula of place and time that is about one [-]."""
    time = f"t_{about.unit}/{about.end:.6g}"
    return str(rng.choice([f"sin({rng.uniform(1, 20):.3g}*{time})", f"tanh(x/{about.size:.4g})",
                           f"1 - 2*{time}", f"cos(x/{about.size:.4g} + {time})"]))


def _formula(rng: np.random.Generator, about: Scales) -> str:
    """A concentration of about 10 nM, along x or around a place, that may change in time."""
    middle = float(about.low[0] + rng.uniform() * (about.high[0] - about.low[0]))
    slope, wide = rng.uniform(-1.0, 1.0), rng.uniform(0.5, 4.0) * about.size
    fades = f"*exp(-t_{about.unit}/{rng.uniform(0.3, 2.0) * about.end:.6g})" if rng.random() < 0.3 else ""
    return str(rng.choice([f"10*exp({slope:.4g}*(x - {middle:.6g})/{about.size:.6g}){fades} nM",
                           f"20*exp(-((x - {middle:.6g})/{wide:.6g})**2){fades} nM",
                           f"max(10 + 5*(x - {middle:.6g})/{about.size:.6g}, 0){fades} nM"]))


def _substrate(rng: np.random.Generator, about: Scales) -> dict[str, Any]:
    """Ligands in stripes, at a step or along a gradient, a stiffness that grows along x, or both, with a response."""
    found, middle = Tables(), 0.5 * float(about.low[0] + about.high[0])
    if rng.random() < 0.6:
        along = f"(x - {middle:.6g})/{about.size * rng.uniform(0.2, 2.0):.6g}"
        least = float(rng.choice([0.0, rng.uniform(0.1, 0.8)], p=[0.3, 0.7]))
        found["ligand"] = f"{least:.3f} + {0.5 * (1 - least) - 3e-4:.4f}*(1 + {rng.choice(['sin', 'tanh'])}({along}))"
    if not found or rng.random() < 0.6:
        wide = float(rng.choice([-1.0, 1.0])) * about.size * rng.uniform(0.5, 4.0)
        found["stiffness"] = f"{decades(rng, 0, 1.5):.4g}*exp((x - {middle:.6g})/{wide:.6g}) kPa"
        found["response"] = [{"law": "saturating", "half": "10 kPa"}, {"law": "optimum", "optimum": "10 kPa"},
                             {"law": "clutches", "motors": int(rng.integers(1, 80)),
                              "clutches": int(rng.integers(1, 80))}][rng.integers(3)]
    return found


def _diffusing(rng: np.random.Generator, about: Scales) -> Tables:
    """A field of about 10 nM that diffuses by about the size of the scene, in a box around the cells."""
    d, wide = len(about.low), rng.uniform(0.3, 1.5) * about.size
    low, high = about.low - wide, about.high + wide
    low[-1] = min(0.0, about.low[-1])
    spacing = (high - low).max() / rng.uniform(20, 80 if d == 2 else 30)
    rate = decades(rng, -1, 1) / about.end
    found: Tables = {"law": "diffusing", "diffusion": text(about.size**2 * rate, f"um^2/{about.unit}"),
                     "box": [[text(x, "um") for x in corner] for corner in (low, high)], "spacing": text(spacing, "um")}
    if rng.random() < 0.5:
        found["decay"] = text(decades(rng, -1, 1) / about.end, f"1/{about.unit}")
    if rng.random() < 0.3:
        flow = about.size / about.end * np.append(rng.normal(size=d - 1), 0.0)
        found["flow"] = [text(w, f"um/{about.unit}") for w in flow]
    if rng.random() < 0.5:
        found["start"] = "10 nM"
    if rng.random() < 0.5:
        found["walls"] = {"right": str(rng.choice(["20 nM", "0 nM", *(["open"] if "flow" in found else [])]))}
    return found | {"quasi_steady": True} if rng.random() < 0.15 and "decay" in found else found


def _exchange(rng: np.random.Generator, about: Scales, names: list[str]) -> list[Tables]:
    """Cells that secrete or take up about what diffusion carries away at 10 nM, 6 molecules in a µm³."""
    flux = 6.0 * about.size / about.end
    found: list[Tables] = []
    if rng.random() < 0.7:
        found.append({"field": "made", "secretion": text(flux * decades(rng, -1, 1), f"/um^2/{about.unit}"),
                      **_some(rng, names)})
    if not found or rng.random() < 0.5:
        found.append({"field": "made", "uptake": text(flux * decades(rng, -1, 1), f"/um^2/{about.unit}"),
                      "half": text(decades(rng, 0, 2), "nM"), **_some(rng, names)})
    return found
