# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shows the live page in Chromium until SIGINT: ``page_reader.py ADDRESS``.

The browser runs at the lowest priority. Without a graphics card the processor draws the arm, and this work, which a
browser on another computer would not take from the graph, is not an effect of ``view``.
"""

from __future__ import annotations

import os
import sys

from posor_ros.node_program import StopSignal

from posor_lab.harness.browser import opened_browser

SHOWN = "page is shown"  # printed when the charts are drawn
LOWEST_PRIORITY = 19
WIDTH, HEIGHT = 1280, 800
POLL_MS = 100.0


def main() -> None:
    """Run the program."""
    os.nice(LOWEST_PRIORITY)
    with StopSignal() as stop, opened_browser(WIDTH, HEIGHT) as page:
        page.goto(sys.argv[1])
        page.wait_for_selector("#charts", timeout=0.0)
        print(SHOWN, flush=True)
        while not stop.requested:
            page.wait_for_timeout(POLL_MS)


if __name__ == "__main__":
    main()
