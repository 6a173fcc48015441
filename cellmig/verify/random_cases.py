"""Random case files: valid ones of many kinds, and some that a check has to refuse."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from cellmig.case.registry import laws

from .random_bodies import cells_in_space, decades, extent, outline, text
from .random_cues import guide

Tables = dict[str, Any]
REACH = 1.0  # of the bonds to the substrate, beyond which a push is refused [µm]


def scene(seed: int, number: int, dimension: int = 2) -> Tables:
    """Tables of scene `number` of the set of a seed; they do not depend on the other scenes."""
    rng = np.random.default_rng([seed, number])
    cells = _cells(rng) if dimension == 2 else cells_in_space(rng)
    names = [cell["name"] for cell in cells]
    tables = {"title": f"scene {number} of the stress set {seed}", "seed": int(rng.integers(1 << 31)),
              "time": _time(rng), "particles": _particles(rng, cells, dimension), "materials": _materials(rng),
              "cells": cells}
    if rng.random() < 0.85:
        tables["adhesion"] = {"substrate": _bonds(rng)}
        if rng.random() < 0.7:
            some = [name for name in names if rng.random() < 0.6]
            ratio = float(rng.choice([0.0, 0.06, 0.3, decades(rng, -2, 1), 10.0]))
            tables["protrusion"] = {"cells": some, "protrusion_ratio": ratio,
                                    "height": text(min(decades(rng, -1, 0.5), REACH), "um")}
    if rng.random() < 0.8:
        tables.setdefault("adhesion", {})["cells"] = _bonds(rng)
        if pairs := _pairs(np.random.default_rng([seed, number, 2]), names):
            tables["adhesion"]["pairs"] = pairs
    _add(rng, tables)
    cues = np.random.default_rng([seed, number, 5])
    if tables.get("protrusion", {}).get("cells") and cues.random() < 0.4:
        guide(cues, tables, *extent(cells))
    return tables if dimension == 2 else _in_space(tables)


def _in_space(tables: Tables) -> Tables:
    """The tables without what is known in two dimensions only, with three components of a body force and a director."""
    found = {"title": tables["title"], "dimension": 3, **tables}
    found["time"].pop("integrator", None)
    if "director" in found:
        angle = float(found["director"].pop("angle").split()[0])
        if found["director"]["start"] == "uniform":
            found["director"]["direction"] = [np.cos(angle), np.sin(angle), 1.0]
    if "body_force" in found:
        found["body_force"]["acceleration"].append("0 m/s^2")
    return found


def launch(seed: int, number: int, dimension: int = 2) -> tuple[int, tuple[str, ...]]:
    """Number of ranks and PETSc options of scene `number` of the set of a seed."""
    rng = np.random.default_rng([seed, number, 1])
    ranks = int(rng.choice([1, 2, 3], p=[0.7, 0.2, 0.1]))
    given = rng.choice(["", "-ts_type rk -ts_rk_type 4", "-ts_type rk -ts_rk_type 5dp -ts_adapt_type basic",
                        "-ts_type ssp -ts_ssp_type rk104", "-ts_type alpha2"], p=[0.92, 0.02, 0.02, 0.02, 0.02])
    return ranks, tuple(given.split()) if dimension == 2 else ()


def toml(tables: Mapping[str, Any], path: tuple[str, ...] = ()) -> str:
    """Nested tables as TOML; values are text, numbers, booleans and lists of these."""
    plain = {k: v for k, v in tables.items() if not isinstance(v, Mapping) and not _is_tables(v)}
    lines = [f"{key} = {_value(value)}" for key, value in plain.items()]
    head = [f"[{'.'.join(path)}]"] if path and lines else []
    parts = ["\n".join([*head, *lines])] if lines else []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            parts.append(toml(value, (*path, key)))
        elif _is_tables(value):
            title = f"[[{'.'.join((*path, key))}]]\n"
            parts += [title + "\n".join(f"{k} = {_value(v)}" for k, v in item.items()) for item in value]
    return "\n\n".join(parts)


def _value(value: Any) -> str:
    """A value in TOML, a table in one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], Mapping)


