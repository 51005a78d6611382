# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Makes the pictures of the README and of the live page in docs/images from pages in Chromium.

``tools/in_workspace.py tools/make_screenshots.py [PICTURE...]`` makes all of them, or those named: ``ymo_printed``,
``ymo_section84`` and ``five_axis`` (plots of the pages that ``demo`` and ``arm`` write), ``view`` (the live page of a
recording, sound and with a lost joint; prints the processor time of ``view`` with a running arm, too), ``statement``
(page and PDF of ``posor statement``), ``states`` (the live page in eight states, into ``build/view_states``). The tests
use its parts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from environment import THIS, exit_with
from posor.errors import PosorError
from posor.reporting.program_errors import reports_errors
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.statement_command import compute_statement, parse_options
from posor_bringup.view_command import draw_observation
from posor_bringup.view_events import Cause
from posor_bringup.view_geometry import ArmGeometry
from posor_bringup.view_messages import BagTopics
from posor_bringup.view_observation import Observation, Observer
from posor_bringup.view_page import ViewPage
from posor_bringup.view_record import WINDOWS_S, ArmRecord
from posor_design.statement_report import render_sheet, render_statement_page
from posor_lab.faults.fault_table import write_fault_arm
from posor_lab.harness.browser import opened_browser
from posor_lab.harness.program import Program, installed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from playwright.sync_api import Page

KILLED = "elbow"
CYCLE_S, SEED = 60, 4
CHARTS_S = 20.0
"""Time to fill the charts."""
REST_S = 10.0
"""Time without a page over which the processor time is measured."""
BANNER_SAYS = "text => document.querySelector('#banner')?.innerText.includes(text)"
STATES_BAG = THIS.root / "bags" / "five_axis_checked"
POSITIONS_S = {"sound": 1.5, "one_joint_lost": 2.75, "unknown_pose": 5.75, "one_cause_on_five_joints": 9.25}
"""States of the arm, and where they are in the shipped bag [s]."""
NIGHT_NS = 1_767_297_600_000_000_000  # 2026-01-01 20:00:00 UTC
STATES_SIZE = (1280, 1100)
DRAWN_MS = 1500.0  # time in which the processor draws the arm
IMAGES = THIS.root / "docs" / "images"
CONTROLLER = THIS.root / "examples" / "endpoint_controller" / "endpoint_controller.py"
ANGLES = ("alpha,", "beta,", "theta,", "alpha:", "beta:", "theta:")
REPORTS = {
    "ymo_printed": (("demo", "--rate", "0"), "ymo_printed/report.html", ANGLES),
    "ymo_section84": (("demo", "--calibration", "section84", "--rate", "0"), "ymo_section84/report.html", ANGLES),
    "five_axis": (
        ("arm", "--controller", str(CONTROLLER)),
        "report.html",
        ("Position error", "True endpoint", "Path from the side", "Distribution", "1000 arms", "Sag"),
    ),
}
"""Pictures of reports: program, its page below the output folder, and the beginnings of the titles of the plots."""
STATEMENT = ("six_axis", "--grid", "4", "--temperature-deviation", "0.5")
REPORT_SIZE = (1280, 800)
REPORT_SCALE = 1.4
KEEP_PLOTS = """titles => {
    const grid = document.createElement('div');
    grid.className = 'plots';
    grid.style.gridTemplateColumns = 'repeat(3, 1fr)';
    const figures = [...document.querySelectorAll('figure')];
    for (const title of titles)
        grid.append(...figures.filter(each => each.querySelector('h3').innerText.startsWith(title)));
    document.body.replaceChildren(document.querySelector('h1'), grid);
    document.querySelectorAll('figcaption').forEach(each => each.remove());
    document.body.style.margin = '0.6rem';
}"""
"""Reduces a report page to its heading and the plots with these titles, in this order."""


class SimulatedArm:
    """The simulated five-axis arm at 50 Hz; one driver is a process of its own, all other nodes share another one.

    Attributes:
        path: The arm file.
        nodes: All nodes but the driver of ``KILLED``.
        driver: That driver.

    """

    def __init__(self, path: Path, nodes: Program, driver: Program) -> None:
        self.path, self.nodes, self.driver = path, nodes, driver


@contextmanager
def running_arm(folder: Path) -> Iterator[SimulatedArm]:
    """Run the arm for a ``with`` block; its files are in a folder that exists."""
    arm = write_fault_arm("five_axis_checked", folder / "arm", CYCLE_S, SEED)
    programs = arm_programs(arm)
    (driver,) = (program for program in programs if program.name == f"{KILLED}/driver_node")
    (others,) = group_programs([program for program in programs if program is not driver], "composed", folder)
    with Program(others.command()) as nodes, Program(driver.command()) as killed:
        yield SimulatedArm(arm.path, nodes, killed)


