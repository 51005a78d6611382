# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live page in Chromium: what is wrong, since when and where, in eight states; no old pose looks fresh."""

from __future__ import annotations

import csv
import math
import re
import shutil
import signal
import socket
import time
from http import HTTPStatus
from pathlib import Path
from urllib.request import urlopen

import pytest
import viser
from environment import THIS
from make_screenshots import (
    KILLED,
    POSITIONS_S,
    STATES_BAG,
    CompressedTime,
    opened_page,
    running_arm,
    seek,
    select_window,
    wait_for_banner,
)
from playwright.sync_api import Page
from posor_bringup.view_page import HOST
from posor_bringup.view_texts import GREEN, RED
from posor_lab.harness.browser import BROWSER, opened_browser
from posor_lab.harness.program import Program, installed

pytestmark = [
    pytest.mark.usefixtures("ros_domain"),
    pytest.mark.skipif(shutil.which(BROWSER) is None, reason=f"the program '{BROWSER}' is not installed"),
]
WIDTH, HEIGHT = 800, 400
ARTIFACTS = THIS.root / "build" / "test_view"
MAX_RED_S = 1.0  # of a quiet machine; the short test, which may run on a busy one, only prints the time
MOVED_MM = 1.0
PICTURE = "canvas[data-engine]"
STATE = f"#joint-{KILLED} b"
HAS_COLOUR = "([selector, colour]) => getComputedStyle(document.querySelector(selector)).color === colour"
SAYS = "([selector, text]) => document.querySelector(selector)?.innerText === text"
X = "parseFloat(document.querySelector('#endpoint tr:nth-child(2) td:nth-child(2)')?.innerText)"
HAS_X, HAS_NO_X, HAS_MOVED = f"() => {X} > 0 && {X}", f"() => !({X} > 0)", f"([x, moved]) => Math.abs({X} - x) > moved"


@pytest.mark.parametrize("max_red_s", [math.inf, pytest.param(MAX_RED_S, marks=pytest.mark.long)])
def test_the_page_follows_the_arm_and_a_killed_driver_turns_its_joint_red(tmp_path: Path, max_red_s: float) -> None:
    with running_arm(tmp_path) as arm, opened_page(str(arm.path), WIDTH, HEIGHT) as (page, view):
        x = page.wait_for_function(HAS_X, polling=50).json_value()  # a later x may be that of no pose
        picture, notice = page.locator(PICTURE), page.locator("#no-update")
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
        picture.evaluate("picture => picture.style.display = 'none'")

        arm.nodes.process.kill()
        wait_for_banner(page, "no message on /five_axis_checked/endpoint/state")
        wait_for_banner(page, ": STALE no pose since")
        page.wait_for_function(SAYS, arg=[STATE, "STALE"], polling=50)  # the page changes element by element
        page.wait_for_function(HAS_NO_X, polling=50)
        notice.wait_for(state="attached")
        notice.wait_for(state="hidden")
        view.process.send_signal(signal.SIGSTOP)
        try:
            notice.wait_for(state="visible")
            assert notice.bounding_box() == {"x": 0, "y": 0, "width": WIDTH, "height": HEIGHT}
            page.screenshot(path=ARTIFACTS / "no_update.png")
        finally:
            view.process.send_signal(signal.SIGCONT)
        notice.wait_for(state="hidden")
        assert view.end(signal.SIGTERM) == 0


JOINTS = "base_swivel, shoulder, elbow, wrist_roll, wrist_yaw"
SHOWN = {  # texts of the banner, and of the lines of causes: state, joints and what is wrong, since when
    "sound": (("OK since 00:00:00 UTC", "The endpoint is at x ", " mm in base, to within U = ", "5 of 5 joints"), []),
    "one_joint_lost": (
        ("LOST no pose since 00:00:02 UTC (0.8 s)", "The endpoint is not known: elbow: a reading is missing"),
        [("LOST", "elbow a reading is missing or invalid (BAD_READING)", "00:00:02")],
    ),
    "unknown_pose": (
        ("UNCOUNTED no pose since 00:00:02 UTC (3.8 s)", "The endpoint is not known: elbow: waiting for the home mark"),
        [("UNCOUNTED", "elbow waiting for the home mark or another reference", "00:00:03")],
    ),
    "one_cause_on_five_joints": (
        ("LOST no pose since 00:00:02 UTC", f"The endpoint is not known: {JOINTS}: supply or temperature out of range"),
        [("LOST", f"{JOINTS} supply or temperature out of range or not measured (ENVIRONMENT)", "00:00:08")],
    ),
}
CELLS = "rows => rows.map(row => [...row.children].map(cell => cell.innerText.trim()))"
OVERLAPS = """() => {
    const bar = document.querySelector('.mantine-ScrollArea-scrollbar[data-orientation="vertical"]');
    const right = bar ? bar.getBoundingClientRect().left : document.documentElement.clientWidth;
    return [...document.querySelectorAll('#banner, #causes td, #joints span, #charts text, #events td, #endpoint td')]
        .filter(each => each.getBoundingClientRect().right > right).map(each => each.textContent);
}"""
"""Texts that reach under the scroll bar."""


