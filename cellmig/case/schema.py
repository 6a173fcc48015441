"""What a case is: its sections, declared once; the reader, the messages and the JSON schema follow from this."""

# ruff: noqa: RUF009 -- parameter() and its kin return dataclass fields
from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from typing import Any

from .registry import parameter, quantity
from .values import declared, in_table, write

TS_TYPES = ("leapfrog", "auto", "static", "euler", "rk", "ssp", "basicsymplectic", "beuler", "cn", "theta", "alpha",
            "alpha2", "bdf", "arkimex", "rosw", "eimex", "mimex", "mprk", "glee", "glle", "discgrad", "irk", "dirk",
            "radau5", "sundials", "pseudo")


@dataclass(frozen=True, kw_only=True)
class Time:
    """How long, in which steps, and how often to look."""

    end: float = quantity("us", "time at which the run ends", above=0)
    frames: int = parameter("pictures of all particles besides the first, evenly spaced", 100, minimum=1,
                            maximum=1_000_000)
    samples: int = parameter("rows of history and ledger besides the first, evenly spaced", 400, minimum=1,
                             maximum=1_000_000)
    step: float | str = quantity("us", "time step; \"auto\" takes a fraction of the stable one", "auto", above=0,
                                 words=("auto",))
    step_factor: float = quantity("", "the fraction of the stable step that \"auto\" takes", 0.8, above=0, maximum=1)
    integrator: str = parameter("\"leapfrog\" or a type of PETSc's TS; \"auto\": the cheaper one of leapfrog and "
                                "bdf, after a trial; \"static\": equilibria, each sample a load step", "leapfrog",
                                known=TS_TYPES)


