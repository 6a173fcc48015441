"""The gallery: its pictures, and the page that shows each with the commands that make it.

.venv/bin/python docs/gallery.py            # everything, minutes
.venv/bin/python docs/gallery.py colony     # the picture of this case, and the page
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from PIL.Image import open as read_image

from cellmig.case.shipped import copy, names

PAGE = Path(__file__).with_suffix(".md")
PICTURES = PAGE.with_suffix("")
LARGEST, COLOURS = (1000, 760), 256  # of a picture [pixels], and in its palette


class Picture(NamedTuple):
    """A run, what is drawn of it, and what a reader sees."""

    case: str
    options: str  # of the run
    times: str
    drawn: str  # name of the picture that `plot` writes
    seen: str

    def commands(self) -> list[str]:
        """The commands that make the picture, from a folder with `cases/`."""
        return [" ".join(f"./run cases/{self.case}.toml {self.options}".split()),
                f'./run plot output/{self.case} --times "{self.times}"']


GALLERY = (
    Picture("one_cell", '--set particles.per_cell=600 --until "100 us"', "0 us,20 us,100 us", "shapes",
            "A round cell spreads on the bonds of its substrate; its nucleus, in white, is stiffer than the rest."),
    Picture("microscope", '--set particles.per_cell=600 --until "60 us"', "0 us,20 us,60 us", "shapes",
            "A cell and its nucleus, traced in a picture in pixels: two CSV files are its shape."),
    Picture("colony", '--set particles.per_cell=200 --until "80 us"', "0 us,40 us,80 us", "shapes",
            "Two kinds of cells, in turn side by side, adhere more to their own kind."),
    Picture("tissue", "", "200 us", "graph",
            "Sixty cells from the CSV file of a segmented picture, from above: lines are contacts, as wide as these "
            "are long, coloured by pull."),
    Picture("strip_with_hole", "", "1 us", "shapes",
            "A strip of the nucleus's law between grips, in equilibrium, with the largest stress beside its hole."),
    Picture("three_balls", '--set particles.per_cell=600 --until "40 us"', "0 us,40 us", "section",
            "Three cells in space push forward; a section through their middle."),
    Picture("contact_inhibition", "--set particles.per_cell=150", "0 min,20 min,60 min", "kymograph",
            "Two cells are sent towards each other, touch, turn away, and part: velocity, traction and tension by "
            "place and time, over an hour."),
    Picture("chemotaxis", "--set particles.per_cell=150", "0 h,4 h", "tracks",
            "A cell that compares the receptors on its two sides wanders up a gradient."),
    Picture("self_generated", '--set particles.per_cell=100 --until "2 h"', "0 h,1 h,2 h", "shapes",
            "Three cells take up what attracts them, and the first follows the gradient that they make."),
    Picture("slab", "", "0 min,20 min", "shapes",
            "A cell that is pulled along an elastic gel moves another through the gel."))


def make(picture: Picture, folder: Path) -> None:
    """Run and draw in a folder with `cases/`, and keep the picture, small."""
    begin = time.monotonic()
    for command in picture.commands():
        words = [sys.executable, "-m", "cellmig", *shlex.split(command)[1:]]
        subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, check=True)
    with read_image(folder / "output" / picture.case / f"{picture.drawn}.png") as image:
        small = image.convert("RGB")
    small.thumbnail(LARGEST)
    PICTURES.mkdir(exist_ok=True)
    small.quantize(COLOURS).save(PICTURES / f"{picture.case}.png", optimize=True)
    print(f"{picture.case}: {time.monotonic() - begin:.0f} s", flush=True)


def page() -> str:
    """The page of the gallery."""
    parts = ["# Gallery\n", "What do runs look like, and which commands make these pictures? Cells are coarse here, so "
             "that each takes less than two\nminutes. `.venv/bin/python docs/gallery.py` makes all of them, and this "
             "page.\n"]
    for picture in GALLERY:
        commands = "\n".join(picture.commands())
        parts += [f"## `{picture.case}`\n", f"{picture.seen}\n", f"![{picture.seen}](gallery/{picture.case}.png)\n",
                  f"```bash\n{commands}\n```\n"]
    return "\n".join(parts)


if __name__ == "__main__":
    chosen = [picture for picture in GALLERY if len(sys.argv) < 2 or picture.case in sys.argv[1:]]
    with tempfile.TemporaryDirectory() as place:
        copy(names(), Path(place) / "cases")
        for one in chosen:
            make(one, Path(place))
    PAGE.write_text(page(), encoding="utf-8")
