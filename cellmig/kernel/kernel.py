"""The kernel of a scene: its laws and types written in front of kernel.c, compiled once."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..meshfree.terms import Terms
from .codegen import Translator
from .fields import Field
from .toolchain import library, loaded

VECTORS, STEP, ASSEMBLE = (Path(__file__).parent / "c" / name for name in ("simd.c", "step.c", "assemble.c"))
_NUMBERS = {"double": ctypes.c_double, "long": ctypes.c_long}  # all else is a pointer
_DTYPES = {"double *": np.float64, "uint32_t *": np.uint32, "int32_t *": np.int32, "long *": np.int64}


SURFACE_LAWS = {"substrate": ("primitive", "potential", "slope"), "contact": ("primitive", "potential", "slope"),
                "protrusion": ("ramp", "ramp_slope", "front", "hold"), "cortex": ("energy", "tension"),
                "friction": ("drag",)}


LINE = 64  # bytes of a cache line


def aligned_zeros(shape: Any, dtype: Any = float) -> np.ndarray:
    """Zeros that begin with a cache line, so that no vector of the kernel straddles two."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    return memory[start : start + size].view(dtype).reshape(shape)


class Kernel:
    """Compiled functions of a scene and the structure they work on.

    Set an array or a number with ``kernel["name"] = value``: the kernel keeps the array, or a copy that begins with a
    cache line, and passes its address; ``kernel["name"]`` is the array that it works on.
    """

    def __init__(self, materials: list, terms: Terms, fields: Sequence[Field]):
        """Compile the step of a scene with these material laws and terms; `fields` : all that its files of C name."""
        text, vectors = c_source(materials, terms, fields)
        self._types = {f.name: f.ctype for f in [*fields, *_of_materials(materials)]}
        members = [(name, _NUMBERS.get(kind, ctypes.c_void_p)) for name, kind in self._types.items()]
        members += [("ghost_begin", ctypes.c_void_p), ("ghost_end", ctypes.c_void_p)]
        self._dtypes = {**_DTYPES, "coefficient *": np.float32 if terms.single else np.float64}
        self._structure = type("KernelData", (ctypes.Structure,), {"_fields_": members})()
        self._address = ctypes.byref(self._structure)
        self._arrays: dict[str, np.ndarray] = {}
        self.source = text
        self.library = loaded(text)
        for name, values in vectors.items():
            self[name] = np.array(values or [0.0])

    def __setitem__(self, name: str, value: Any) -> None:
        kind = self._types.get(name)
        if kind in self._dtypes and value is not None:
            value = np.ascontiguousarray(value, self._dtypes[kind])
            if value.ctypes.data % LINE:
                value, unaligned = aligned_zeros(value.shape, value.dtype), value
                value[...] = unaligned
            self._arrays[name] = value
            value = value.ctypes.data
        setattr(self._structure, name, value)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __call__(self, function: str, *arguments: Any) -> int:
        """Call a C function on the scene; arrays are passed by address, floats and ints by value."""
        return getattr(self.library, function)(self._address, *[_argument(a) for a in arguments])

    def repeated(self, n: int, function: str, *arguments: Any) -> None:
        """Call a C function `n` times, with as little in between as Python can."""
        call, arguments = getattr(self.library, function), [_argument(a) for a in arguments]
        for _ in range(n):
            call(self._address, *arguments)

    @property
    def bytes(self) -> int:
        """Size of all arrays that it works on [B]."""
        return sum(a.nbytes for a in self._arrays.values())


def _argument(a: Any) -> Any:
    if isinstance(a, np.ndarray):
        return ctypes.c_void_p(a.ctypes.data)
    if isinstance(a, float):
        return ctypes.c_double(a)
    return ctypes.c_long(a) if isinstance(a, int) else a


def _of_materials(materials: list) -> list[Field]:
    """The parameters of each material's law."""
    return [Field(f"material_{i}", "double *") for i in range(len(materials))]


def c_source(materials: list, terms: Terms, fields: Sequence[Field] = ()) -> tuple[str, dict[str, list[float]]]:
    """C source of the scene and the parameter vectors of its laws.

    Raises LawError where a law has no counterpart in C.
    """
    members = [f"    {f.ctype}{'' if f.ctype.endswith('*') else ' '}{f.name};"
               for f in [*fields, *_of_materials(materials)]]
    members += [f"    int (*ghost_{end})(void *, int, int);" for end in ("begin", "end")]
    parts = ["#define SINGLE 1" if terms.single else "", VECTORS.read_text(encoding="utf-8"),
             "typedef struct {\n" + "\n".join(members) + "\n} KernelData;\n"]
    vectors: dict[str, list[float]] = {}

    parts.append(_materials(materials, terms.director, terms.active, vectors))
    for name, methods in SURFACE_LAWS.items():
        if (law := getattr(terms, name)) is not None:
            t = Translator(law, "double")
            parts += [f"#define {name.upper()} 1", *(t.function(m, f"{name}_{m}") for m in methods)]
            vectors[name] = t.vector()
    has = {"VISCOUS": any(hasattr(m, "viscous_stress") for m in materials), "STABILISED": terms.stabilised,
           "BULK_DAMPED": terms.bulk_damped, "STIFFENED": terms.stiffened,
           "ACTIVE": terms.active, "DIRECTOR": terms.director != "none" or terms.active,
           "DIRECTOR_RELAXES": terms.director == "relaxing"}
    parts += [f"#define {name} 1" for name, present in has.items() if present]
    if terms.load_curves is not None:
        parts += ["#define BOUNDARY 1", *_load_curves(terms.load_curves, vectors)]
    return "\n".join([*parts, STEP.read_text(encoding="utf-8")]), vectors


