# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import TYPE_CHECKING

from posor.reporting.report_table import report_console

if TYPE_CHECKING:
    import pytest


def test_a_path_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    report_console(80).print("/a/:bug:/[b]/c", markup=False)
    assert capsys.readouterr().out == "/a/:bug:/[b]/c\n"