@contextmanager
def opened_page(arm: str, width: int, height: int, *options: str) -> Iterator[tuple[Page, Program]]:
    """Run ``view`` with further options and open its page in Chromium for a ``with`` block.

    Raises:
        PosorError: Chromium is not installed.

    """
    command = [*installed("posor_bringup", "view"), arm, "--port", "0", *options]
    with Program(command) as view, opened_browser(width, height) as page:
        page.goto(next(word for word in view.wait_for_line("page at").split() if word.startswith("http")).rstrip(";"))
        yield page, view


def wait_for_banner(page: Page, text: str) -> None:
    """Wait until the banner of the page contains a text."""
    page.wait_for_function(BANNER_SAYS, arg=text, polling=50)


def close_notice(page: Page) -> None:
    """Close the notice "software rendering", if it is there."""
    for notice in page.locator(".mantine-Notification-closeButton").all():
        notice.dispatch_event("click")


def seek(page: Page, position_s: float) -> None:
    """Stop a replay, and move it to a position [s]."""
    play = page.get_by_label("play")
    while play.is_checked():  # a replay that ends meanwhile stops itself
        play.dispatch_event("click")
        page.wait_for_timeout(300.0)
    number = page.locator("input.mantine-NumberInput-input").first
    while float(number.input_value()) != position_s:  # the replay may have set another one meanwhile
        number.fill(f"{position_s:.2f}")
        number.press("Enter")
        page.wait_for_timeout(300.0)


def select_window(page: Page, window: str) -> None:
    """Select the time that the charts show."""
    page.get_by_label("time shown").click()
    page.get_by_role("option", name=window, exact=True).click()


class CompressedTime:
    """The live page of an arm, which gets hours of observations at once; they come from the shipped bag.

    Attributes:
        page: The page.

    """

    def __init__(self, folder: Path) -> None:
        """Serve the page; ``folder`` exists."""
        arm = load_checked_arm(STATES_BAG.name)
        self._geometry = ArmGeometry(arm)
        bag = BagTopics(STATES_BAG, arm, folder)
        observer = Observer(bag.topics, bag.store, self._geometry.joints, arm)
        self._seen = {}
        for state, position_s in POSITIONS_S.items():
            bag.seek(position_s)
            self._seen[state] = observer.observe(position_s, bag.begin_ns)
        self.record = ArmRecord(self._geometry.joints, tuple(WINDOWS_S.values()))
        self.page = ViewPage(arm.name, self._geometry, 0, self.record)
        self._time_ns = NIGHT_NS

    def pass_time(self, state: str, seconds: float, period_s: float = 1.0) -> None:
        """Observe a state of the arm for some time; ``silent``: no message comes."""
        last = self._observation("sound").endpoint
        for _ in range(round(seconds / period_s)):
            self._time_ns += round(period_s * 1e9)
            if state == "silent":
                causes = (Cause("STALE", "no message on endpoint/state"),)
                seen = Observation(self._time_ns, is_fresh=False, state="STALE", causes=causes, endpoint=last)
            else:
                seen = self._observation(state)
            self.record.add(seen, draw_observation(self._geometry, seen))

    def show(self, state: str) -> None:
        """Draw a state of the arm at the present time."""
        seen = self._observation(state)
        self.page.update(seen, draw_observation(self._geometry, seen))

    def _observation(self, state: str) -> Observation:
        seen = self._seen[state]
        if seen.endpoint is None:
            raise PosorError("there is no endpoint", where=str(STATES_BAG), expected="the bag of make_view_bag.py")
        endpoint = replace(seen.endpoint, stamp_ns=self._time_ns, received_ns=self._time_ns)
        return replace(seen, time_ns=self._time_ns, endpoint=endpoint)


def processor_share(pid: int, seconds: float) -> float:
    """Return the processor time that a process uses during some seconds from now on, in percent of a core."""

    def used_s() -> float:
        user, system = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    begin_s, begun_s = used_s(), time.monotonic()
    time.sleep(seconds)
    return 100.0 * (used_s() - begin_s) / (time.monotonic() - begun_s)


def draw_report(page_file: Path, titles: Sequence[str], picture: Path) -> None:
    """Write a picture (PNG) of some plots of a report page, whose titles begin with ``titles``."""
    with opened_browser(*REPORT_SIZE, REPORT_SCALE) as page:
        page.goto(page_file.resolve().as_uri())
        page.wait_for_function("() => Bokeh.documents.length && Bokeh.documents.every(each => each.is_idle)")
        page.evaluate(KEEP_PLOTS, list(titles))
        page.wait_for_timeout(1000.0)  # the plots are drawn again in their new width
        page.screenshot(path=picture, full_page=True)


