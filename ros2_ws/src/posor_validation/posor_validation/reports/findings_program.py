"""Programs whose exit code says whether their findings hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.ros.node_program import exit_code_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_validation.reports.findings import Findings


def exit_code_of_findings(program: Callable[[], Findings]) -> int:
    """Run ``program``; return 0 if its findings hold, 1 if not, or write a PosorError and return its exit code."""
    findings: list[Findings] = []
    code = exit_code_of(lambda: findings.append(program()))
    return code or int(not findings[0].holds)
