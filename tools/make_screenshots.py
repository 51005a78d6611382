"""Makes the pictures of the README and of the live page in docs/images from pages in Chromium.

``tools/in_workspace.py tools/make_screenshots.py [PICTURE...]`` makes all of them, or those named: ``ymo_printed`` and
``five_axis`` (plots of the pages that ``demo`` and ``arm`` write), ``view`` (the simulated five-axis arm, sound and
with a killed driver; prints the processor time of ``view``, too), ``statement`` (page and PDF of ``posor statement``).
The tests use its parts.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from environment import THIS, exit_with
from playwright.sync_api import sync_playwright
from posor.errors import PosorError
from posor.reporting.program_errors import reports_errors
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.statement_command import compute_statement, parse_options
from posor_design.statement_report import render_sheet, render_statement_page
from posor_lab.faults.fault_table import write_fault_arm
from posor_lab.harness.program import Program, installed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from playwright.sync_api import Page

BROWSER = "chromium"
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Drawing by the processor: a test machine has no graphics card."""
KILLED = "elbow"
CYCLE_S, SEED = 60, 4
CHARTS_S = 20.0
"""Time to fill the charts."""
REST_S = 10.0
"""Time without a page over which the processor time is measured."""
BANNER_SAYS = "text => document.querySelector('#banner')?.innerText.includes(text)"
IMAGES = THIS.root / "docs" / "images"
CONTROLLER = THIS.root / "examples" / "endpoint_controller" / "endpoint_controller.py"
REPORTS = {
    "ymo_printed": (
        ("demo", "--rate", "0"),
        "ymo_printed/report.html",
        ("alpha,", "beta,", "theta,", "alpha:", "beta:", "theta:"),
    ),
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
def opened_browser(width: int, height: int, scale: float = 1.0) -> Iterator[Page]:
    """Open an empty page in Chromium for a ``with`` block; size in CSS pixels, ``scale``: pixels of each.

    Raises:
        PosorError: Chromium is not installed.

    """
    browser_path = shutil.which(BROWSER)
    if browser_path is None:
        raise PosorError("there is no such program", where=BROWSER, expected="the package chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=ARGUMENTS)
        try:
            yield browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
        finally:
            browser.close()


@contextmanager
def opened_page(arm: Path, width: int, height: int) -> Iterator[tuple[Page, Program]]:
    """Run ``view`` and open its page in Chromium for a ``with`` block.

    Raises:
        PosorError: Chromium is not installed.

    """
    command = [sys.executable, "-m", "posor_bringup.view_command", str(arm), "--port", "0"]
    with Program(command) as view, opened_browser(width, height) as page:
        page.goto(next(word for word in view.wait_for_line("page at").split() if word.startswith("http")).rstrip(";"))
        yield page, view


def wait_for_banner(page: Page, text: str) -> None:
    """Wait until the banner of the page contains a text."""
    page.wait_for_function(BANNER_SAYS, arg=text, polling=50, timeout=60_000)


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


def _draw_view() -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        running_arm(Path(folder)) as arm,
        opened_page(arm.path, 1280, 1100) as (page, view),
    ):
        wait_for_banner(page, ": OK")
        page.locator(".mantine-Notification-closeButton").dispatch_event("click")  # "software rendering"
        print(f"view while it is shown: {processor_share(view.process.pid, CHARTS_S):.1f} % of a core")
        wait_for_banner(page, ": OK")
        page.screenshot(path=IMAGES / "view_five_axis.png", timeout=60_000)
        arm.driver.process.kill()
        wait_for_banner(page, ": LOST")
        time.sleep(1.0)
        page.screenshot(path=IMAGES / "view_fault.png", timeout=60_000)
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


OTHER_PICTURES = {"view": _draw_view, "statement": _draw_statement}


@reports_errors
def main() -> int:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument(
        "pictures",
        nargs="*",
        choices=[*REPORTS, *OTHER_PICTURES],
        default=[*REPORTS, *OTHER_PICTURES],
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
