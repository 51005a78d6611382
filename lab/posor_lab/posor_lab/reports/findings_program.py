"""Programs whose exit code says whether their findings hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_lab.reports.findings import Findings


@reports_errors
def exit_code_of_findings(program: Callable[[], Findings]) -> int:
    """Run ``program``; return 0 if its findings hold, 1 if not, or write a PosorError and return its exit code."""
    return int(not program().holds)