def _load_curves(laws: tuple, vectors: dict) -> list[str]:
    """Factors on supports, loads and plates and their rates, by the number of the time law."""
    parts, vectors["load_curves"] = [], []
    for method in ("value", "rate", "acceleration"):
        choice = []
        for i, law in enumerate(laws):
            t = Translator(law, "double")
            parts.append(t.function(method, f"load_curve_{i}_{method}"))
            at = len(vectors["load_curves"])
            choice.append(f"    if (i == {i}) return load_curve_{i}_{method}(s->load_curves + {at}, t);\n")
            vectors["load_curves"] += t.vector()
        parts.append(f"static inline double load_curve_{method}(const KernelData *s, long i, double t)\n{{\n"
                     f"    (void)s, (void)i, (void)t;\n{''.join(choice)}    return 0;\n}}\n")
    return parts


def _materials(materials: list, director: str, active: bool, vectors: dict) -> str:
    """Pointwise functions of each material, and their dispatch."""
    parts, stress, flux, viscous, activated = [], [], [], [], []
    for i, material in enumerate(materials):
        t, p = Translator(material, "v4"), f"s->material_{i}"
        methods = type(material)
        parts.append(t.function("stress", f"stress_{i}"))
        lines = [f"stress_{i}({p}, F, p);"]
        if hasattr(methods, "viscous_stress"):
            viscous.append(i)
            parts.append(t.function("viscous_stress", f"viscous_stress_{i}"))
            lines.append(f"viscous_stress_{i}({p}, F, R, w);")
        if director != "none" and hasattr(methods, "director_stress"):
            parts.append(t.function("director_stress", f"director_stress_{i}"))
            lines.append(f"v4 t[2][2]; director_stress_{i}({p}, F, g, t); ADD(p, t);")
            parts.append(t.function("director_flux", f"director_flux_{i}"))
            flux.append(f"    if (material == {i}) director_flux_{i}({p}, F, g, flux);")
        if active and hasattr(methods, "active_stress"):
            activated.append(i)
            parts.append(t.function("active_stress", f"active_stress_{i}"))
            lines.append(f"active_stress_{i}({p}, F, h, a);")
        stress.append(f"    if (material == {i}) {{ v4 (*p)[2] = P, (*w)[2] = W, (*a)[2] = A; (void)w, (void)a; "
                      f"{' '.join(lines)} return; }}")
        vectors[f"material_{i}"] = t.vector()
    fields = ""
    if director != "none" or active:
        fields = ("    const v4 g[2] = {load(s->director_gradient + 8 * b), load(s->director_gradient + 8 * b + 4)};\n"
                  "    const v4 h[2] = {load(s->director_axis + 8 * b), load(s->director_axis + 8 * b + 4)};\n"
                  "    (void)g; (void)h;\n")
    each = " ".join(f"DO({i})" for i in range(len(materials)))
    parts.append(_DISPATCH.format(each=each, fields=fields, stress="\n".join(stress), flux="\n".join(flux),
                                  viscous=_any_of(viscous), active=_any_of(activated)))
    return "\n".join(parts)


def _any_of(numbers: list[int]) -> str:
    return " || ".join(f"material == {i}" for i in numbers) or "0"


_DISPATCH = """#define EACH_MATERIAL(DO) {each}
#define ADD(p, t) (p[0][0] += t[0][0], p[0][1] += t[0][1], p[1][0] += t[1][0], p[1][1] += t[1][1])

/* Whether a block of this material has such stresses. */
static inline int is_viscous(int material) {{ (void)material; return {viscous}; }}
static inline int is_active(int material) {{ (void)material; return {active}; }}

INLINED void material_stress(const KernelData *s, long b, const int material,
    const v4 F[2][2], const v4 R[2][2], v4 P[2][2], v4 W[2][2], v4 A[2][2])
{{
{fields}    (void)b, (void)R;
{stress}
}}

static inline void material_director_flux(const KernelData *s, int material, const v4 F[2][2], const v4 g[2],
    v4 flux[2])
{{
    flux[0] = flux[1] = (v4){{0}};
    (void)s, (void)material, (void)F, (void)g;
{flux}
}}
"""


def assemble(*arguments: Any) -> None:
    """The function of assemble.c; integers in arrays are of type long."""
    library(ASSEMBLE).assemble(*[_argument(a) for a in arguments])
