"""A browser opens the page of a run: its slider scrubs through t_n, the mouse turns the cup.

Needs selenium (``pip install selenium``) and Chromium with its driver; or a driver that runs
elsewhere on this machine, whose address OPTICCUP_WEBDRIVER names (``chromedriver --port=9515``,
``http://127.0.0.1:9515``).
"""

import io
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from opticcup_fem.plots.view import view
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import deformed, sphere_mesh, sphere_points
from tests.unit.test_movie import made_run, slit

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")

DRIVER = os.environ.get("OPTICCUP_WEBDRIVER")
PATIENCE = 300.0
"""Seconds to wait for a browser that draws in software."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (DRIVER or (shutil.which("chromedriver") and shutil.which("chromium"))),
        reason="neither chromium and chromedriver nor OPTICCUP_WEBDRIVER is there",
    ),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a sphere that grows and snaps into a slit."""
    sphere: Snapshot = sphere_mesh(0.4)
    grown = deformed(sphere, lambda t, p: 1.2 * sphere_points(t, p), t_n=0.5)
    buckled = deformed(sphere, slit, t_n=0.51)
    folder = tmp_path_factory.mktemp("run")
    return view(made_run(folder, [sphere, grown, buckled]))


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    """Return a browser without a window, on a profile of its own."""
    options = webdriver.ChromeOptions()
    for argument in ("--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,800"):
        options.add_argument(argument)
    options.add_argument("--enable-unsafe-swiftshader")  # WebGL without a graphics card
    options.add_argument(f"--user-data-dir={tmp_path / 'profile'}")
    if DRIVER:
        chrome = webdriver.Remote(DRIVER, options=options)
    else:
        chrome = webdriver.Chrome(options=options)
    chrome.set_page_load_timeout(PATIENCE)
    yield chrome
    chrome.quit()


class Page:
    """What a user sees of the page and does with it."""

    def __init__(self, browser: Any, path: Path) -> None:
        """Open it and wait for the cup."""
        self.browser = browser
        browser.get(path.as_uri())
        self.wait(lambda: self.ask("return g._fullLayout && !!g._fullLayout.scene._scene"))

    def ask(self, script: str) -> Any:
        """Return what a script says of the figure ``g``."""
        return self.browser.execute_script(
            f"var g = document.querySelector('.plotly-graph-div'); {script}"
        )

    @staticmethod
    def wait(happens: Any) -> None:
        """Wait until something happens."""
        end = time.monotonic() + PATIENCE
        while not happens():
            assert time.monotonic() < end, "the page does not answer"
            time.sleep(0.2)

    def cup(self) -> np.ndarray:
        """Return the pixels of the left half, where the cup is, once they keep still."""
        last = np.zeros(0)
        while True:
            png = io.BytesIO(self.browser.get_screenshot_as_png())
            pixels = matplotlib.image.imread(png)[..., :3]
            half = pixels[60:540, : pixels.shape[1] // 2]
            if last.shape == half.shape and np.array_equal(last, half):
                return half
            last = half
            time.sleep(1.0)

    @property
    def title(self) -> str:
        """Title of the figure."""
        return str(self.ask("return g._fullLayout.title.text"))

    def scrub(self, share: float) -> None:
        """Click on the slider at a share of its length."""
        rail = self.browser.find_element("css selector", ".slider-rail-touch-rect")
        offset = round((share - 0.5) * (rail.rect["width"] - 6))
        chain = webdriver.ActionChains(self.browser)
        chain.move_to_element_with_offset(rail, offset, 0).click().perform()

    def drag(self, right: int, down: int) -> None:
        """Drag the mouse over the cup."""
        figure = self.browser.find_element("css selector", ".plotly-graph-div")
        chain = webdriver.ActionChains(self.browser)
        chain.move_to_element_with_offset(figure, -figure.rect["width"] // 5, -60)
        chain.click_and_hold().move_by_offset(right, down).release().perform()


def colourful(pixels: np.ndarray) -> float:
    """Return the share of pixels that are neither white nor grey."""
    return float((np.ptp(pixels, axis=-1) > 0.15).mean())


def test_slider_and_mouse(browser: Any, page: Path) -> None:
    shown = Page(browser, page)
    assert "= 0.0000" in shown.title
    first = shown.cup()
    assert 0.02 < colourful(first) < 0.9
    shown.scrub(1.0)
    shown.wait(lambda: "= 0.5100" in shown.title)
    assert "after a jump" in shown.title
    last = shown.cup()
    assert (np.abs(last - first).max(axis=-1) > 0.1).mean() > 0.01
    shown.scrub(0.0)
    shown.wait(lambda: "= 0.0000" in shown.title)
    np.testing.assert_array_equal(shown.cup(), first)

    def eye() -> np.ndarray:
        camera = shown.ask("return g._fullLayout.scene._scene.getCamera().eye")
        return np.array([camera[axis] for axis in "xyz"])

    before = eye()
    shown.drag(120, -60)
    shown.wait(lambda: np.abs(eye() - before).max() > 0.2)
    turned = shown.cup()
    assert (np.abs(turned - first).max(axis=-1) > 0.1).mean() > 0.01
    after = eye()
    shown.scrub(1.0)  # the view stays where it was turned to
    shown.wait(lambda: "= 0.5100" in shown.title)
    np.testing.assert_allclose(eye(), after, atol=1e-6)
