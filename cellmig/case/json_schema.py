"""JSON schema of a case file, with which editors complete and check TOML."""

from __future__ import annotations

import json
from typing import Any

from . import registry
from .schema import Case, Cell, case_fields, case_path
from .values import bounds, declared, example, required, type_name, write

# Keys of JSON schema for the bounds of a pure number.
_LIMITS = {"above": "exclusiveMinimum", "minimum": "minimum", "maximum": "maximum"}
_GROUPS = {"adhesion": "adhesion to the substrate and between cells", "body_force": "a body force"}
_TYPES = {"int": "integer", "bool": "boolean", "str": "string", "float": "number"}


def json_schema() -> dict:
    """JSON schema (draft 2020-12) of a case, from its declarations and the registered laws."""
    root = _object({"extends": {"type": "string", "description": "case file whose tables this one is laid over"}},
                   doc=Case.__doc__.split("\n")[0])
    for f in case_fields().values():
        table = root
        *groups, key = case_path(f)
        for group in groups:
            table = table["properties"].setdefault(group, _object({}, _GROUPS[group]))
        table["properties"][key] = _part(f)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cellmig case", **root}


def _part(f: Any) -> dict:
    """Schema of a field of the case: a section, laws, cells or a value."""
    meta = f.metadata
    if "section" in meta:
        return _record(meta["section"], doc=meta["doc"])
    if "items_of" in meta:
        around = meta["items_of"]
        if isinstance(around, str):
            return {"type": "array", "description": meta["doc"], "items": _choice(around, "law")}
        key, law = next(((name, f) for name, f in declared(around).items() if f.metadata.get("inline")), (None, None))
        item = _choice(law.metadata["kind"], key, around) if law is not None else _record(around)
        return {"type": "array", "description": meta["doc"], "items": item}
    if "kind" not in meta:
        return _value(f)
    one = _choice(meta["kind"], "law")
    if meta.get("many"):
        return {"type": "object", "description": meta["doc"], "additionalProperties": one}
    return {"description": meta["doc"], **one}


def _choice(kind: str, key: str, around: type | None = None) -> dict:
    """Schema of a table whose `key` names a law of a kind, with the parameters of the law and of the class `around`."""
    options, known = [], registry.laws(kind)
    meaning = "; ".join(f"\"{name}\": {_first_sentence(cls)}" for name, cls in known.items())
    for name, cls in known.items():
        option = _record(cls, doc=_first_sentence(cls))
        if around:
            option["properties"] |= _record(around)["properties"]
        if around is Cell:
            option["additionalProperties"] = {"type": "object", "description": "what differs in the copy of this name"}
        option["properties"][key] = {"const": name, "description": meaning}
        options.append(option)
    return {"type": "object", "properties": {key: {"enum": list(known), "description": meaning}}, "anyOf": options}


def _first_sentence(cls: type) -> str:
    """First sentence of the docstring of a law."""
    first = " ".join(cls.__doc__.split("\n\n")[0].split())
    return first.split(". ")[0].rstrip(".")


def _record(cls: type, doc: str = "") -> dict:
    """Schema of a declared class; no key is required, as a file may extend another one that has it."""
    return _object({name: _value(f) for name, f in declared(cls).items()}, doc)


def _object(properties: dict, doc: str = "") -> dict:
    return {"type": "object", "properties": properties, "additionalProperties": False} | (
        {"description": doc} if doc else {})


def _value(f: Any) -> dict:
    """Schema of a key: its type, unit, bounds, default and choices."""
    meta = f.metadata
    if "kind" in meta and not meta.get("inline"):
        return {"description": meta["doc"], **_choice(meta["kind"], "law")}
    if "record" in meta:
        return _record(meta["record"], doc=meta["doc"])
    unit = meta.get("unit", "")
    leaf: dict = {"type": "string" if unit or "items" in meta else _TYPES.get(type_name(f), "number")}
    if meta.get("items") == "count":
        leaf = {"type": "integer", "minimum": 1}
    if meta.get("items") == "pair":
        leaf = {"anyOf": [leaf, {"type": "array", "items": leaf}]}
    if unit:
        number = r"^.*\S\s+\S+$" if meta.get("formula") else r"^\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*\S+"
        if "or_name" not in meta:
            leaf["pattern"] = "|".join([number, *meta.get("words", ())])
    else:
        leaf |= {_LIMITS[k]: meta[k] for k in _LIMITS if meta.get(k) is not None}
    if "choices" in meta:
        leaf["enum"] = list(meta["choices"])
    if meta.get("scaled"):
        leaf = {"anyOf": [leaf, {"type": "number"}]}
    elif meta.get("formula") and not unit:
        leaf = {"anyOf": [leaf, {"type": "string"}]}
    for n in reversed(meta.get("shape") or {"pair": (2,)}.get(meta.get("items"), (None,) if "items" in meta else ())):
        least, most = {"d": (2, 3), "d-1": (1, 2)}.get(n, (n, n))
        sizes = {"minItems": meta.get("least", least), "maxItems": most} if n else {}
        leaf = {"type": "array", "items": leaf} | sizes
    if "reader" in meta:
        leaf = {"type": meta.get("as_type", "object")}
    if meta.get("or_file"):
        leaf = {"anyOf": [leaf, {"type": "string"}]}
    limits = bounds(meta) and f", {bounds(meta)}"
    leaf["description"] = meta["doc"] + (f" [{unit or '-'}]" if "unit" in meta else "") + limits
    if not required(f) and f.default is not None:
        leaf["default"] = write(f, f.default)
        leaf["description"] += f"; default: {json.dumps(leaf['default'], ensure_ascii=False)}"
    elif unit:
        leaf["examples"] = [example(f)] if meta.get("shape") else [json.loads(example(f))]
    if "known" in meta:
        leaf["examples"] = list(meta["known"])
    return leaf
