"""The page of a study of many runs: its figures, tables that sort, curves of all runs."""

from __future__ import annotations

import base64
import csv
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from cellmig.output.directory import replace

from . import tables
from .html import citation, picture, table, whole
from .movie import STILLS, stills

NAME = "report.html"
ROWS = 2000  # of a table, at most


def write_study(out: Path, title: str, lines: Sequence[str], figures: Iterable[Path], tables_: Mapping[str, Path],
          runs: Mapping[str, Path] | None = None) -> Path:
    """Write the page of a study; returns its path.

    Parameters
    ----------
    out : Path -- directory of the study.
    title : str -- its heading.
    lines : list of str -- what it says on the screen.
    figures : Paths -- its figures; those that are PNG are in the page.
    tables_ : dict -- its tables as CSV, by their headings.
    runs : dict -- directories of runs by name, whose last frames stand beside and whose curves lie over each other.
    """
    shown = [path for path in figures if path.suffix == ".png"]
    gallery = "".join(picture(_url(path), path.stem.replace("_", " ")) for path in shown)
    charts = [tables.compared(runs)] if runs else []
    shapes = stills(runs) if runs else None
    data = {"charts": [chart for chart in charts if chart], "stills": shapes}
    left = f'<p class="note">{len(runs) - STILLS} more runs are not shown.</p>' if runs and len(runs) > STILLS else ""
    place = "".join(f'<div class="charts" data-chart="history"></div><p class="note">{chart["left_out"]}</p>'
                    for chart in data["charts"])
    page = whole(title, escape(f"{len(runs)} runs in {out}" if runs else str(out)), [
        ("said", "What it says", f"<pre>{escape(chr(10).join(lines).strip())}</pre>" if lines else ""),
        ("ends", "How they ended", f"<div data-stills></div>{left}" if shapes else ""),
        ("curves", "Runs over each other", place),
        ("figures", "Figures", f'<div class="gallery">{gallery}</div>' if gallery else ""),
        *((path.stem, heading, _table(path, out)) for heading, path in tables_.items() if path.exists()),
        ("cite", "How to cite", citation())], data)
    replace(out / NAME, page)
    return out / NAME


def _url(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"


def _table(path: Path, out: Path) -> str:
    """A table of CSV, without columns that are empty in all rows."""
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    kept = [k for k in range(len(head)) if any(row[k] for row in rows)]
    left = f'<p class="note">{len(rows) - ROWS} more rows are in {escape(path.name)}.</p>' if len(rows) > ROWS else ""
    return table([tables.label(head[k]) for k in kept],
                 ([_value(row[k]) for k in kept] for row in rows[:ROWS])) + left


def _value(text: str) -> Any:
    try:
        return int(text) if text.lstrip("-").isdecimal() else float(text)
    except ValueError:
        return text
