# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shows the live page in Chromium until SIGINT: ``page_reader.py ADDRESS``.

The browser runs at the lowest priority. Without a graphics card the processor draws the arm, and this work, which a
browser on another computer would not take from the graph, is not an effect of ``view``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from posor_ros.node_program import StopSignal

from posor_lab.harness.browser import BROWSER, opened_browser

SHOWN = "page is shown"  # printed when the charts are drawn
WIDTH, HEIGHT = 1280, 800
POLL_MS = 100.0
AT_LOWEST_PRIORITY = f"""#!/bin/sh
# Chromium begins a session of its own; where sessions share the processors, priorities count within a session only.
echo 19 2>/dev/null >/proc/self/autogroup
exec nice -n 19 {BROWSER} "$@"
"""


def main() -> None:
    """Run the program."""
    with TemporaryDirectory() as folder, StopSignal() as stop:
        launcher = Path(folder) / BROWSER
        launcher.write_text(AT_LOWEST_PRIORITY, encoding="ascii")
        launcher.chmod(0o700)
        with opened_browser(WIDTH, HEIGHT, executable=launcher) as page:
            page.goto(sys.argv[1])
            page.wait_for_selector("#charts", timeout=0.0)
            print(SHOWN, flush=True)
            while not stop.requested:
                page.wait_for_timeout(POLL_MS)


if __name__ == "__main__":
    main()
