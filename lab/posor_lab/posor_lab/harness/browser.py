# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Chromium without a window, which reads pages."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING

from posor.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from playwright.sync_api import Page

BROWSER, DRIVER = "chromium", "playwright"
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Drawing by the processor: a test machine has no graphics card."""
PATIENCE_MS = 120_000.0  # for all waiting: a busy processor draws slowly


def missing_for_pages() -> str:
    """Return the name of a program or Python package that ``opened_browser`` lacks on this host; empty: nothing."""
    return BROWSER if shutil.which(BROWSER) is None else "" if find_spec(DRIVER) else DRIVER


@contextmanager
def opened_browser(width: int, height: int, scale: float = 1.0, executable: Path | None = None) -> Iterator[Page]:
    """Open an empty page for a ``with`` block; size in CSS pixels, ``scale``: pixels of each.

    ``executable``: starts the browser; None: the installed one.

    Raises PosorError: a program or package is missing.
    """
    if missing := missing_for_pages():
        raise PosorError(f"{missing} is not installed", where="a page in a browser", expected=f"{BROWSER} and {DRIVER}")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  not among the packages of Jazzy

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable or shutil.which(BROWSER), args=ARGUMENTS)
        try:
            page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
            page.set_default_timeout(PATIENCE_MS)
            yield page
        finally:
            browser.close()