# ------------------------------------------------------------------------------------------------------------ parts


def _time(rng: np.random.Generator) -> Tables:
    fixed = rng.random() < 0.2
    return {"end": "20 us", "frames": 1, "samples": 400, "step_factor": float(rng.uniform(0.3, 1.0)),
            "step": text(decades(rng, -0.5, 2.5), "ns") if fixed else "auto"}


def _particles(rng: np.random.Generator, cells: list[Tables], dimension: int) -> Tables:
    if dimension == 3:
        return {"per_cell": int(rng.integers(60, 301))}
    found: Tables = {"dilation": float(rng.uniform(1.6, 3.0))}
    if rng.random() < 0.3:  # one spacing for all cells: small ones are coarse
        size = float(np.sqrt(np.mean([_shape(cell).area for cell in cells]) / rng.uniform(60, 300)))
        return found | {"spacing": text(size, "um")}
    return found | {"per_cell": int(rng.integers(60, 601))}


def _materials(rng: np.random.Generator) -> Tables:
    c1 = decades(rng, 1.5, 5)
    return {"cytoplasm": {"law": "nematic", "viscosity": text(decades(rng, -1, 2), "mPa s"),
                          "bulk_modulus": "2.2 GPa", "reduced_bulk_modulus": text(decades(rng, 4.7, 7.5), "Pa")},
            "nucleus": {"law": "mooney-rivlin", "C1": text(c1, "Pa"),
                        "C2": text(c1 * rng.choice([0.0, decades(rng, -2, 0)]), "Pa"),
                        "volumetric_modulus": text(c1 * decades(rng, 0.5, 3), "Pa")}}


def _add(rng: np.random.Generator, tables: Tables) -> None:
    """Add terms that most cases lack: director gradients, activity, a network, cortex, friction, body force."""
    plasm = tables["materials"]["cytoplasm"]
    if rng.random() < 0.35:
        plasm["eta"] = text(rng.choice([0.0, decades(rng, 0, 3), 5e4, decades(rng, 5, 9)], p=[0.1, 0.6, 0.15, 0.15]),
                             "pN")
        tables["director"] = _director(rng)
    if rng.random() < 0.25:
        plasm["zeta"] = text(rng.choice([-1.0, 1.0]) * decades(rng, 0, 6), "Pa")
    if rng.random() < 0.2:
        plasm |= {"law": "gel", "shear_modulus": text(decades(rng, 0, 5), "Pa")}
    if rng.random() < 0.2:
        tables["cortex"] = {"line_tension": text(decades(rng, -1, 4), "pN/um")}
    if rng.random() < 0.2:
        tables["friction"] = {"coefficient": text(decades(rng, -1, 6), "Pa us/um")}
    if rng.random() < 0.1:
        tables["body_force"] = {"acceleration": [text(x * decades(rng, 1, 6), "m/s^2") for x in rng.normal(size=2)]}
    if rng.random() < 0.08:
        tables["time"]["integrator"] = str(rng.choice(["euler", "rk", "ssp", "arkimex"]))


def _director(rng: np.random.Generator) -> Tables:
    """Initial director, relaxation and anchoring."""
    start = {"start": str(rng.choice(["uniform", "radial", "tangential"])), "angle": text(rng.uniform(-4, 4), "rad")}
    if rng.random() < 0.4:
        return {"law": "frozen", **start}
    return {"law": "relaxing", **start, "mobility": text(decades(rng, -2, 2), "um^2/us"),
            "anchoring": str(rng.choice(["none", "surface"]))}


