"""What a case is: its sections, declared once; the reader, the messages and the JSON schema follow from this."""

# ruff: noqa: RUF009 -- parameter() and its kin return dataclass fields
from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from typing import Any

from .registry import parameter, quantity
from .values import declared, write

TS_TYPES = ("leapfrog", "euler", "rk", "ssp", "basicsymplectic", "beuler", "cn", "theta", "alpha", "alpha2", "bdf",
            "arkimex", "rosw", "eimex", "mimex", "mprk", "glee", "glle", "discgrad", "irk", "dirk", "radau5",
            "sundials", "pseudo")


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
    integrator: str = parameter("\"leapfrog\" or any type of PETSc's TS", "leapfrog", known=TS_TYPES)


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
    accuracy: str | None = parameter("error such as \"5 %\": what the case leaves open of per_cell, dilation, "
                                     "step_factor and the reduced bulk modulus is the cheapest that was measured "
                                     "below it on such a scene", None)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell, or several alike in a row or a grid; the parameters of its shape stand beside these."""

    name: str = parameter("name; \"{}\" in it is the number of a repeated cell")
    shape: Any = parameter("registered shape", kind="shape", inline=True)
    centre: tuple = quantity("um", "position of the centre", minimum=-1e6, maximum=1e6, shape=(2,))
    material: str = parameter("material of the cytoplasm, or of the whole body", refers="material")
    nucleus: str | None = parameter("material of the nucleus", None, refers="material")
    velocity: tuple = quantity("um/us", "velocity at the start", (0.0, 0.0), shape=(2,))
    velocity_gradient: tuple = quantity("1/us", "A of a start velocity A (X - centre), added to `velocity`",
                                        ((0.0, 0.0), (0.0, 0.0)), shape=(2, 2))
    repeat: tuple = parameter("copies in each direction", (1,), items="count")
    pitch: tuple = quantity("um", "step from copy to copy, a vector for each direction", (), shape=(None, 2))


def _section(cls: type, doc: str) -> Any:
    return field(metadata={"doc": doc, "section": cls})


def _law(kind: str, doc: str, at: str = "", default_law: str | None = None) -> Any:
    """One law of a kind, at a dotted path; absent is None."""
    extra = {"at": tuple(at.split("."))} if at else {}
    return field(default=None, metadata={"doc": doc, "kind": kind, "default_law": default_law, **extra})


@dataclass(frozen=True, kw_only=True)
class Case:
    """A case as loaded: all in the code's units (µm, µs, Pa), names checked, repeated cells written out.

    materials : dict -- name to law;  cells : tuple of Cell, each with its shape;  what is absent is None.
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
    numerics: Numerics = _section(Numerics, "choices of the method")
    path: str = field(default="", compare=False, metadata={"doc": "file that it came from", "hidden": True})
    chosen: str = field(default="", compare=False, metadata={"doc": "what an accuracy chose", "hidden": True})

    @property
    def name(self) -> str:
        """Name of the case: that of its file, without folder and ending."""
        return os.path.splitext(os.path.basename(self.path))[0] or "case"

    def resolved(self) -> dict:
        """All that the case says, defaults included, in the form of a case file: `load.from_dict` reads it back."""
        tree: dict = {}
        for name, f in case_fields().items():
            value, table = getattr(self, name), tree
            *groups, key = case_path(f)
            if value is not None:
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
        elif value is not None:
            table[name] = write(f, value)
    return table
