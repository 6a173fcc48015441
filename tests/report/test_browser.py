"""Pages as a browser shows them: Chromium opens them from the disk, plays, points, chooses, at two widths."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellmig.output.xdmf import HEAD, TAIL, frames, grids
from cellmig.report.study import write_study
from cellmig.runs.report import report

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
selenium = pytest.importorskip("selenium", reason="no selenium here: apt install python3-selenium")
pytestmark = [pytest.mark.serial, pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no browser here: apt install chromium chromium-driver")]

from selenium.webdriver import ActionChains, Chrome  # noqa: E402
from selenium.webdriver.chrome.options import Options  # noqa: E402
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.ui import Select, WebDriverWait  # noqa: E402

WIDE, NARROW = 1280, 390  # widths [pixels]
RUNS = ("all_protrude", "cap", "chemotaxis")  # flat, in space, of hours
PATIENCE = 20  # s


class Browser:
    """Chromium without a window, `width` pixels wide."""

    def __init__(self, width: int) -> None:
        options = Options()
        options.binary_location = CHROMIUM
        for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                         "--hide-scrollbars", "--window-size=1280,900"):
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        if width < 500:
            options.add_experimental_option("mobileEmulation", {
                "deviceMetrics": {"width": width, "height": 844, "pixelRatio": 2, "touch": False}})
        self.chrome = Chrome(service=Service(DRIVER), options=options)

    def open(self, address: str) -> None:
        """Open a page and wait until all of it is drawn."""
        self.chrome.get(address)
        self.until("return document.documentElement.dataset.ready === 'yes' && !!(player ? player.shownValues : true)")

    def does(self, script: str, *arguments: Any) -> Any:
        """What a script returns."""
        return self.chrome.execute_script(script, *arguments)

    def until(self, script: str) -> Any:
        """Wait until a script returns something true."""
        wait = WebDriverWait(self.chrome, PATIENCE, poll_frequency=0.02)  # half a second by default
        return wait.until(lambda chrome: chrome.execute_script(script))

    def of(self, name: str) -> Any:
        """An element by its id."""
        return self.chrome.find_element(By.ID, name)

    def press(self, *keys: str) -> None:
        """Press keys on the picture."""
        self.of("stage").send_keys(*keys)

    def settled(self) -> str:
        """The pixels of the picture as text, after it is drawn."""
        self.until("return !player.due")
        return self.does("return document.getElementById('stage').toDataURL()")

    def point(self, x: float, y: float, name: str = "stage") -> ActionChains:
        """Put the pointer on a point of an element, from its upper left corner [pixels]."""
        element = self.of(name)
        self.does("arguments[0].scrollIntoView({block: 'center'})", element)
        size = element.size
        return ActionChains(self.chrome, duration=50).move_to_element_with_offset(
            element, round(x - size["width"] / 2), round(y - size["height"] / 2))

    def errors(self) -> list[str]:
        """What the console says."""
        return [entry["message"] for entry in self.chrome.get_log("browser")]


@pytest.fixture(scope="module", params=[WIDE, NARROW])
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    """A browser of each width."""
    one = Browser(request.param)
    yield one
    one.chrome.quit()


@pytest.fixture
def page(browser: Browser, coarse: Callable[[str], Path]) -> Iterator[Callable[[str], Browser]]:
    """`page("cap")`: a browser that shows the page of a run; at the end the console has to be empty."""

    def show(name: str) -> Browser:
        browser.open(report(coarse(name)).resolve().as_uri())
        return browser

    yield show
    assert browser.errors() == []


@pytest.mark.parametrize("name", RUNS)
def test_a_page_opens_from_the_disk_with_a_picture_and_curves_and_fits_its_width(
        name: str, page: Callable[[str], Browser]) -> None:
    one = page(name)
    assert one.does("return document.documentElement.scrollWidth <= innerWidth")
    assert one.does("const g = document.getElementById('stage').getContext('2d', {willReadFrequently: true});"
                    "const p = g.getImageData(0, 0, g.canvas.width, g.canvas.height).data;"
                    "return new Set(new Uint32Array(p.buffer)).size") > 100
    assert one.does("return document.querySelectorAll('.u-wrap canvas').length") >= 5
    assert one.does("return performance.getEntriesByType('resource').length") == 0


def test_space_plays_and_arrows_step(page: Callable[[str], Browser], coarse: Callable[[str], Path]) -> None:
    one, count = page("all_protrude"), len(frames(coarse("all_protrude")))
    one.press(Keys.HOME)
    assert one.does("return player.frame") == 0
    one.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert one.does("return player.frame") == 1
    one.press(Keys.SPACE)
    assert one.until(f"return player.frame === {count - 1} && !player.playing")
    one.press(Keys.HOME, Keys.SPACE)
    assert one.until("return player.playing")
    one.press(Keys.SPACE)
    assert one.until("return !player.playing")
    one.does("const t = document.getElementById('time'); t.value = 1; t.dispatchEvent(new Event('input'))")
    one.settled()
    assert f"2 of {count}" in one.of("clock").text


def test_the_pointer_tells_the_values_of_the_particle_below_it(
        page: Callable[[str], Browser], coarse: Callable[[str], Path]) -> None:
    one, last = page("all_protrude"), frames(coarse("all_protrude"))[-1].read()
    some = int(np.argmax(last["effective_stress"] * (last["surface"] < 0)))  # inside a cell
    one.settled()
    x, y = one.does("const i = Array.from(player.ids).indexOf(arguments[0]);"
                    "return [player.on.x[i] / player.ratio, player.on.y[i] / player.ratio]", int(last["id"][some]))
    one.point(x, y).perform()
    text = one.until("const box = document.getElementById('values'); return !box.hidden && box.innerText")
    told = re.search(r"effective stress: (\S+) Pa", text)[1].replace(",", "")
    assert f"Cell-{last['cell'][some]}, particle " in text
    # A neighbour may be as near to the pixel: the value is that of the particle which is named.
    named = np.flatnonzero(last["id"] == int(re.search(r"particle (\d+)", text)[1]))[0]
    field = last["effective_stress"]
    assert float(told) == pytest.approx(field[named], abs=0.005 * np.median(field), rel=0.005)


def test_another_field_and_arrows_change_the_picture_and_its_numbers(page: Callable[[str], Browser]) -> None:
    one = page("all_protrude")
    pictures, numbers = [one.settled()], [one.of("now").text]
    Select(one.of("field")).select_by_visible_text("displacement")
    one.until("return player.name === 'displacement'")
    pictures.append(one.settled())
    numbers.append(one.of("now").text)
    Select(one.of("part")).select_by_visible_text("y")
    one.until("return player.part === 'y'")
    pictures.append(one.settled())
    numbers.append(one.of("now").text)
    Select(one.of("arrows")).select_by_visible_text("velocity")
    one.until("return player.arrowName === 'v'")
    pictures.append(one.settled())
    one.of("levels").click()
    pictures.append(one.settled())
    one.press("+", "+")
    pictures.append(one.settled())
    assert len(set(pictures)) == 6
    assert len(set(numbers)) == 3
    assert "displacement, y [µm]" in numbers[-1]


def test_a_drag_turns_a_cell_in_space_and_zero_turns_it_back(page: Callable[[str], Browser]) -> None:
    one = page("cap")
    before = one.settled()
    one.point(150, 100).click_and_hold().move_by_offset(60, 20).release().perform()
    turned = one.settled()
    one.point(150, 40).click_and_hold().move_by_offset(0, -110).release().perform()
    assert one.does("return player.view.elevation") < 0.0
    below = one.settled()
    one.of("behind").click()  # the traction
    assert len({before, turned, below, one.settled()}) == 4
    one.of("behind").click()
    one.press("0")
    assert before == one.settled()


def test_cells_that_go_far_are_followed_unless_one_wants_the_whole_way(page: Callable[[str], Browser]) -> None:
    one = page("all_protrude")
    assert not one.of("follow").is_displayed()
    one = page("crawl")
    wide, of_cell = one.does("return [player.view.high[0] - player.view.low[0], player.size[0]]")
    assert of_cell < wide < 1.2 * of_cell
    for key in (Keys.HOME, Keys.END):
        one.press(key)
        one.settled()
        places = one.does("return Array.from(player.on.x, x => x / player.ratio)")
        assert 0.0 < min(places) and max(places) < one.does("return player.view.width")
    followed = one.settled()
    one.of("follow").click()
    assert one.does("return player.view.high[0] - player.view.low[0]") > 2.0 * of_cell
    assert one.settled() != followed
    one.of("follow").click()
    assert one.settled() == followed


def test_a_field_of_the_case_stands_behind_the_cells(page: Callable[[str], Browser]) -> None:
    one = page("chemotaxis")
    before = one.settled()
    assert one.of("behind-label").text == "CXCL12 [nM]"
    one.of("behind").click()
    assert one.settled() != before


def test_a_click_on_a_curve_goes_to_its_time(page: Callable[[str], Browser]) -> None:
    one = page("all_protrude")
    one.does("document.querySelector('[data-chart=history] .u-over').id = 'over'")
    one.point(12, 60, "over").click().perform()
    assert one.until("return player.frame < 2")
    assert one.does("return document.querySelector('[data-chart=history] .u-legend .u-value').textContent") != "–"


def test_tables_sort_by_a_key_on_their_heads(page: Callable[[str], Browser]) -> None:
    one = page("all_protrude")
    head = one.chrome.find_element(By.CSS_SELECTOR, "#energy th:nth-child(2) button")
    for falling in (False, True):
        head.send_keys(Keys.ENTER)
        values = one.does("return [...document.querySelectorAll('#energy td.number')].map(cell => +cell.dataset.sort)")
        assert values == sorted(values, reverse=falling)


def test_lines_differ_in_more_than_their_colours(page: Callable[[str], Browser]) -> None:
    one = page("all_protrude")
    assert one.does("return new Set([0, 1, 2, 3].map(k => String(dashOf(k)))).size") == 4
    marks = one.does("return [...document.querySelectorAll('#history .u-legend')].map(legend => "
                     "[...legend.querySelectorAll('.u-marker')].slice(1).map(mark => mark.style.background))")
    dashes = [[re.sub(r"rgb\(.*?\)", "", mark) for mark in legend] for legend in marks]
    assert dashes and all(len(set(legend)) == len(legend) == 4 for legend in dashes)  # the mean and three cells


def test_a_page_that_is_hidden_for_a_while_is_drawn_again(page: Callable[[str], Browser]) -> None:
    """As in a part of another page that is folded: nothing has a width."""
    one = page("all_protrude")
    before = one.settled()
    for shown in ("none", ""):
        one.does("document.querySelector('main').style.display = arguments[0]", shown)
        one.does("return document.documentElement.offsetHeight")  # lays it out
        one.until("return player.canvas.clientWidth > 0 === (arguments[0] === '')".replace("arguments[0]", repr(shown)))
    one.does("player.paint()")
    assert one.settled() == before


def test_the_page_of_a_study_shows_its_runs_over_each_other(
        browser: Browser, coarse: Callable[[str], Path], tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text("name,number\nb,2\na,10\n", encoding="utf-8")
    (tmp_path / "paths.csv").write_text(f"{','.join('abcdefghij')},path\n{9 * '0.12345678,'}1,runs/bonds=4000_seed=1\n",
                                        encoding="utf-8")
    path = write_study(tmp_path, "A study", [], [], {"Rows": tmp_path / "rows.csv", "Paths": tmp_path / "paths.csv"},
                       {name: coarse(name) for name in RUNS})
    browser.open(path.as_uri())
    assert browser.does("return document.querySelectorAll('.u-wrap canvas').length") >= 3
    assert min(browser.does(
        "return [...document.querySelectorAll('#ends figure canvas')].map(one => new Set(new Uint32Array("
        "one.getContext('2d').getImageData(0, 0, one.width, one.height).data.buffer)).size)")) > 50
    captions = browser.does("return [...document.querySelectorAll('#ends figcaption')].map(one => one.textContent)")
    assert [text.split(" at ")[0] for text in captions] == list(RUNS)
    for column, order in ((1, "a10b2"), (2, "b2a10")):
        browser.chrome.find_element(By.CSS_SELECTOR, f"#rows th:nth-child({column}) button").click()
        assert browser.does("return document.querySelector('#rows tbody').textContent") == order
    assert browser.does("return document.documentElement.scrollWidth <= innerWidth")
    assert browser.does("return Math.max(...[...document.querySelectorAll('#paths td')].map(one => one.offsetHeight))"
                        ) < 100  # names are not broken letter by letter
    assert browser.errors() == []


def test_a_page_that_is_watched_renews_itself(
        browser: Browser, coarse: Callable[[str], Path], watched: Callable[[Path], Any], tmp_path: Path) -> None:
    """A frame comes; what was chosen stays, and so do focus and place, for those who read or work by keyboard."""
    run = shutil.copytree(coarse("all_protrude"), tmp_path / "run")
    index, whole = run / "cells.xdmf", (run / "cells.xdmf").read_text(encoding="utf-8")
    index.write_text(HEAD.format("cells") + "".join(grids(index)[:2]) + TAIL, encoding="utf-8")
    process, address = watched(run)
    browser.open(address)
    assert browser.does("return player.times.length") == 2
    Select(browser.of("field")).select_by_visible_text("pressure")
    browser.of("tracks").click()
    browser.until("return player.name === 'pressure' && !player.due")  # texts of another field take another height
    browser.does("document.querySelector('#case details').open = true; scrollTo(0, 1500); byId('stage').focus("
                 "{ preventScroll: true })")
    index.write_text(whole, encoding="utf-8")
    browser.until("return player && player.times.length > 2 && player.frame === player.times.length - 1")
    browser.until("return player.name === 'pressure' && document.documentElement.style.minHeight === ''")
    assert browser.does("return [document.activeElement.id, scrollY, document.querySelector('#case details').open]"
                        ) == ["stage", 1500, True]
    assert not browser.of("tracks").is_selected() and browser.does("return player.options.outlines")
    shutil.rmtree(run)
    browser.until("return byId('lead').textContent.startsWith('Files of the run are being replaced')")
    process.terminate()
    assert process.wait(20) == 0
    assert [text for text in browser.errors() if not re.search("ERR_CONNECTION_REFUSED|503", text)] == []


def test_the_mark_of_the_frame_stays_inside_its_chart(browser: Browser, coarse: Callable[[str], Path]) -> None:
    """A drag over the first part of a chart leaves the last frame beyond its axis; a double click shows all again."""
    browser.open(report(coarse("all_protrude")).as_uri())
    over = browser.chrome.find_element(By.CSS_SELECTOR, "#history .u-over")
    browser.does("arguments[0].scrollIntoView({ block: 'center' })", over)
    hidden = "return arguments[0].querySelector('.at').hidden"
    assert not browser.does(hidden, over)
    width = over.size["width"]
    ActionChains(browser.chrome).move_to_element_with_offset(over, -width // 2 + 5, 0).click_and_hold().move_by_offset(
        width // 4, 0).release().perform()
    browser.until("return document.querySelector('#history .at').hidden")
    assert browser.does("return document.documentElement.scrollWidth <= innerWidth")
    ActionChains(browser.chrome).double_click(over).perform()
    browser.until("return !document.querySelector('#history .at').hidden")
    assert browser.errors() == []


def test_long_names_without_spaces_stay_on_the_page(
        browser: Browser, coarse: Callable[[str], Path], tmp_path: Path) -> None:
    run, name = shutil.copytree(coarse("all_protrude"), tmp_path / "run"), "</script>" + 150 * "W"
    for path in (run / "manifest.json", run / "history.csv", run / "neighbours.csv"):
        path.write_text(path.read_text(encoding="utf-8").replace("Cell-1", name).replace("Three monocytes", name),
                        encoding="utf-8")
    browser.open(report(run).as_uri())
    assert browser.does("return document.querySelector('h1').textContent").startswith(name)
    assert browser.does("return document.documentElement.scrollWidth <= innerWidth")
    assert browser.errors() == []