@dataclass(frozen=True, kw_only=True)
class Particles:
    """How finely the cells are resolved: either their number or their distance."""

    per_cell: int | None = parameter("particles of each cell", None, minimum=7, maximum=100_000_000)
    spacing: float | None = quantity("um", "mean distance of particles, square root of the area of each", None,
                                     minimum=1e-6)
    dilation: float = quantity("", "radius of the kernel's support, in spacings", 2.2, minimum=1.2, maximum=10)
    surface_refinement: float = quantity("", "how much denser particles are along surfaces than inside: a line of "
                                         "contact moves in shorter steps, but what protrudes may grow thin fingers",
                                         1.0, minimum=1, maximum=10)


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """Choices of the method that are none of the model."""

    bulk_viscosity: float = quantity("", "bulk viscosity of the mean stress, over ρ c h (velocity divergence)", 0.05,
                                     minimum=0)
    accuracy: str | None = parameter("error such as \"20 %\": what the case leaves open of per_cell, dilation, "
                                     "step_factor and the reduced bulk modulus is the cheapest that was measured "
                                     "below it on such a scene", None)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell, or several alike in a row or a grid; the parameters of its shape stand beside these."""

    name: str = parameter("name; \"{}\" in it is the number of a repeated cell")
    shape: Any = parameter("registered shape", kind="shape", inline=True)
    centre: tuple = parameter("position of the centre; of a cell with `rest`, x alone is enough", unit="um",
                              minimum=-1e6, maximum=1e6, shape=(2,), least=1)
    rest: bool = parameter("whether it rests on the substrate: its lowest point is at the range of the bonds of "
                           "adhesion.substrate, whatever y `centre` has; of a repeated cell the first copy", False)
    material: str = parameter("material of the cytoplasm, or of the whole body", refers="material")
    nucleus: str | None = parameter("material of the nucleus", None, refers="material")
    displacement: tuple = quantity("um", "displacement at the start, may be formulas of x and y from the centre",
                                   (0.0, 0.0), shape=(2,), formula=True)
    velocity: tuple = quantity("um/us", "velocity at the start, may be formulas of x and y from the centre", (0.0, 0.0),
                               shape=(2,), formula=True)
    velocity_gradient: tuple = quantity("1/us", "A of a start velocity A (X - centre), added to `velocity`",
                                        ((0.0, 0.0), (0.0, 0.0)), shape=(2, 2))
    repeat: tuple = parameter("copies in each direction", (1,), items="count")
    pitch: tuple = quantity("um", "step from copy to copy, a vector for each direction", (), shape=(None, 2))


@dataclass(frozen=True, kw_only=True)
class OnPart:
    """Something on a part of the surface of some cells."""

    name: str = parameter("name, unique: columns of history.csv begin with it")
    cells: tuple = parameter("cells that it acts on; none given: all", (), items="cell")
    parts: tuple = parameter("parts of the surface that the cells' shape has names for, such as \"left\"; none given: "
                             "the whole surface", (), items="part")
    box: tuple = quantity("um", "two opposite corners of a box about the cell's centre: only what lies in it", (),
                          shape=(None, 2))

    def __post_init__(self) -> None:
        """Refuse a box that is none; the message is for the user."""
        if len(self.box) not in (0, 2):
            raise ValueError('box: expects two opposite corners, such as [["0 um", "0 um"], ["1 um", "2 um"]]')


@dataclass(frozen=True, kw_only=True)
class Support(OnPart):
    """A part of the surface that moves as prescribed, exactly at its particles."""

    displacement: tuple = quantity("um", "displacement, or \"free\" in a direction; may be formulas of x and y "
                                   "from the centre", (0.0, 0.0), shape=(2,), words=("free",), formula=True)
    load_curve: Any = parameter("how it changes with time", None, kind="load_curve", default_law="constant",
                                formerly="history")


@dataclass(frozen=True, kw_only=True)
class Load(OnPart):
    """A traction that keeps its direction, a pressure that follows the surface, or a force on the whole body."""

    traction: tuple | None = quantity("Pa", "force per reference area of the surface, may be formulas of x and y from "
                                      "the centre", None, shape=(2,), formula=True)
    pressure: float | None = quantity("Pa", "pressure on the deformed surface, positive inwards, may be a formula of x "
                                      "and y from the centre, where the surface was", None, formula=True)
    body: tuple | None = quantity("Pa/um", "force per reference volume, may be formulas of x and y from the centre",
                                  None, shape=(2,), formula=True)
    load_curve: Any = parameter("how it changes with time", None, kind="load_curve", default_law="constant",
                                formerly="history")

    def __post_init__(self) -> None:
        """Refuse a load that is none, or two; the messages are for the user."""
        super().__post_init__()
        if sum(load is not None for load in (self.traction, self.pressure, self.body)) != 1:
            raise ValueError("expects one of traction, pressure and body")
        if self.body is not None and (self.parts or self.box):
            raise ValueError("body: acts on all of the cells; parts and box are for what acts on the surface")


@dataclass(frozen=True, kw_only=True)
class Plate:
    """A rigid half-plane without friction that no particle enters."""

    name: str = parameter("name, unique: columns of history.csv begin with it")
    point: tuple = quantity("um", "a point of its face", shape=(2,))
    normal: tuple = quantity("", "direction out of it, of any length", shape=(2,))
    displacement: tuple = quantity("um", "how far it moves", (0.0, 0.0), shape=(2,))
    load_curve: Any = parameter("how that changes with time", None, kind="load_curve", default_law="constant",
                                formerly="history")

    def __post_init__(self) -> None:
        """Refuse a plate without a direction; the message is for the user."""
        if not any(self.normal):
            raise ValueError("normal: expects a direction, not zero")


@dataclass(frozen=True, kw_only=True)
class Probe(OnPart):
    """What is recorded in history.csv: where a point is and how far it moved, or the mean over a part of a surface."""

    point: tuple | None = quantity("um", "a point of the reference configuration, from the cell's centre", None,
                                   shape=(2,))


def _section(cls: type, doc: str) -> Any:
    return field(metadata={"doc": doc, "section": cls})


def _list(cls: type, doc: str) -> Any:
    return field(default=(), metadata={"doc": doc, "items_of": cls})


def _law(kind: str, doc: str, at: str = "", default_law: str | None = None) -> Any:
    """One law of a kind, at a dotted path; absent is None."""
    extra = {"at": tuple(at.split("."))} if at else {}
    return field(default=None, metadata={"doc": doc, "kind": kind, "default_law": default_law, **extra})


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case as loaded: all in the code's units (µm, µs, Pa), names checked, repeated cells written out.

    materials : dict -- name to law;  cells : tuple of Cell, each with its shape;  supports, loads, plates, probes :
    tuples;  what else is absent is None.
    """

    title: str = parameter("one line that says what this is", "")
    seed: int = parameter("seed of all random numbers", 0, minimum=0, maximum=2**63 - 1)
    time: Time = _section(Time, "time, steps and samples")
    particles: Particles = _section(Particles, "resolution")
    materials: dict = field(metadata={"doc": "materials by name", "kind": "material", "many": True})
    cells: tuple = field(metadata={"doc": "the cells", "items_of": Cell})
    substrate: Any = _law("adhesion", "adhesion to the substrate y = 0", "adhesion.substrate", "seifert")
    contact: Any = _law("adhesion", "adhesion between cells", "adhesion.cells", "seifert")
    protrusion: Any = _law("protrusion", "push of the leading edge", default_law="edge")
    cortex: Any = _law("cortex", "tension of the cells' surfaces; absent: none, as in the paper",
                       default_law="line-tension")
    friction: Any = _law("friction", "drag on the substrate; absent: none, as in the paper", default_law="bonds")
    director: Any = _law("director", "director field of the cytoplasm; absent: uniform")
    body_force: tuple | None = parameter("acceleration by a force on the whole body", None, unit="m/s^2", shape=(2,),
                                         at=("body_force", "acceleration"))
    supports: tuple = _list(Support, "what holds the cells, or moves parts of them")
    loads: tuple = _list(Load, "tractions and pressures on the cells")
    plates: tuple = _list(Plate, "rigid plates")
    probes: tuple = _list(Probe, "what is recorded besides")
    numerics: Numerics = _section(Numerics, "choices of the method")
    path: str = field(default="", compare=False, metadata={"doc": "file that it came from", "hidden": True})
    formulas: dict = field(default_factory=dict, compare=False, metadata={
        "doc": "where formulas stand: (list, name of the item, key) to (file, line, dotted key)", "hidden": True})
    chosen: str = field(default="", compare=False, metadata={"doc": "what an accuracy chose", "hidden": True})

    @property
    def name(self) -> str:
        """Name of the case: that of its file, without folder and ending."""
        return os.path.splitext(os.path.basename(self.path))[0] or "case"

    @property
    def static(self) -> bool:
        """Whether it is a row of equilibria."""
        return self.time.integrator == "static"

    def resolved(self) -> dict:
        """All that the case says, defaults included, in the form of a case file: `load.from_dict` reads it back."""
        tree: dict = {}
        for name, f in case_fields().items():
            value, table = getattr(self, name), tree
            *groups, key = case_path(f)
            if value is not None and not (f.default == () and value == ()):
                for group in groups:
                    table = table.setdefault(group, {})
                table[key] = _written(f, value)
        return tree


