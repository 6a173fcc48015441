"""A picture of a page by Chromium, and how fast it is there.

    python3 docs/report/screenshot.py output/all_protrude/report.html docs/report/page.png

needs the Debian packages chromium, chromium-driver and python3-selenium.
"""

import base64
import io
import sys
import time
from pathlib import Path

from PIL.Image import Quantize
from PIL.Image import open as open_image
from selenium.webdriver import Chrome
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

WIDTH, HEIGHT = 1100, 980  # pixels
COLOURS = 256  # that are kept, so that the file is small
TIMES = """
const paint = performance.getEntriesByName('first-contentful-paint')[0].startTime, begun = performance.now();
if (player) for (let k = 0; k < 10; k++) { player.frame = k % player.times.length; player.paint(); }
return [paint, (performance.now() - begun) / 10];"""

page, picture = map(Path, sys.argv[1:])
options = Options()
options.binary_location = "/usr/bin/chromium"
for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                 f"--window-size={WIDTH},{HEIGHT}"):
    options.add_argument(argument)
with Chrome(service=Service("/usr/bin/chromedriver"), options=options) as chrome:
    begun = time.perf_counter()
    chrome.get(page.resolve().as_uri())
    while not chrome.execute_script("return document.documentElement.dataset.ready"):
        time.sleep(0.01)
    ready = time.perf_counter() - begun
    time.sleep(0.5)
    shot = base64.b64decode(chrome.execute_cdp_cmd("Page.captureScreenshot", {})["data"])
    first, frame = chrome.execute_script(TIMES)
with open_image(io.BytesIO(shot)) as image:
    image.convert("RGB").quantize(COLOURS, Quantize.MAXCOVERAGE).save(picture, optimize=True)
print(f"{page}: {page.stat().st_size / 1e6:.2f} MB, first paint after {first:.0f} ms, all there after "
      f"{1e3 * ready:.0f} ms, {frame:.1f} ms a frame")
