"""Parts of pages as HTML, and one file of all: the style, scripts and data of a page are inside it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

from cellmig.output.manifest import plain
from cellmig.version import __version__

WEB = files(__package__) / "web"
STYLES = ("uPlot.min.css", "page.css")
# Each uses those before it.
SCRIPTS = ("uPlot.iife.min.js", "data.js", "raster.js", "view.js", "drawing.js", "player.js", "gallery.js",
           "charts.js", "tables.js", "page.js")
PAPER = ("Bai, J., Lin, L., Zeng, X. (2019). Computational Study of Collective Cell Migration By Meshfree Method. "
         "Computer Modeling in Engineering & Sciences 121(3), 787-800.", "10.32604/cmes.2019.07159")


def whole(title: str, lead: str, sections: Iterable[tuple[str, str, str]], data: Any = None) -> str:
    """A page.

    Parameters
    ----------
    title, lead : str -- heading and what is said below it.
    sections : (name, heading, HTML) of each; those without HTML are left out.
    data : for the scripts, anything that JSON can hold; numbers that are not finite become null.
    """
    shown = [section for section in sections if section[2]]
    links = "".join(f'<a href="#{name}">{escape(heading)}</a>' for name, heading, _ in shown)
    body = "\n".join(f'<section id="{name}">\n<h2>{escape(heading)}</h2>\n{html}\n</section>'
                     for name, heading, html in shown)
    text = json.dumps(plain(data), ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    return Template(part("page.html")).substitute(
        title=escape(title), lead=lead, links=links, sections=body, data=text, version=__version__,
        style="\n".join(map(part, STYLES)), licence=escape(part("uPlot.LICENSE")),
        scripts="\n".join(f"<script>\n{part(name)}\n</script>" for name in SCRIPTS))


def part(name: str) -> str:
    """The text of a file that pages consist of."""
    return (WEB / name).read_text(encoding="utf-8")


def pairs(rows: Iterable[tuple[str, Any]]) -> str:
    """Rows of key and value; an empty key continues the row above."""
    lines: list[list[str]] = []
    for key, value in rows:
        if key or not lines:
            lines.append([key, escape(str(value))])
        else:
            lines[-1][1] += "<br>" + escape(str(value))
    body = "".join(f"<tr><th scope=row>{escape(key)}</th><td>{value}</td></tr>" for key, value in lines)
    return f'<table class="pairs">{body}</table>' if lines else ""


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table that sorts by a click on the head of a column."""
    top = "".join(f"<th scope=col><button type=button>{escape(text)}</button></th>" for text in head)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    return f'<div class="wide"><table class="sorts"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(value: Any) -> str:
    if isinstance(value, Bar):
        return (f'<td data-sort="{value.share}"><div class="bar{" less" * (value.share < 0)}" '
                f'style="width:{100 * min(1.0, abs(value.share)):.1f}%"></div></td>')
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"<td>{escape('' if value is None else str(value))}</td>"
    return f'<td class="number" data-sort="{value}">{number(value)}</td>'


class Bar:
    """A bar in a table; `share` : of the width of its column, from -1 to 1."""

    def __init__(self, share: float) -> None:
        self.share = float(share)


def number(value: float) -> str:
    """A number with four digits, and without a power of ten where it is not needed."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞" if value > 0 else "−∞"
    if isinstance(value, int):
        return str(value)
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def picture(source: str, title: str, text: str = "") -> str:
    """A picture of a gallery; `source` : its data as URL."""
    return (f'<figure><a href="{source}" target="_blank"><img src="{source}" alt="{escape(title)}"></a>'
            f"<figcaption>{escape(title)}{' – ' * bool(text)}{escape(text)}</figcaption></figure>")


def citation() -> str:
    """How to cite the program and the paper."""
    text, doi = PAPER
    return (f"<p>Please cite the software, cellmig {__version__}, and the paper whose model it computes:</p>"
            f'<blockquote>{escape(text)} <a href="https://doi.org/{doi}">doi:{doi}</a></blockquote>'
            "<p>Laws have sources of their own: <code>cellmig schema --markdown</code> lists them.</p>")
