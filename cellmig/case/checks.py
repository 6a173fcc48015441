"""Checks of a case that concern several values: names, overlaps of cells, parameters that have to fit together."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from . import units
from .amounts import amounts, cues, exchanges
from .gaps import depth, near, outline, surface
from .held import unheld
from .messages import show, suggest
from .pairs import paired
from .schema import Cell, Particles
from .source import Source
from .values import declared, default_in

MOST_PARTICLES = 1e9
NARROW = 0.01  # gap over the equilibrium distance at which bonds between cells are to repel
MOST_OVERLAPS = 20  # overlaps that are reported
DENT = 0.1  # depth behind a plate at the start, over the size of a cell, that is taken for a dent
NOT_ABOVE = (("reduced_bulk_modulus", "bulk_modulus", "the reduced modulus is the smaller one"),
             ("equilibrium_distance", "cutoff", "beyond the cutoff there would be no bond at its equilibrium"))


def check(source: Source, found: dict[str, Any], on_substrate: bool) -> None:
    """Note all mistakes in a case of which the parts are `found`; parts that have mistakes themselves are None."""
    cells = found["cells"]
    for cell, path in {path: (cell, path) for cell, path in cells}.values():
        _nucleus(source, cell, path)
    if found["particles"] is not None:
        _count(source, found["particles"], cells)
    _names(source, cells)
    _parts(source, found)
    _pairs(source, found)
    _rubs(source, found)
    _solids(source, found)
    _walls(source, found)
    _equilibria(source, found)
    _without_inertia(source, found)
    _reach_of_push(source, found)
    _pushes_off(source, found)
    _renewal(source, found)
    amounts(source, found)
    _pushes(source, found)
    cues(source, found)
    exchanges(source, found)
    if found["dimension"] == 3:
        _in_space(source, found)
    if on_substrate:
        _above_substrate(source, cells)
    _overlaps(source, cells)
    _before_plates(source, found)


def resolution(source: Source) -> None:
    """Note a mistake unless exactly one of per_cell and spacing is given."""
    table = source.data.get("particles", {})
    given = [key for key in ("per_cell", "spacing") if isinstance(table, dict) and key in table]
    if len(given) != 1:
        source.reject(("particles", *given[1:]), "give either per_cell or spacing, "
                     + ("not both" if given else 'such as per_cell = 1485 or spacing = "0.24 um"'))


def ordered(source: Source, cls: type, found: dict[str, Any], path: tuple) -> None:
    """Note where a parameter of a law is above the one that bounds it."""
    fields = declared(cls)
    for small, large, why in NOT_ABOVE:
        low, high = (found.get(k, fields[k].default if k in fields else None) for k in (small, large))
        if isinstance(low, float) and isinstance(high, float) and low > high:
            low, high = (units.text(v, fields[k].metadata["unit"]) for k, v in ((small, low), (large, high)))
            source.reject((*path, small), f"{low} is above {large} = {high}: {why}")


def _in_space(source: Source, found: dict[str, Any]) -> None:
    """Note what is known in two dimensions only."""
    default = declared(Particles)["dilation"].default
    if found["particles"] is not None and found["particles"].dilation != default:
        source.reject(("particles", "dilation"), "has no meaning in three dimensions, where gradients are averages of "
                      "finite elements: leave it out")
    if getattr(found["director"], "angle", 0.0):
        source.reject(("director", "angle"), "has no meaning in three dimensions: give three numbers, such as "
                      "direction = [1, 0, 0]")


def _renewal(source: Source, found: dict[str, Any]) -> None:
    """Note where neighbours cannot be found anew."""
    if found["numerics"] is None or isinstance(found["numerics"].renewal, str):
        return
    director = found["director"]
    eta = any(getattr(law, "eta", 0.0) for law in (found["materials"] or {}).values())
    if eta and director is not None and not director.uniform:
        source.reject(("numerics", "renewal"), "neighbours are not found anew where directors exert stresses: take "
                      "\"never\", or materials with eta = 0")


_ALONG_P = "cells with a polarity push along that: leave it out; polarity.start is where they begin"


def _pushes(source: Source, found: dict[str, Any]) -> None:
    """Note directions of another dimension, polarities of cells that do not push, and times that never come."""
    push, polarity, n = found["protrusion"], found["polarity"], (found["dimension"] or 2) - 1
    example = "[1] or [-1]" if n == 1 else "[1, 0]"
    for law, path, key in ((push, ("protrusion",), "direction"), (polarity, ("polarity",), "start"),
                           *((cell.push, (*path, "push"), "direction") for cell, path in found["cells"])):
        given = getattr(law, key, ())
        if given and (len(given) != n or not any(given)):
            source.reject((*path, key), "has a component for each direction along the substrate and is not zero, such "
                          f"as {example}")
    adhesion = source.data.get("adhesion")
    grounds = {"substrate", "pairs"}.intersection(adhesion if isinstance(adhesion, dict) else ())
    if polarity is not None and found["substrate"] is None and "substrate" not in grounds and not (
            "pairs" in grounds and (not found["pairs"] or any(pair.push for pair, _ in found["pairs"]))):
        source.reject(("polarity",), "cells push off [adhesion.substrate], of which there is none, or off a gel, by "
                                     "push = true in [[adhesion.pairs]]")
    if push is None and "protrusion" in source.data:
        pass  # its own mistakes are noted
    elif polarity is not None and not (push is not None and push.cells):
        source.reject(("polarity",), "no cell protrudes: name those that do in protrusion.cells")
    elif polarity is not None and (idle := [name for name in polarity.cells if name not in push.cells]):
        source.reject(("polarity", "cells"), f"'{idle[0]}' does not protrude: name it in protrusion.cells, too")
    if polarity is not None and found["time"] is not None and found["time"].integrator == "static":
        source.reject(("polarity",), "nothing moves in a static case")
    polar = () if polarity is None or push is None else polarity.cells or push.cells
    if polar and push is not None and push.direction and set(polar) >= set(push.cells):
        source.reject(("protrusion", "direction"), _ALONG_P)
    for cell, path in found["cells"]:
        if cell.push is None:
            continue
        if cell.push.direction and cell.name in polar:
            source.reject((*path, "push", "direction"), _ALONG_P)
        if push is not None and cell.name not in push.cells:
            source.reject((*path, "push"), f"'{cell.name}' does not protrude: name it in protrusion.cells")
        if cell.push.end is not None and cell.push.end <= cell.push.begin:
            source.reject((*path, "push", "end"), "is not after `begin`")


def _nucleus(source: Source, cell: Cell, path: tuple) -> None:
    """Note a nucleus that has a size but no material, or a material but no size."""
    keys = [k for k in declared(type(cell.shape)) if k.startswith("nucleus_")] or ["nucleus_ratio"]
    given = [k for k in keys if getattr(cell.shape, k, None) is not None]
    if cell.nucleus is not None and not given:
        source.reject((*path, "nucleus"), f"a nucleus has a size, too: {keys[0]} is missing")
    elif cell.nucleus is None and given:
        source.reject((*path, given[0]), "a nucleus has a material, too: nucleus is missing")


def _solids(source: Source, found: dict[str, Any]) -> None:
    """Note a relative stiffness of what is no solid."""
    for cell, path in {path: (cell, path) for cell, path in found["cells"]}.values():
        laws = [(found["materials"] or {}).get(name) for name in (cell.material, cell.nucleus)]
        if cell.relative_stiffness != 1.0 and any(law is not None and law.viscosity for law in laws):
            source.reject((*path, "relative_stiffness"), "is that of a solid, such as \"mooney-rivlin\"; what '"
                          f"{cell.name}' is made of has a viscosity")


def _reach_of_push(source: Source, found: dict[str, Any]) -> None:
    """Note a pushing edge that is higher than the reach of the bonds to what it pushes off."""
    push = found["protrusion"]
    bonds = [(found["substrate"], "the substrate, adhesion.substrate.cutoff"),
             *((pair.law, f"a body, {'.'.join(map(str, path))}.cutoff") for pair, path in found["pairs"] if pair.push)]
    for law, whose in bonds:
        reach = getattr(law, "cutoff", math.inf)
        if push is not None and push.cells and push.height > reach:
            height, reach = (units.text(v, "um") for v in (push.height, reach))
            source.reject(("protrusion", "height"), f"{height} is beyond the reach of the bonds to {whose} = {reach}: "
                                                    "take at most that, or a longer cutoff")


def _pushes_off(source: Source, found: dict[str, Any]) -> None:
    """Note pairs that are to push off each other and cannot."""
    push = found["protrusion"]
    for pair, path in found["pairs"]:
        names = {*pair.cells[0], *pair.cells[1]}
        if not pair.push:
            continue
        if pair.itself:
            source.reject((*path, "push"), "a body cannot push off itself")
        elif not pair.law.work:
            source.reject((*path, "push"), "there are no bonds to push off by: give bond_density and well_depth")
        elif (push is not None or "protrusion" not in source.data) and not names & set(getattr(push, "cells", ())):
            source.reject((*path, "push"), "none of these protrudes: name those that push in protrusion.cells")


def _count(source: Source, particles: Particles, cells: list[tuple[Cell, tuple]]) -> None:
    """Note too few or too many particles."""
    total, key = 0.0, "per_cell" if particles.per_cell else "spacing"
    for cell, _ in cells if particles.per_cell or particles.spacing else ():
        count = particles.per_cell or (cell.shape.area / particles.spacing**2 if len(cell.centre) == 2 else
                                      cell.shape.volume / particles.spacing**3)
        total += count
        if round(count) < 7:
            source.reject(("particles", key), f"leaves '{cell.name}' with {count:.0f} particles; at least 7 are needed")
            return
    if total > MOST_PARTICLES:
        source.reject(("particles", key), f"makes {total:.2g} particles, at most {MOST_PARTICLES:.0e} are possible")


def _names(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """Note names that cannot be printed, and those that two cells have."""
    seen: dict[str, tuple] = {}
    reported = set()
    for cell, path in cells:
        if not cell.name.strip() or not cell.name.isprintable():
            source.reject((*path, "name"), "a name has printable characters, and at least one")
        elif cell.name == "all":
            source.reject((*path, "name"), "'all' is the aggregate of all cells in the tables of a run")
        elif seen.get(cell.name, path) != path and (path, seen[cell.name]) not in reported:
            reported.add((path, seen[cell.name]))
            other, line = ".".join(map(str, seen[cell.name])), source.place(seen[cell.name])[1]
            source.reject((*path, "name"), f"two cells are called '{cell.name}': this one and {other}"
                                          + (f" in line {line}" if line else ""))
        seen.setdefault(cell.name, path)


def _parts(source: Source, found: dict[str, Any]) -> None:
    """Note parts that cells do not have, and names that cannot begin a column of history.csv or do so already."""
    cells, seen = [cell for cell, _ in found["cells"]], set()
    for kind in ("supports", "loads", "plates", "probes"):
        for item, path in found[kind]:
            known = kind != "plates" and not source.rejected((*path, "cells"))
            shapes = {c.shape: c for c in cells if known and (c.name in item.cells or not item.cells)}
            for shape, cell in shapes.items():
                for part in item.parts:
                    if part not in shape.parts:
                        source.reject((*path, "parts"), f"'{cell.name}' has no part {show(part)}"
                                                       f"{suggest(part, shape.parts)}")
            if not re.fullmatch(r"[\w-]+", item.name):
                source.reject((*path, "name"), "names a column: expects letters, digits, - and _ alone")
            elif kind != "loads" and item.name in seen:
                source.reject((*path, "name"), f"is that of another support, plate or probe: '{item.name}'")
            if kind != "loads":
                seen.add(item.name)
    step = found["time"].integrator if found["time"] is not None else ""
    if found["plates"] and step not in ("leapfrog", "auto", "static", ""):
        source.reject(("time", "integrator"), f"{show(step)} has no plates; \"leapfrog\" has")


def _pairs(source: Source, found: dict[str, Any]) -> None:
    """Note two cells that two exceptions of adhesion name."""
    pairs = found["pairs"]
    try:
        _, twice = paired([cell.name for cell, _ in found["cells"]], [pair for pair, _ in pairs])
    except ValueError as error:
        source.reject(("adhesion", "pairs"), str(error))
        return
    for first, second, (a, b) in twice:
        line = source.place(pairs[first][1])[1]
        source.reject((*pairs[second][1], "cells"), f"'{a}' and '{b}' are named before, in adhesion.pairs.{first}"
                                                    + (f" in line {line}" if line else ""))


def _rubs(source: Source, found: dict[str, Any]) -> None:
    """Note friction between bodies that no bonds can exert."""
    for pair, path in found["pairs"]:
        if pair.friction is None:
            continue
        if pair.itself:
            source.reject((*path, "friction"), "a body has no bonds to itself that could drag")
        elif not pair.law.work:
            source.reject((*path, "friction"), "these bodies have no bonds that could drag: give bond_density and "
                                               "well_depth")


def _walls(source: Source, found: dict[str, Any]) -> None:
    """Note laws between cells that do not keep them out of each other."""
    laws = [(pair.law, (*path, "law")) for pair, path in found["pairs"]]
    for law, path in [(found["contact"], ("adhesion", "cells", "law")), *laws]:
        if law is None or not law.work or law.cutoff <= law.equilibrium_distance:
            continue  # no bonds, or a mistake that is told already
        if float(law.slope(NARROW * law.equilibrium_distance)) >= 0.0:
            source.reject(path, f"{show(law.law)} does not repel at {NARROW:g} of its equilibrium distance, so that "
                                "cells would pass into each other: its slope has to be negative there")


def _equilibria(source: Source, found: dict[str, Any]) -> None:
    """Note what a static case cannot have: fluids, adhesion and the like, initial motion, sudden loads."""
    if found["time"] is None or found["time"].integrator != "static":
        return
    why = "\"static\" finds equilibria of solids"
    used = {name for cell, _ in found["cells"] for name in (cell.material, cell.nucleus)}
    for name, law in (found["materials"] or {}).items():
        if name in used and law is not None and (law.viscosity or not law.shear_modulus):
            source.reject(("materials", name), f"{why}: '{law.law}' has a viscosity; "
                         "time.integrator = \"overdamped\" follows it in time, to its rest if it has one")
    for name, path, what in (
            ("substrate", ("adhesion", "substrate"), "adhesion"), ("contact", ("adhesion", "cells"), "adhesion"),
            ("pairs", ("adhesion", "pairs"), "adhesion"),
            ("protrusion", ("protrusion",), "protrusion"), ("cortex", ("cortex",), "cortex"),
            ("friction", ("friction",), "friction"), ("medium", ("medium",), "medium"),
            ("director", ("director",), "director"), ("ground", ("substrate",), "substrate"),
            ("body_force", ("body_force",), "body force")):
        if found[name] not in (None, []):
            source.reject(path, f"{why} under supports, loads and plates; it has no {what} yet")
    for cell, path in {path: (cell, path) for cell, path in found["cells"]}.values():
        if cell.friction is not None:
            source.reject((*path, "friction"), f"{why} under supports, loads and plates; it has no friction yet")
        for key in _given(cell, "displacement", "velocity", "velocity_gradient"):
            source.reject((*path, key), f"{why}, from rest: nothing moves at the start")
    for kind in ("supports", "loads", "plates"):
        for item, path in found[kind]:
            if item.load_curve.value(0.0) and _acts(item):
                source.reject((*path, "load_curve"), f"{why} under loads that grow with time from zero: "
                             'expects such as { law = "ramp", duration = "1 us" }')


def _without_inertia(source: Source, found: dict[str, Any]) -> None:
    """Note what an overdamped case cannot have: cells that nothing holds, initial velocities."""
    if found["time"] is None or found["time"].integrator != "overdamped":
        return
    why = "\"overdamped\" is motion without inertia"
    cells = {path: (cell, path) for cell, path in found["cells"]}.values()
    for cell, path in cells:
        for key in _given(cell, "velocity", "velocity_gradient"):
            source.reject((*path, key), f"{why}, where forces alone decide velocities: leave it out")
    if any(map(source.rejected, [("supports",), ("friction",), ("medium",), ("adhesion",)])):
        return  # what has a mistake may be what holds them
    loose = set(unheld([cell for cell, _ in cells], [item for item, _ in found["supports"]], found["friction"],
                       found["substrate"], found["medium"], [pair for pair, _ in found["pairs"]]))
    for cell, path in cells:
        if cell in loose:
            source.reject((*path, "centre"), f"{why}: nothing holds '{cell.name}', so that the least force would move "
                          "it at once; give [medium] a viscosity, [friction] to a cell that rests on the substrate, "
                          "friction to a pair in [[adhesion.pairs]] of a cell and what holds it, or [[supports]]")


def _given(cell: Cell, *keys: str) -> Iterator[str]:
    """Those of the keys whose values a cell does not have by default."""
    for key in keys:
        still = default_in(declared(Cell)[key], len(cell.centre))
        if np.any(np.array(getattr(cell, key), object) != np.array(still, object)):
            yield key


def _acts(item: Any) -> bool:
    """Whether a support or plate moves, or a load is not zero."""
    values = (*(getattr(item, "displacement", None) or ()), *(getattr(item, "traction", None) or ()),
              *(getattr(item, "body", None) or ()),
              getattr(item, "pressure", None) or 0.0)
    return any(value not in (0.0, "free") for value in values)


def _above_substrate(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """Note cells that reach below the substrate y = 0, in space z = 0; of the copies of a cell, the first one."""
    reported = set()
    for cell, path in cells:
        bottom = cell.centre[-1] + cell.shape.lowest()
        if bottom < 0 and path not in reported:
            reported.add(path)
            source.reject((*path, "centre"), f"'{cell.name}' reaches {-bottom:.4g} um below the substrate "
                                            f"{'xyz'[len(cell.centre) - 1]} = 0; rest = true puts it there")


def _before_plates(source: Source, found: dict[str, Any]) -> None:
    """Note plates behind whose face a cell begins; a dent is no mistake, contact takes it out."""
    cells = [cell for cell, _ in found["cells"]]
    outlines = {one: outline(*one) for one in {(c.shape, c.displacement) for c in cells} if found["plates"]}
    for plate, path in found["plates"]:
        normal = np.array(plate.normal) / np.linalg.norm(plate.normal)
        face = normal @ (plate.point + plate.load_curve.value(0.0) * np.array(plate.displacement))
        for cell in cells:
            heights = (outlines[cell.shape, cell.displacement] + cell.centre) @ normal - face
            low, high = float(heights.min()), float(heights.max())
            if low < -DENT * (high - low):
                source.reject((*path, "point"), f"'{cell.name}' begins {-low:.4g} um behind the face, where nothing "
                              "can be" + "; the normal points to where the cells are" * (high <= 0.0))
                break


def _overlaps(source: Source, cells: list[tuple[Cell, tuple]]) -> None:
    """Note cells that overlap; of the copies of two cells, the first pair of the same shapes."""
    shapes = {shape: surface(shape) for shape in {cell.shape for cell, _ in cells}}
    outlines = [shapes[cell.shape] for cell, _ in cells]
    centres = np.array([cell.centre for cell, _ in cells])
    reported = set()
    for i, j in near(outlines, centres):
        (a, path_a), (b, path_b) = cells[i], cells[j]
        pair = path_a, path_b, id(outlines[i]), id(outlines[j])
        both = (a.shape, b.shape), (outlines[i], outlines[j])
        if pair not in reported and (deep := depth(*both, centres[j] - centres[i])) > 1e-9:
            reported.add(pair)
            source.reject((*path_b, "centre"), f"'{b.name}' overlaps '{a.name}' by {deep:.4g} um")
            if len(reported) == MOST_OVERLAPS:
                return
