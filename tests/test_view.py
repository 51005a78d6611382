"""The live page in Chromium: it follows the simulated arm, shows a killed driver in time, and no old pose as fresh."""

from __future__ import annotations

import math
import shutil
import signal
import time
from pathlib import Path

import pytest
from environment import THIS
from make_screenshots import BROWSER, KILLED, opened_page, running_arm, wait_for_banner
from posor_bringup.view_page import GREEN, GREY, RED

pytestmark = [
    pytest.mark.usefixtures("ros_domain"),
    pytest.mark.skipif(shutil.which(BROWSER) is None, reason=f"the program '{BROWSER}' is not installed"),
]
WIDTH, HEIGHT = 800, 400
ARTIFACTS = THIS.root / "build" / "test_view"
MAX_RED_S = 1.0  # of a quiet machine; the short test, which may run on a busy one, only prints the time
MOVED_MM = 1.0
PICTURE = "canvas[data-engine]"
STATE = f"#joint-{KILLED} td:nth-child(2)"
HAS_COLOUR = "([selector, colour]) => getComputedStyle(document.querySelector(selector)).color === colour"
X = "parseFloat(document.querySelector('#endpoint tr:nth-child(2) td:nth-child(2)')?.innerText)"
HAS_X, HAS_MOVED = f"() => {X} > 0 && {X}", f"([x, moved]) => Math.abs({X} - x) > moved"


@pytest.mark.timeout(300)
@pytest.mark.parametrize("max_red_s", [math.inf, pytest.param(MAX_RED_S, marks=pytest.mark.long)])
def test_the_page_follows_the_arm_and_a_killed_driver_turns_its_joint_red(tmp_path: Path, max_red_s: float) -> None:
    with running_arm(tmp_path) as arm, opened_page(arm.path, WIDTH, HEIGHT) as (page, view):
        page.set_default_timeout(60_000)
        x = page.wait_for_function(HAS_X, polling=50).json_value()  # a later x may be that of no pose
        picture = page.locator(PICTURE)
        drawn = picture.screenshot()
        page.wait_for_function(HAS_MOVED, arg=[x, MOVED_MM], polling=50)
        assert picture.screenshot() != drawn

        picture.evaluate("picture => picture.style.display = 'none'")  # the processor draws it, too slowly
        page.wait_for_function(HAS_COLOUR, arg=[STATE, _css(GREEN)], polling=20)

        arm.driver.process.kill()
        killed_s = time.monotonic()
        page.wait_for_function(HAS_COLOUR, arg=[STATE, _css(RED)], polling=20)
        red_s = time.monotonic() - killed_s
        print(f"red after {red_s:.2f} s")
        assert red_s < max_red_s
        wait_for_banner(page, f"{KILLED}: transform missing")
        picture.evaluate("picture => picture.style.display = 'block'")
        page.screenshot(path=ARTIFACTS / "killed_driver.png")

        arm.nodes.process.kill()
        wait_for_banner(page, "no message on /five_axis_checked/endpoint/state")
        page.wait_for_function(HAS_COLOUR, arg=[STATE, _css(GREY)], polling=20)
        assert page.inner_text(STATE) == "STALE"
        assert not page.evaluate(HAS_X)
        assert view.end(signal.SIGTERM) == 0


def _css(colour: tuple[int, int, int]) -> str:
    return f"rgb{colour}"
