"""The C source of a scene: its laws and formulas, the files of c/ that it needs, and the calls between them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..meshfree.terms import Terms
from .codegen import Translator, shapes_of
from .fields import Field, step_memory
from .terms import PARTS, STAGES, SURFACE_TERMS, Part, SurfaceTerm, formulas, sizes

FOLDER = Path(__file__).parent / "c"
# Stresses of materials, and what networks need besides, method by method: the quantities that they may take, and the
# result.
STRESSES = {"stress": ("F, network, share", "v4 out[D][D]"), "viscous_stress": ("F, Fdot", "v4 out[D][D]"),
            "director_stress": ("F, gradient", "v4 out[D][D]"), "active_stress": ("F, director", "v4 out[D][D]"),
            "director_flux": ("F, gradient", "v4 out[M][D]"), "network_shares": ("time", "double out[2]"),
            "network_renewed": ("F, network, share", "v4 out[D][D]"), "network_loss": ("F, network", "v4 out[1]")}
_ARGUMENTS = {"F": "const v4 F[D][D]", "Fdot": "const v4 Fdot[D][D]", "gradient": "const v4 gradient[M][D]",
              "director": "const v4 director[D]", "network": "const v4 network[D][D]", "share": "const v4 share",
              "time": "const double time"}


@cache
def text_of(name: str) -> str:
    """A file of c/."""
    return (FOLDER / name).read_text(encoding="utf-8")


def parameters(materials: Sequence) -> list[Field]:
    """Vectors of parameters of all laws that a scene may have, those of materials last."""
    names = [*dict.fromkeys(term.name for term in SURFACE_TERMS), "load_curves"]
    names += [f"material_{i}" for i in range(len(materials))]
    return [Field(name, "double *", doc="parameters of its laws") for name in names]


def c_source(materials: Sequence, terms: Terms, fields: Sequence[Field] = ()) -> tuple[list[str], dict]:
    """C source of a scene, unit by unit, and the parameter vectors of its laws.

    A unit has nothing of the scene but what it needs, so that scenes share those that are the same in them.
    Raises LawError where a law has no counterpart in C.
    """
    vectors: dict[str, list[float]] = {}
    laws = _surface_terms(terms, vectors)
    laws["loads"] = _load_curves(terms.load_curves, vectors) + laws.get("loads", "")
    laws["step"] = "\n".join([_structure("StepMemory", step_memory(terms)), _materials(materials, terms, vectors),
                              _formulas(terms)])
    needed = [part for part in PARTS if part.needed(terms)]
    files: dict[str, dict[str, None]] = {}  # of each unit, once
    for part in needed:
        files.setdefault(part.unit, {})[part.file] = None
    common = [text_of(name) for name in files.pop("")]
    texts = {unit: "\n".join([laws.get(unit, ""), *common, *map(text_of, names)]) for unit, names in files.items()}
    texts["stages"] = _stages(needed, "\n".join(texts.values()))
    stages = [f"{stage}({arguments});" for stage, arguments in STAGES.items()]
    return ["\n".join([text_of("simd.h"), _constants(terms, text), f"typedef {_coefficient(terms)} coefficient;",
                       _kernel_data([*fields, *parameters(materials if unit == "step" else ())]), *stages, text])
            for unit, text in texts.items()], vectors


def _constants(terms: Terms, text: str) -> str:
    """Those constants that a text names."""
    return "\n".join(f"enum {{ {name} = {int(value)} }};" for name, value in sizes(terms).items() if name in text)


def _stages(needed: Sequence[Part], text: str) -> str:
    """The stages of a step: they call those of the files that a scene has, whose text this is."""
    source = []
    for stage, arguments in STAGES.items():
        kind, name = stage.split()
        calls = [part.calls[name] for part in needed if name in part.calls] + ["return 0;"] * (kind == "int")
        source.append("\n    ".join([f"{stage}({arguments})\n{{", *calls]) + "\n}\n")
    called = set(re.findall(r"\w+(?=\()", "".join(source)))
    heads = re.findall(r"^((?:int|void) (\w+)\([^)]*\))\s*{", text, re.MULTILINE)
    return "\n".join([*(f"{head};" for head, name in heads if name in called), *source])


def _coefficient(terms: Terms) -> str:
    return "float" if terms.single else "double"


def _structure(name: str, dtype: np.dtype) -> str:
    """A structure of arrays with the layout of a dtype."""
    kinds = {"f8": "double", "f4": "float"}
    members = [f"{kinds[dtype[m].base.str[1:]]} {m}[{int(np.prod(dtype[m].shape))}];" for m in dtype.names or ()]
    return f"struct {name} {{ {' '.join(members)} }};"


def _kernel_data(fields: Sequence[Field]) -> str:
    members = [f"    int (*ghost_{end})(void *, int, int);" for end in ("begin", "end")]
    members += [f"    {f.ctype}{'' if f.ctype.endswith('*') else ' '}{f.name};" for f in fields]
    return "\n".join(["typedef struct StepMemory StepMemory;", "typedef struct {", *members, "} KernelData;\n"])


def _formulas(terms: Terms) -> str:
    """Functions of formulas without parameters."""
    return "\n".join(Translator(formula, number, terms.dimension).function(method, name, results)
                     for formula, number, method, name, results in formulas(terms))


def _surface_terms(terms: Terms, vectors: dict[str, list[float]]) -> dict[str, str]:
    """Functions of the surface terms that a scene has, by units."""
    functions: dict[str, str] = {}
    for term in SURFACE_TERMS:
        found, unit = term.formula(terms), term.unit or term.name
        if isinstance(found, tuple):
            functions[unit] = functions.get(unit, "") + _of_laws(term, found, terms.dimension, vectors)
        elif found is not None:
            text, vectors[term.name] = _functions(term, found, terms.dimension)
            functions[unit] = functions.get(unit, "") + text
    return functions


def _functions(term: SurfaceTerm, formula: Any, dimension: int) -> tuple[str, list[float]]:
    """Functions of a term's formula, and its parameters."""
    t = Translator(formula, "double", dimension)
    text = []
    for method, results in term.methods.items():
        t.number = "v4" if method in term.in_fours else "double"
        text.append(t.function(method, f"{term.name}_{method}", results))
    return "\n".join(text), t.vector()


