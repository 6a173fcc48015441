"""C computes what the formulas of laws say, and what is no formula is told with its line."""

from __future__ import annotations

import ctypes
import inspect
from collections.abc import Iterator
from functools import cache
from math import pi
from typing import Any

import numpy as np
import pytest
from numpy import arctan, cbrt, cos, cosh, exp, log, maximum, minimum, sin, sinh, sqrt, tan, tanh, where
from samples import (
    assert_close,
    deformations,
    directions,
    distances,
    fractions,
    gradients,
    networks,
    rates,
    slope,
)
from scenes import example

from cellmig.case.pairs import Pairing
from cellmig.case.pointwise import either
from cellmig.case.registry import laws
from cellmig.kernel.codegen import TENSORS, Translator, shapes_of
from cellmig.kernel.source import text_of
from cellmig.kernel.symbols import LawError
from cellmig.kernel.terms import ANCHORS, FORMULAS, SURFACE_TERMS
from cellmig.kernel.toolchain import loaded
from cellmig.meshfree.terms import Contacts, Frictions, Terms
from cellmig.model.membranes import CortexTension, ProtrusionPush, SlidingFriction, TriangleAdhesion
from cellmig.model.polyhedra import PolyhedronAdhesion
from cellmig.model.triangles import TriangleBonds
from cellmig.solve.tangent import derivative

pytestmark = pytest.mark.serial


def stacked(value: Any, n: int) -> np.ndarray:
    """Nested numbers of a formula as an array (shape, n)."""
    return np.array([stacked(v, n) for v in value]) if isinstance(value, tuple) else np.broadcast_to(value, n)


