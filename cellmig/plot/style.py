"""Style of all pictures, colours that the colour-blind can distinguish, and writing of files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellmig.output.directory import replace

STYLE = {"font.size": 8, "axes.linewidth": 0.6, "axes.spines.top": False, "axes.spines.right": False,
         "lines.linewidth": 1.2, "legend.frameon": False, "savefig.dpi": 200, "savefig.bbox": "tight"}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe and Ito
FORMATS = ("png", "pdf", "svg")
FAR = 2.0  # way of cells, over their extent at any time, beyond which pictures follow them


def in_print(unit: str) -> str:
    """A unit as pictures have it, such as µm/h for "um/h"; empty for a pure number."""
    return "" if unit == "1" else unit.replace("um", "µm").replace("us", "µs")


def legend_above(ax: Axes, columns: int = 4, height: float = 1.0) -> None:
    """Put the legend above the axes, where it covers nothing; `height` : of its lower edge, over that of the axes."""
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, height), borderaxespad=0.2, ncol=columns, columnspacing=1.2)


def save_all(figures: Mapping[str, Figure | None], out: Path) -> list[Path]:
    """Write those figures that there are, by their names, as PNG and PDF; returns the paths."""
    out.mkdir(parents=True, exist_ok=True)
    return [path for name, figure in figures.items() if figure for path in save(figure, out, name, ("png", "pdf"))]


def save(figure: Figure, out: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Write a figure in each format; returns the paths."""
    paths = [out / f"{name}.{kind}" for kind in formats]
    for path in paths:
        picture = io.BytesIO()
        figure.savefig(picture, format=path.suffix[1:])
        replace(path, picture.getvalue())
    return paths
