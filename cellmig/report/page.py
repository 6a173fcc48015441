"""The page of a run: its frames in a player, curves of its tables, what it was, cost and did."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from cellmig.output.manifest import read_manifest, time_unit
from cellmig.output.tables import names_of, unit_of

from . import tables
from .html import Bar, citation, pairs, part, table, whole
from .movie import movie

Rows = Sequence[tuple[str, Any]]


@dataclass(frozen=True)
class About:
    """What is told of a run in words.

    lead : one sentence on how it stands;  summary, scene : rows of key and value;  warnings : each with what to do;
    motion : head and rows of a table of how its cells moved.
    """

    lead: str
    summary: Rows
    scene: Rows = ()
    warnings: Sequence[tuple[str, str]] = ()
    motion: tuple[Sequence[str], Sequence[Sequence[Any]]] = ((), ())


def page(directory: Path, about: About, live: bool = False) -> str:
    """The page of a run, complete or not, as one text of HTML.

    live : it asks the server that it came from for news.  Raises OutputError where files of the run are not as written.
    """
    manifest = read_manifest(directory)
    case = manifest.get("case") or {}
    history = tables.read(directory, "history")
    film = movie(directory, names_of(history) if history else {})
    unit = unit_of(history).label if history else time_unit(manifest).label
    data = {"live": live, "unit": unit, "movie": film, "charts": tables.charts(directory),
            "ledger": tables.ledger(directory), "tracks": tables.tracks(directory) if film else None,
            "traction": tables.traction(directory, film["times"]) if film else None}
    if film and film["dimension"] == 3:
        film["behind"] = tables.ground(directory, film["times"])
    title = str(case.get("title") or directory.name)
    return whole(title, escape(about.lead), _sections(directory, about, manifest, data), data)


def _sections(directory: Path, about: About, manifest: Mapping[str, Any], data: Mapping[str, Any]
              ) -> list[tuple[str, str, str]]:
    """Name, heading and HTML of each section, empty where the run has nothing for it."""
    film = data["movie"]
    none = "" if film else "<p>This run has no frames to show yet.</p>"
    note = f'<p class="note">{escape(film["left_out"])}</p>' if film and film["left_out"] else ""
    curves = [(chart["name"], chart["title"], f'<div class="charts" data-chart="{chart["name"]}"></div>'
               + (f'<p class="note">{escape(chart["left_out"])}</p>' if chart["left_out"] else ""))
              for chart in data["charts"]]
    traction = '<div class="charts" data-chart="traction"></div>' if data["traction"] else ""
    return [("warnings", "Warnings", _warnings(about.warnings)),
            ("player", "Frames", part("player.html") + note if film else none),
            *curves[:1], ("motion", "How cells moved", table(*about.motion) if about.motion[1] else ""),
            ("traction", "Traction on the substrate", traction), *curves[1:],
            ("energy", "Energy", _energy(directory, data["ledger"])),
            ("about", "What it was and did", pairs(about.summary)),
            ("scene", "The scene", pairs(about.scene)),
            ("time", "Time spent", _time_spent(manifest)),
            ("case", "The case", _case(manifest)),
            ("cite", "How to cite", citation())]


def _warnings(warnings: Sequence[tuple[str, str]]) -> str:
    items = (f"<li>{escape(text)}{' <strong>What to do:</strong> ' * bool(remedy)}{escape(remedy)}</li>"
             for text, remedy in warnings)
    return f"<ul>{''.join(items)}</ul>" if warnings else ""


def _energy(directory: Path, ledger: Mapping[str, Any] | None) -> str:
    if ledger is None:
        return ""
    rows = [(name, value, Bar(share if value > 0 else -share)) for name, value, share in tables.budget(directory)]
    head = ("entry", f"at the last sample [{ledger['energy']}]", "of the largest")
    per = "Energies are per µm of thickness. " if ledger["energy"] == "pN" else ""
    return (f'<div class="charts" data-chart="ledger"></div>{table(head, rows)}<p class="note">{per}Hatched bars are '
            "below zero. The error is what does not add up, over the largest entry.</p>")


def _time_spent(manifest: Mapping[str, Any]) -> str:
    spent = manifest.get("sections_seconds") or {}
    seconds = {name: (max(value) if isinstance(value, list) else value) for name, value in spent.items()}
    total = sum(seconds.values())
    return table(("section", "seconds", "share [%]", ""), [
        (name, value, 100.0 * value / total, Bar(value / total)) for name, value in seconds.items()]) if total else ""


def _case(manifest: Mapping[str, Any]) -> str:
    """The resolved case as text."""
    if not manifest.get("case"):
        return ""
    file = manifest.get("case_file", "")
    text = toml(manifest["case"])
    return (f"<p>{escape(str(file))}, with all changes and defaults:</p>"
            f'<details><summary>{text.count(chr(10))} lines</summary><pre>{escape(text)}</pre></details>')


def toml(case: Mapping[str, Any], above: str = "") -> str:
    """A case as TOML; null, which TOML has not, is left out."""
    lines, inner = [], []
    for key, value in case.items():
        name = f"{above}.{key}" if above else key
        if isinstance(value, Mapping):
            inner.append(f"\n[{name}]\n{toml(value, name)}")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            inner += [f"\n[[{name}]]\n{toml(item, name)}" for item in value]
        elif value is not None:
            lines.append(f"{key} = {json.dumps(value, ensure_ascii=False)}\n")
    return "".join([*lines, *inner])