def _bonds(rng: np.random.Generator) -> Tables:
    """Bonds with work of adhesion from 0.3 pN/um to 3 nN/um and equilibrium distance from 5 to 100 nm."""
    return {"bond_density": text(decades(rng, 1, 5), "/um^2"), "well_depth": "0.03 pN um",
            "equilibrium_distance": text(decades(rng, np.log10(5), 2), "nm")}


def _pairs(rng: np.random.Generator, names: list[str]) -> list[Tables]:
    """In a third of the scenes two kinds of cells, with other bonds or none between them, and among those of one."""
    one = [name for name in names if rng.random() < 0.5]
    other = [name for name in names if name not in one]
    if rng.random() > 0.33 or not one or not other:
        return []
    none = {"bond_density": "0 /um^2"} if rng.random() < 0.5 else _bonds(rng)
    return [{"cells": [one, other], **none}] + ([{"cells": [one, one], **_bonds(rng)}] if len(one) > 1 else [])


def _cells(rng: np.random.Generator) -> list[Tables]:
    """1 to 9 cells, in a row or in rows of three, with gaps from 0 to 1 um; in a tenth of the scenes they overlap."""
    count, size = int(rng.integers(1, 10)), decades(rng, np.log10(2), np.log10(20))
    gap = rng.choice([0.01, rng.uniform(0, 1), -rng.uniform(0, 0.02)], p=[0.4, 0.5, 0.1])
    height = rng.choice([0.01, rng.uniform(0, 2), 0.0], p=[0.5, 0.4, 0.1])
    row, alike = (count if rng.random() < 0.5 else 3), rng.random() < 0.5
    kinds = [_drawn_shape(rng, size)] * count if alike else [_drawn_shape(rng, size * rng.uniform(0.6, 1.4))
                                                            for _ in range(count)]
    cells, bottom, top, x = [], height, height, 0.0
    for n, kind in enumerate(kinds):
        if n % row == 0:
            bottom, x = (top + gap if n else height), 0.0
        points = outline(kind)
        low, high = points.min(axis=0), points.max(axis=0)
        x += gap - low[0]
        nucleus = {"nucleus": "nucleus"} if "nucleus_ratio" in kind else {}
        cells.append({"name": f"Cell-{n + 1}", **kind, **nucleus, "material": "cytoplasm",
                      "centre": [text(x, "um"), text(bottom - low[1], "um")]})
        x, top = x + high[0], max(top, bottom - low[1] + high[1])
    return cells


def _drawn_shape(rng: np.random.Generator, size: float) -> Tables:
    """Disc, ellipse or polygon of a size [um]; a tenth of the polygons may cross themselves."""
    kind = rng.choice(["disc", "ellipse", "polygon"])
    core = {"nucleus_ratio": float(rng.uniform(0.2, 0.6))} if rng.random() < 0.6 else {}
    if kind == "disc":
        return {"shape": "disc", "radius": text(size, "um"), **core}
    if kind == "ellipse":
        return {"shape": "ellipse", "a": text(size * rng.uniform(0.4, 1.5), "um"),
                "b": text(size * rng.uniform(0.4, 1.5), "um"), **core}
    n = int(rng.integers(3, 10))
    angle = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    corners = size * rng.uniform(0.5, 1.2, n)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if rng.random() < 0.1:
        rng.shuffle(corners)
    return {"shape": "polygon", "corners": [[text(x, "um") for x in corner] for corner in corners], **core}


def _shape(kind: Tables) -> Any:
    """The shape of a cell's table; for a polygon, the ellipse in its bounding box."""
    def number(key: str) -> float:
        return float(kind[key].split()[0])

    if kind["shape"] == "disc":
        return laws("shape")["disc"](radius=number("radius"))
    if kind["shape"] == "ellipse":
        return laws("shape")["ellipse"](a=number("a"), b=number("b"))
    low, high = outline(kind).min(axis=0), outline(kind).max(axis=0)
    return laws("shape")["ellipse"](a=float(high[0] - low[0]) / 2, b=float(high[1] - low[1]) / 2)