def case_fields() -> dict[str, dataclasses.Field]:
    """The fields of a case that stand in its file."""
    return {name: f for name, f in declared(Case).items() if "hidden" not in f.metadata}


def case_path(f: dataclasses.Field) -> tuple[str, ...]:
    """Where a field of the case stands in the file: names of tables, then the key."""
    return f.metadata.get("at", (f.name,))


def _written(f: dataclasses.Field, value: Any) -> Any:
    if f.metadata.get("many"):
        return {name: _table(item) for name, item in value.items()}
    if "items_of" in f.metadata:
        return [_table(item) for item in value]
    return _table(value) if dataclasses.is_dataclass(value) else write(f, value)


def _table(item: Any) -> dict:
    """Table of a section, a law or a cell."""
    table = {"law": item.law} if hasattr(item, "law") else {}
    for name, f in declared(type(item)).items():
        value = getattr(item, name)
        if f.metadata.get("inline"):
            shape = _table(value)
            table |= {name: shape.pop("law"), **shape}
        elif "kind" in f.metadata:
            table[name] = _table(value)
        elif value is not None:
            table[name] = write(in_table(f, getattr(item, "unit", None)), value)
    return table


def particle_count(case: Case, shape: Any) -> int:
    """Particles of a cell of this shape."""
    p = case.particles
    return p.per_cell if p.per_cell is not None else max(7, round(shape.area / p.spacing**2))