class Call:
    """A method of a law or formula with its arguments (..., n), n a multiple of four, in Python and in C.

    value : what Python gives, one array for each of the `results` that have names, or a single one.
    """

    def __init__(self, law: Any, method: str, number: str, arguments: dict[str, np.ndarray], results: tuple = (),
                 d: int = 2):
        self.law, self.method, self.number, self.arguments, self.results, self.d = (
            law, method, number, arguments, results, d)
        value = getattr(law, method)(*arguments.values())
        n, self.returned = next(iter(arguments.values())).shape[-1], not isinstance(value, tuple)
        self.value = [stacked(v, n) for v in (value if results else (value,))]

    def run_in(self, library: ctypes.CDLL, name: str) -> tuple[np.ndarray, ...]:
        """What C gives, in the form of `value`."""
        lanes, n = self._lanes, next(iter(self.arguments.values())).shape[-1]
        # groups of four (or one) values, component by component
        passed = [np.ascontiguousarray(np.moveaxis(values.reshape(*values.shape[:-1], -1, lanes), -2, 0))
                  for values in self.arguments.values()]
        out = [np.zeros((n // lanes, *part.shape[:-1], lanes)) for part in self.value]
        addresses = [ctypes.c_void_p(a.ctypes.data) for a in (np.array(self._parameters or [0.0]), *passed, *out)]
        library[f"run_{name}"](ctypes.c_long(n), *addresses)
        return tuple(np.moveaxis(a, 0, -2).reshape(part.shape) for a, part in zip(out, self.value, strict=True))

    def source(self, name: str) -> str:
        """The function `name` of the method, and `run_name`, which calls it for all values."""
        translator, lanes, number = Translator(self.law, self.number, self.d), self._lanes, self.number
        text = translator.function(self.method, name, self.results)
        self._parameters = translator.vector()
        call, lines = ["p"], []
        for argument, values in self.arguments.items():
            shape = values.shape[:-1]
            lines.append(f"{number} {argument}{''.join(f'[{k}]' for k in shape)};")
            lines.append(f"memcpy(&{argument}, in_{argument} + i * {int(np.prod(shape))}, sizeof {argument});")
            call.append(f"(const {number} (*)[{shape[1]}]){argument}" if len(shape) == 2 else argument)
        names = [f"{result}_" for result in self.results or ("result",)]
        lines += [f"{number} {result}[{']['.join(map(str, part.shape[:-1] or (1,)))}];"
                  for result, part in zip(names, self.value, strict=True)]
        lines.append(f"result_[0] = {name}({', '.join(call)});" if self.returned
                     else f"{name}({', '.join(call + names)});")
        lines += [f"memcpy(out_{result} + i / {lanes} * (sizeof {result} / 8), &{result}, sizeof {result});"
                  for result in names]
        taken = [f"const double *in_{argument}" for argument in self.arguments]
        signature = ", ".join([*taken, *(f"double *out_{result}" for result in names)])
        return "\n".join([
            text, f"void run_{name}(long n, const double *p, {signature}) {{",
            f"    for (long i = 0; i < n; i += {lanes}) {{", *["        " + line for line in lines], "    }\n}\n"])

    @property
    def _lanes(self) -> int:
        return 4 if self.number == "v4" else 1


def in_c(calls: dict[Any, Call]) -> dict[Any, tuple[Call, tuple[np.ndarray, ...]]]:
    """Calls and what C gives for them, compiled as one file: half a second each if it were one for each."""
    source = [call.source(f"method_{k}") for k, call in enumerate(calls.values())]
    library = loaded("\n".join([text_of("simd.h"), *source]))
    return {key: (call, call.run_in(library, f"method_{k}")) for k, (key, call) in enumerate(calls.items())}


LIMIT = 0.25


class Formulas:
    """What a law's formula may have, one method for each; F and the rest are arguments as the translator knows them."""

    rate, least, whole, words = 0.7, 0.2, 3, True

    def exponential(self, r):
        return exp(-self.rate * r) + np.exp(-900.0 * r * r)

    def circular(self, r):
        return sin(r) + cos(2.0 * r) * tan(0.1 * r) - arctan(r)

    def hyperbolic(self, r):
        return tanh(r) + sinh(0.1 * r) / cosh(r)

    def powers(self, r):
        a = abs(r) + self.least
        return a**0.5 + a**-1.5 + a**3 + a**self.rate + 2.0**r + a**self.whole + r**2.0

    def chosen(self, r):
        return where(r > 0.0, exp(r), 1.0) + maximum(r, 0.0) * minimum(r, self.least) + where(self.rate < 1.0, r, 7.0)

    def constant(self, r):
        a = self.rate * 2.0
        return a + exp(self.rate) + pi + LIMIT

    def other(self, r):
        a, b = r, self.powers(r)
        return a * log(b) - sqrt(cbrt(b))

    def repeated(self, r):
        total = 0.0
        for k, a in enumerate([r, 2.0 * r, -r]):
            total = total + (k + 1) * a * a
        return total if self.words else r


METHODS = [name for name in vars(Formulas) if inspect.isfunction(getattr(Formulas, name))]


@cache
def methods_in_c() -> dict:
    r = np.linspace(-2.0, 2.0, 400)
    return in_c({(method, number): Call(Formulas(), method, number, {"r": r})
                 for method in METHODS for number in ("double", "v4")})


@pytest.mark.parametrize("number", ["double", "v4"])
@pytest.mark.parametrize("method", METHODS)
def test_every_function_that_a_formula_may_have_is_the_same_in_c(method: str, number: str) -> None:
    call, (found,) = methods_in_c()[method, number]
    expected, = call.value
    assert np.abs(found - expected).max() <= 3e-15 * np.abs(expected).max()  # measured 1.3e-15, of v4_log


@pytest.mark.parametrize("method", METHODS)
def test_every_function_that_a_formula_may_have_has_its_derivative(method: str) -> None:
    r, function = np.linspace(-1.9, 1.93, 50), getattr(Formulas(), method)
    value, found = derivative(function, r)
    expected = slope(lambda x: function(x) + 0.0 * x, r, 1e-4)
    assert np.abs(found[0] - expected).max() < 1e-9 * max(1.0, np.abs(expected).max())  # measured 6e-11, of differences
    assert np.abs(value - function(r)).max() <= 1e-15 * np.abs(value).max()


class Wrong:
    """Formulas that are none."""

    rate, words = 1.0, "many"

    def unknown(self, r):
        return exp2(r)  # noqa: F821

    def asking(self, r):
        return r if r > 0.0 else -r

    def wordy(self, r):
        return r * self.words

    def missing(self, r):
        return r * self.nothing

    def twice(self, r):
        return where(r > 0.0, r)

    def between(self, r):
        return where(0.0 < r < 1.0, r, 0.0)

    def endless(self, r):
        return self.endless(r)

    def silent(self, r):
        r = r * 2.0

    def name(self, r):
        return r * undefined  # noqa: F821

    def whole(self, r):
        return r // 2.0

    def uneven(self, r):
        return either(r > 0.0, (r, r), (r,))


@pytest.mark.parametrize(("method", "line", "what"), [
    ("unknown", 1, "'return exp2(r)' is not translated to C: name 'exp2' is not defined"),
    ("asking", 1, "what depends on a value is where(condition, a, b)"),
    ("wordy", 1, "'self.words' is no number"), ("missing", 1, "'self.nothing' is no number"),
    ("twice", 1, "where takes 3"), ("between", 1, "not if, and, or, a < b < c"), ("endless", 1, "calls itself"),
    ("silent", 0, "returns nothing"), ("name", 1, "name 'undefined' is not defined"), ("whole", 1, "is not translated"),
    ("uneven", 1, "two tuples of the same shape")])
def test_a_formula_that_cannot_be_translated_is_told_with_its_file_and_line(method: str, line: int, what: str) -> None:
    with pytest.raises(LawError) as error:
        Translator(Wrong(), "v4").function(method, "translated")
    number = inspect.getsourcelines(getattr(Wrong, method))[1] + line
    assert f"test_codegen.py:{number}: Wrong.{method}: " in str(error.value) and what in str(error.value)


class Scaled:
    """A law that does otherwise where it is told so, with one of its own of any class."""

    def __init__(self, twice: bool, other: Any, factor: float):
        self.twice, self.other, self.factor = twice, other, factor

    def scaled(self, r):
        return self.factor * self.other.cubed(r) * (2.0 if self.twice else 1.0)

    def cubed(self, r):
        return r**3 + self.factor


def test_a_law_is_translated_anew_where_its_attributes_are_of_other_kinds_only() -> None:
    class Other(Formulas):
        def cubed(self, r):
            return r * 7.0

    source, shared, vectors = [], [], []
    for law in (Scaled(True, Scaled(True, None, 2.0), 3.0), Scaled(False, Scaled(True, None, 2.0), 3.0),
                Scaled(True, Other(), 3.0), Scaled(True, Scaled(True, None, 5.0), 4.0)):
        translator = Translator(law, "double")
        source.append(translator.function("scaled", "f"))
        vectors.append(translator.vector())
        shared.append(source[-1] is source[0])
    assert shared == [True, False, False, True] and len(set(source)) == 3
    assert vectors == [[3.0, 2.0], [3.0, 2.0], [3.0], [4.0, 5.0]]


def pointwise_methods(kind: str) -> list[tuple[str, str]]:
    """(law, method) for all methods of formulas: those with arguments that the translator knows."""
    known = {"material": {*TENSORS, "share", "time"}, "adhesion": {"r"}, "protrusion": {"g"}}[kind]
    functions = [(name, method, set(inspect.signature(f).parameters) - {"self"}) for name, cls in laws(kind).items()
                 for method, f in inspect.getmembers(cls, inspect.isfunction) if not method.startswith(("_", "pair"))]
    return [(name, method) for name, method, arguments in functions if arguments and arguments <= known]


@cache
def materials_in_c() -> dict:
    calls = {}
    for d in (2, 3):
        given = {"F": deformations(d=d), "Fdot": rates(d=d), "gradient": gradients(d=d), "director": directions(d=d),
                 "network": networks(d=d), "share": fractions(), "time": fractions()}
        for name, method in pointwise_methods("material"):
            law = example("material", name)
            taken = list(inspect.signature(getattr(type(law), method)).parameters)[1:]
            calls[name, method, d] = Call(law, method, "v4", {argument: given[argument] for argument in taken}, d=d)
    return in_c(calls)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("name", "method"), pointwise_methods("material"))
def test_material_is_the_same_in_c(name: str, method: str, d: int) -> None:
    call, found = materials_in_c()[name, method, d]
    assert_close(*found, *call.value, 1e-13)  # measured 0; log and cbrt may round otherwise


def along(kind: str, law: Any) -> dict[str, np.ndarray]:
    """The argument of laws of a kind, through all that they distinguish."""
    return {"r": distances(law)} if kind == "adhesion" else {"g": np.linspace(-0.5, 1.5, 400) * law.height}


@cache
def of_distance_in_c() -> dict:
    calls = {}
    for kind in ("adhesion", "protrusion"):
        for name, method in pointwise_methods(kind):
            law = example(kind, name)
            calls[kind, name, method] = Call(law, method, "double", along(kind, law))
    return in_c(calls)


@pytest.mark.parametrize(("kind", "name", "method"), [
    (kind, *found) for kind in ("adhesion", "protrusion") for found in pointwise_methods(kind)])
def test_adhesion_and_protrusion_are_the_same_in_c(kind: str, name: str, method: str) -> None:
    call, found = of_distance_in_c()[kind, name, method]
    assert_close(*found, *call.value, 1e-14)  # measured 0


KINDS = {"substrate": "adhesion", "contact": "adhesion", "cortex": "cortex", "friction": "friction", "medium": "medium",
         "protrusion": "protrusion"}  # of laws, by surface terms that have one


def formulas() -> Iterator[tuple[str, Any, str, str, tuple]]:
    """All formulas of forces, with each law of their kind: name, object, C type, method, names of results."""
    default = {part: example(kind, next(iter(laws(kind)))) for part, kind in KINDS.items()}
    for term in SURFACE_TERMS:
        for name in laws(KINDS[term.name]) if term.name in KINDS else [""]:
            chosen = {term.name: example(KINDS[term.name], name)} if name else {}
            laws_of = default | chosen
            contacts = Contacts((laws_of["contact"],), Pairing(*np.zeros((3, 1, 1), int)), False)
            laws_of["friction"] = Frictions((laws_of["friction"],), np.zeros(1, int))
            formula = term.formula(Terms(**laws_of, contacts=contacts, load_curves=()))
            formula = formula[0] if isinstance(formula, tuple) else formula
            for method, results in term.methods.items() if formula is not None else ():  # of two dimensions
                number = "v4" if method in term.in_fours else "double"
                yield f"{term.name}-{name}-{method}", formula, number, method, results
    for formula, number, method, name, results in FORMULAS + ANCHORS[2]:
        yield name, formula, number, method, results


@cache
def forces_in_c() -> dict:
    """Segments as of the paper's cells, from pressed to out of reach, level and inclined."""
    calls = {}
    for key, formula, number, method, results in formulas():
        rng, given = np.random.default_rng(4), {}
        for name, shape in shapes_of(getattr(type(formula), method)).items():
            given[name] = rng.uniform(0.002, 0.1, (*shape, 400))
        if "gap2" in given:
            given["gap2"][::2] = given["gap1"][::2] * rng.uniform(0.97, 1.03, 200)
        if "across" in given:
            given["across"] *= 0.02  # µm², of edges of some 50 nm
        if "F" in given:
            given["F"] += np.eye(2)[:, :, None]
        calls[key] = Call(formula, method, number, given, results)
    return in_c(calls)


@pytest.mark.parametrize("name", [name for name, *_ in formulas()])
def test_a_force_is_the_same_in_c(name: str) -> None:
    """To the last bit, but for logarithms, and four points at once, where sums with a product are rounded once."""
    call, parts = forces_in_c()[name]
    for found, right in zip(parts, call.value, strict=True):
        assert np.abs(found).max() > 0.0
        # measured 0, of logarithms 2e-16; of four points 2e-16
        assert np.abs(found - right).max() < (1e-15 if call.number == "double" else 1e-13) * np.abs(right).max()


def triangles() -> Iterator[tuple[Any, str, tuple]]:
    """Formulas of the triangles of surfaces in space: object, method, names of results."""
    bonds = TriangleBonds(example("adhesion", "seifert"))
    yield TriangleAdhesion(bonds), "facet", ("force", "energy")
    yield TriangleAdhesion(bonds), "kind", ()
    yield TriangleAdhesion(bonds), "stiffness", ()
    yield PolyhedronAdhesion(bonds), "face", ("loads", "energy", "stiff")
    yield PolyhedronAdhesion(bonds), "edge", ("loads", "energy", "stiff")
    yield from ((PolyhedronAdhesion(bonds), f"{name}_kind", ()) for name in ("face", "edge"))
    yield PolyhedronAdhesion(bonds), "vertex", ("load", "energy", "stiff")
    for name in ("face", "edge", "vertex"):
        yield PolyhedronAdhesion(bonds), f"{name}_stiffness", ("stiffness",)
    yield CortexTension(example("cortex", "line-tension")), "force", ()
    yield CortexTension(example("cortex", "line-tension")), "energy", ()
    yield from ((SlidingFriction(example("friction", name), bonds), "force", ()) for name in laws("friction"))
    yield ProtrusionPush(example("protrusion", "edge"), bonds), "grip", ()
    yield from ((ProtrusionPush(example("protrusion", "edge"), bonds), name, ()) for name in ("force", "edge", "kind"))
    yield from ((anchor, method, results) for anchor, _, method, _, results in ANCHORS[3])


def named(formula: Any, method: str) -> str:
    """A formula with its law, by their classes."""
    law = next((type(part).__name__ for part in vars(formula).values() if not isinstance(part, TriangleBonds)), "")
    return f"{type(formula).__name__}-{law}-{method}"


@cache
def triangles_in_c() -> dict:
    calls = {}
    for formula, method, results in triangles():
        rng = np.random.default_rng(4)
        given = {name: rng.uniform(0.002, 0.1, (*shape, 400))
                 for name, shape in shapes_of(getattr(type(formula), method)).items()}
        for name in ("gap2", "gap3"):
            if name in given:
                given[name][::2] = given["gap1"][::2] * rng.uniform(0.97, 1.03, 200)
        calls |= {(named(formula, method), number): Call(formula, method, number, given, results)
                  for number in ("double", "v4")}
    return in_c(calls)


@pytest.mark.parametrize("number", ["double", "v4"])
@pytest.mark.parametrize("name", [named(formula, method) for formula, method, _ in triangles()])
def test_a_force_on_a_triangle_is_the_same_in_c(name: str, number: str) -> None:
    """But for the last bit of logarithms, which divided differences make more of; four may go several ways."""
    call, parts = triangles_in_c()[name, number]
    for found, right in zip(parts, call.value, strict=True):
        assert_close(found, right, 1e-9)  # measured 2e-10