def _of_laws(term: SurfaceTerm, formulas: tuple, dimension: int, vectors: dict[str, list[float]]) -> str:
    """Functions of a term of several laws, for the parameters of each in turn, before which is the kind of the law."""
    kinds: dict[str, int] = {}
    rows = []
    for formula in formulas:
        text, values = _functions(term, formula, dimension)
        rows.append([float(kinds.setdefault(text, len(kinds))), *values])
    wide = max(map(len, rows))
    vectors[term.name] = [number for row in rows for number in row + [0.0] * (wide - len(row))]
    parts = [f"enum {{ {term.name.upper()}_STRIDE = {wide} }};"]
    if len(kinds) == 1:
        return "\n".join([*parts, *kinds])
    parts += [re.sub(rf"\b{term.name}_\w+(?=\()", rf"\g<0>_{kind}", text) for text, kind in kinds.items()]
    heads = re.findall(r"static inline .*(?= {\n)", next(iter(kinds)))
    return "\n".join([*parts, *(_choice(head, len(kinds)) for head in heads)])


def _choice(head: str, kinds: int) -> str:
    """The function with this head, which calls that of the kind of its law."""
    _, _, result, name, declared = re.split(r"[ (]", head.removesuffix(")"), maxsplit=4)
    arguments = ", ".join(re.findall(r"(\w+)(?:\[\d+\])*(?:,|$)", declared))
    returned = "return " if result == "double" else ""
    calls = [f"    case {k}: {returned}{name}_{k}({arguments}); break;" for k in range(kinds)]
    end = ["    }", "    return 0;" * bool(returned), "}\n"]
    return "\n".join([f"{head} {{", "    switch ((int)p[-1]) {", *calls, *end])


def _load_curves(laws: Sequence | None, vectors: dict[str, list[float]]) -> str:
    """Factors on supports, loads and plates and their rates, by the number of the time law."""
    parts, vectors["load_curves"] = [], []
    for method in ("value", "rate", "acceleration") if laws is not None else ():
        choice = []
        for i, law in enumerate(laws or ()):
            t = Translator(law, "double")
            parts.append(t.function(method, f"load_curve_{i}_{method}"))
            at = len(vectors["load_curves"])
            choice.append(f"    if (i == {i}) return load_curve_{i}_{method}(s->load_curves + {at}, t);\n")
            vectors["load_curves"] += t.vector()
        parts.append(f"static inline double load_curve_{method}(const KernelData *s, long i, double t)\n{{\n"
                     f"{''.join(choice)}    return 0;\n}}\n")
    return "\n".join(parts)


def _materials(materials: Sequence, terms: Terms, vectors: dict[str, list[float]]) -> str:
    """Stresses of each material, and for each method the choice among those that have it."""
    parts, translators = [], [Translator(material, "v4", terms.dimension) for material in materials]
    for method, (taken, result) in STRESSES.items():
        absent = (method.startswith("director") and terms.director == "none") or (
            method == "active_stress" and not terms.active)
        having = [] if absent else [i for i, m in enumerate(materials) if hasattr(type(m), method)]
        for i in having:
            translators[i].number = result.split()[0]
            parts.append(translators[i].function(method, f"{method}_{i}"))
        calls = [f"    if (material == {i}) {_call(materials[i], method, i, result)}" for i in having]
        arguments = ", ".join(["const KernelData *s", "const int material",
                               *(_ARGUMENTS[a] for a in taken.split(", ")), result])
        any_of = " || ".join(f"material == {i}" for i in having) or "0"
        parts += [f"INLINED void {method}({arguments})\n{{\n" + "\n".join(calls) + "\n}\n",
                  f"static inline int has_{method}(const int material) {{ return {any_of}; }}\n"]
    vectors |= {f"material_{i}": t.vector() for i, t in enumerate(translators)}
    parts.append(f"#define EACH_MATERIAL(DO) {' '.join(f'DO({i})' for i in range(len(materials)))}")
    return "\n".join(parts)


def _call(material: Any, method: str, number: int, result: str) -> str:
    """The call of a method of a material, with the quantities that it takes."""
    given = ", ".join([f"s->material_{number}", *shapes_of(getattr(type(material), method))])
    return f"out[0] = {method}_{number}({given});" if result.endswith("[1]") else f"{method}_{number}({given}, out);"