def draw_states(folder: Path) -> None:
    """Write pictures of the live page in eight states into a folder, which is made if necessary."""
    folder.mkdir(parents=True, exist_ok=True)

    def save(page: Page, state: str) -> None:
        close_notice(page)
        page.wait_for_timeout(DRAWN_MS)
        page.screenshot(path=folder / f"{state}.png")

    with opened_page(STATES_BAG.name, *STATES_SIZE, "--bag", str(STATES_BAG)) as (page, _):
        page.wait_for_selector("#charts")
        for state, position_s in POSITIONS_S.items():
            seek(page, position_s)
            save(page, state)
    with tempfile.TemporaryDirectory() as name, opened_browser(*STATES_SIZE) as page:
        past = CompressedTime(Path(name))
        past.pass_time("sound", 1500.0)
        past.pass_time("one_joint_lost", 90.0)
        past.pass_time("sound", 900.0)
        past.pass_time("silent", 300.0)
        past.pass_time("sound", 1200.0)
        past.show("sound")
        page.goto(past.page.address)
        select_window(page, "1 h")
        past.show("sound")
        save(page, "after_an_hour")
        for _ in range(4):
            past.pass_time("sound", 7000.0, 2.0)
            past.pass_time("unknown_pose", 60.0)
            past.pass_time("one_cause_on_five_joints", 240.0)
        past.pass_time("sound", 7200.0, 2.0)
        select_window(page, "12 h")
        past.show("sound")
        save(page, "after_a_night")
        past.page.close()
    with (
        tempfile.TemporaryDirectory() as name,
        running_arm(Path(name)) as arm,
        opened_page(str(arm.path), *STATES_SIZE) as (page, _),
    ):
        wait_for_banner(page, ": OK")
        time.sleep(CHARTS_S)
        arm.driver.process.kill()
        wait_for_banner(page, ": LOST")
        time.sleep(4.0)
        save(page, "driver_killed")
        arm.nodes.process.kill()
        wait_for_banner(page, ": STALE")
        time.sleep(3.0)
        save(page, "stale")
    print(f"states of the live page: {folder}")


def _draw_view() -> None:
    pictures = {"sound": "view_five_axis.png", "one_joint_lost": "view_fault.png"}
    with opened_page(STATES_BAG.name, *STATES_SIZE, "--bag", str(STATES_BAG)) as (page, _):
        page.wait_for_selector("#charts")
        for state, name in pictures.items():
            seek(page, POSITIONS_S[state])
            close_notice(page)
            page.wait_for_timeout(DRAWN_MS)
            page.screenshot(path=IMAGES / name)
    with (
        tempfile.TemporaryDirectory() as folder,
        running_arm(Path(folder)) as arm,
        opened_page(str(arm.path), *STATES_SIZE) as (page, view),
    ):
        wait_for_banner(page, "scan of")
        print(f"view while it is shown: {processor_share(view.process.pid, CHARTS_S):.1f} % of a core")
        page.goto("about:blank")
        print(f"view at rest: {processor_share(view.process.pid, REST_S):.1f} % of a core")


def _draw_statement() -> None:
    statement = compute_statement(parse_options(STATEMENT))
    with tempfile.TemporaryDirectory() as folder, opened_browser(1000, 1250) as page:
        page_file = Path(folder, "statement.html")
        page_file.write_text(render_statement_page(statement), encoding="utf-8")
        page.goto(page_file.as_uri())
        page.screenshot(path=IMAGES / "statement_page.png")
    (IMAGES / "statement_sheet.png").write_bytes(render_sheet(statement, "png")[0])


OTHER_PICTURES: dict[str, Callable[[], object]] = {
    "view": _draw_view,
    "statement": _draw_statement,
    "states": partial(draw_states, THIS.root / "build" / "view_states"),
}


@reports_errors
def main() -> int:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument(
        "pictures",
        nargs="*",
        choices=[*REPORTS, *OTHER_PICTURES],
        default=[*REPORTS, *(name for name in OTHER_PICTURES if name != "states")],
        metavar="PICTURE",
    )
    for name in parser.parse_args().pictures:
        if name in OTHER_PICTURES:
            OTHER_PICTURES[name]()
            continue
        (program, *options), page_name, titles = REPORTS[name]
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder, "report")
            subprocess.run([*installed("posor_lab", program), *options, "--output", str(output)], check=True)
            draw_report(output / page_name, titles, IMAGES / f"{name}.png")
    print(f"written to {IMAGES}")
    return 0


if __name__ == "__main__":
    exit_with("make_screenshots", main)
