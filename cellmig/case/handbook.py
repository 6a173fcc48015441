"""Reference of case files in Markdown: every key and every law, from their declarations."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from . import registry, units
from .schema import Cell, Pair, case_fields, case_path
from .values import bounds, declared, required, type_name, write

_HEAD = ["| key | unit | default | allowed | meaning |", "|---|---|---|---|---|"]
_BESIDE = {Cell: "  Beside these stand the keys of its shape, below under *shape*.  After a repeated cell, a table "
                 "`[cells.NAME]` holds what differs in the copy of that name.",
           Pair: "  Beside these stand keys of the law, below under *adhesion*; those that are not given are as in "
                 "`[adhesion.cells]`.  The name of a repeated cell stands for all its copies: `[\"R-{}\", \"R-{}\"]` "
                 "are the pairs among them.  One cell with itself is its own outline, which repels but does not "
                 "adhere."}
_TYPES = {"int": "whole number", "bool": "true or false", "str": "text", "float": "number", "tuple": "list"}


def handbook() -> str:
    """The reference as one Markdown page."""
    lines = ["# Keys and laws of a case", "",
             "Which keys and laws may a case have, and what do they mean? This page is written by `cellmig schema "
             "--markdown` from the declarations in the code.", "",
             'A quantity is a string with its unit, such as `"10 nm"`. Any unit of the right kind will do: these, with '
             f"the usual prefixes, and their products, quotients and powers: {', '.join(units.SYMBOLS)}; or their full "
             "names. "
             "A default of *needed* is none.", "",
             "## Top level", "", *_table(_plain_fields())]
    for f in case_fields().values():
        lines += ["", *_section(f)] if _is_section(f) else []
    lines += ["", "## Laws", "", "`law = \"name\"` in the table of a term, and the parameters of that law."]
    for kind in sorted(registry.kinds()):
        for name, cls in registry.laws(kind).items():
            lines += ["", f"### {kind}: `{name}`", "", *_law(cls)]
    return "\n".join(lines) + "\n"


def _is_section(f: Any) -> bool:
    return "section" in f.metadata or "items_of" in f.metadata or "kind" in f.metadata


def _plain_fields() -> Iterator[tuple[str, Any]]:
    yield from ((".".join(case_path(f)), f) for f in case_fields().values() if not _is_section(f))


def _section(f: Any) -> list[str]:
    """Lines on a table, or a list of tables, of the case file."""
    meta, path = f.metadata, ".".join(case_path(f))
    if "section" in meta:
        return [f"## `[{path}]`", "", f"{_sentence(meta['doc'])}.", "", *_table(declared(meta["section"]).items())]
    if "items_of" in meta and not isinstance(meta["items_of"], str):
        more = _BESIDE.get(meta["items_of"], "")
        return [f"## `[[{path}]]`", "", f"{_sentence(meta['doc'])}.{more}", "",
                *_table(declared(meta["items_of"]).items())]
    kind = meta.get("kind", meta.get("items_of"))
    known = ", ".join(f"[`{name}`](#{_anchor(kind, name)})" for name in registry.laws(kind))
    title = f"[{path}]" if "items_of" in meta else f"{path}.NAME" if meta.get("many") else path
    return [f"## `[{title}]`", "", f"{_sentence(meta['doc'])}.  Laws: {known}."]


def _law(cls: type) -> list[str]:
    """Lines on a law: its docstring and its parameters."""
    where = f"`{cls.__module__.replace('.', '/')}.py`"
    return [*_paragraphs(inspect.cleandoc(cls.__doc__)), "", f"In {where}.", "", *_table(declared(cls).items())]


def _paragraphs(text: str) -> list[str]:
    return [line.replace("|", "\\|").replace("*", "\\*").replace("_", "\\_") for line in text.split("\n")]


def _table(fields: Any) -> list[str]:
    rows = [_row(name, f) for name, f in fields]
    return [*_HEAD, *rows] if rows else ["No parameters."]


def _row(name: str, f: Any) -> str:
    meta = f.metadata
    default = "*needed*" if required(f) else _value(f)
    words = [f'"{word}"' for word in meta.get("words", ())]
    allowed = [bounds(meta), *words, *(f'"{word}"' for word in meta.get("choices", ())),
               "a formula" if meta.get("formula") else "", "a file" if meta.get("or_file") else "",
               f"a name of [{meta['or_name']}s.NAME]" if "or_name" in meta else ""]
    if "kind" in meta:
        allowed = [", ".join(registry.laws(meta["kind"]))]
    if "record" in meta:
        allowed = ["; ".join(f"`{key}`: {one.metadata['doc']}" for key, one in declared(meta["record"]).items())]
    read = [{"string": "text"}.get(name, name) for name in np.atleast_1d(meta.get("as_type", []))]
    kind = " or ".join(read) or _TYPES.get(type_name(f), "table")
    unit = meta.get("unit") or ("" if "unit" in meta or "kind" in meta else f"({kind})")
    cells = [f"`{name}`", unit, default, ", ".join(filter(None, allowed)), _sentence(meta["doc"])]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _value(f: Any) -> str:
    if f.default is None or f.default == ():
        return ""
    if "d" in f.metadata.get("shape", ()) and not np.any(np.array(f.default)):
        return "0"
    return f"`{json.dumps(write(f, f.default), ensure_ascii=False)}`"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _anchor(kind: str, name: str) -> str:
    """Name of the heading of a law in a link."""
    return f"{kind}-{name}".replace(" ", "-").lower()
