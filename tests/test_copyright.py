# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Each source file begins with copyright and licence, in the form that ``ament_copyright`` finds."""

from __future__ import annotations

import importlib.metadata
import re

from copyright_headers import HEADER, files_without_header
from environment import THIS


def test_each_source_file_begins_with_the_header() -> None:
    assert files_without_header() == []


def test_ament_copyright_knows_the_header() -> None:
    """Its pattern of a copyright line, and the licence text, which stands below that line."""
    copyright_line, *licence = HEADER
    assert re.fullmatch(r"Copyright \d{4} (?!\s)[^\n\r]+", copyright_line)
    (entry,) = importlib.metadata.entry_points(group="ament_copyright.license", name="apache2_spdx")
    form = entry.load()
    assert form.file_headers == ("\n".join(["{copyright}", *licence]),)
    assert all(text in (THIS.root / "CONTRIBUTING.md").read_text(encoding="utf-8") for text in form.contributing_files)
    assert "Apache License" in (THIS.root / "LICENSE").read_text(encoding="utf-8")