def test_replay_says_what_is_wrong_where_and_since_when_on_the_time_axis_of_the_bag() -> None:
    with opened_page(STATES_BAG.name, 1200, 700, "--bag", str(STATES_BAG)) as (page, view):
        wait_for_banner(page, STATES_BAG.name)
        page.locator(PICTURE).evaluate("picture => picture.style.display = 'none'")
        assert page.text_content("#date") == "2026-01-01 UTC"
        assert page.text_content("#charts .tick >> nth=0") == "00:00:00"
        for state, position_s in POSITIONS_S.items():
            seek(page, position_s)
            (begin, *texts), causes = SHOWN[state]
            wait_for_banner(page, begin)
            banner = page.inner_text("#banner")
            assert all(text in banner for text in texts), banner
            assert [tuple(row) for row in cells(page, "#causes .cause")] == causes
            assert page.evaluate(OVERLAPS) == []
        assert view.end(signal.SIGTERM) == 0


WITHOUT_REQUEST = (b"", b"\0\n", b"GET / HTTP/1.1\r\n")  # of a browser that connects ahead, of a scanner of ports
HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: page\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
).encode()
UNREADABLE = (b"\x81\x80\0\0\0\0", b"\x82\x81\0\0\0\0\xc0")  # masked frames: an empty text, and nil of MessagePack
FAILED_HANDSHAKE = b"GET / HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 1\r\n\r\n"


def test_handshakes_that_fail_and_messages_of_other_programs_are_one_line_each() -> None:
    """A connection without a request is none."""
    command = [*installed("posor_bringup", "view"), STATES_BAG.name, "--port", "0", "--bag", str(STATES_BAG)]
    with Program(command) as view:
        port = int(re.findall(rf"http://{HOST}:(\d+)", view.wait_for_line("page at"))[0])
        for request in (*WITHOUT_REQUEST, FAILED_HANDSHAKE):
            with socket.create_connection((HOST, port)) as connection:
                connection.sendall(request)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(4096):  # until the server closes it, which is after the report of an error
                    pass
        with urlopen(f"http://{HOST}:{port}/") as page:
            assert page.status == HTTPStatus.OK
        for frame in UNREADABLE:
            with socket.create_connection((HOST, port)) as connection:
                connection.sendall(HANDSHAKE + frame)
                while connection.recv(4096):  # until the server closes it
                    pass
        assert view.end(signal.SIGTERM) == 0
        assert sum("handshake failed" in line for line in view.errors) == 1
        assert sum("is disconnected" in line for line in view.errors) == len(UNREADABLE)


def test_page_that_is_opened_again_finds_the_history_and_the_events_of_a_night(tmp_path: Path) -> None:
    past = CompressedTime(tmp_path)
    for state, seconds in (("sound", 1800.0), ("one_joint_lost", 90.0), ("sound", 600.0), ("silent", 300.0)):
        past.pass_time(state, seconds, 5.0)
    past.pass_time("one_cause_on_five_joints", 240.0, 5.0)
    past.pass_time("sound", 9 * 3600.0, 30.0)
    past.show("sound")
    with opened_browser(1200, 700) as page:
        for _ in range(2):
            page.goto(past.page.address)
            wait_for_banner(page, ": OK since 2026-01-01 20:51:00 UTC (8 h 59 min)")
            assert [(row[1], row[3]) for row in cells(page, "#events .event")] == [
                (JOINTS, "4 min 25 s"),
                ("", "5 min 5 s"),
                ("elbow", "1 min 30 s"),
            ]
            page.locator(PICTURE).evaluate("picture => picture.style.display = 'none'")
        select_window(page, "12 h")
        while page.text_content("#charts .tick >> nth=0") != "18:00":  # the time limit of the test ends it
            past.show("sound")
            page.wait_for_timeout(200.0)
        assert page.locator("#charts line[stroke-dasharray='4 3']").count() == 1  # begin of the run after the silence
        assert page.evaluate(OVERLAPS) == []
        with page.expect_download() as download:
            page.get_by_text("download the events").click()
        rows = list(csv.DictReader(Path(download.value.path()).read_text(encoding="utf-8").splitlines()))
        assert [(row["state"], row["joints"], row["duration_s"]) for row in rows] == [
            ("LOST", "elbow", "90.000"),
            ("STALE", "", "305.000"),
            ("LOST", JOINTS.replace(",", ""), "265.000"),
        ]
    past.page.close()


def cells(page: Page, rows: str) -> list[list[str]]:
    """Return the texts of the cells of some rows."""
    found: list[list[str]] = page.locator(rows).evaluate_all(CELLS)
    return found


def _css(colour: tuple[int, int, int]) -> str:
    return f"rgb{colour}"
