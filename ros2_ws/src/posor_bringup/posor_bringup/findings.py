"""What a run found, figure by figure, and whether each holds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """Does a figure hold?"""

    HOLDS = "holds"
    FAILS = "FAILS"
    SHOWN = "not judged"

    @staticmethod
    def of(*, holds: bool) -> Verdict:
        """Return the verdict on a figure that is judged."""
        return Verdict.HOLDS if holds else Verdict.FAILS


@dataclass(frozen=True)
class Finding:
    """One figure, all text ready to print.

    Attributes:
        what: The quantity.
        computed: What the run gave.
        stated: What it is compared with: the thesis, a prediction; empty where there is nothing.
        limit: What holds; empty where nothing is judged.
        source: Where ``stated`` comes from.
        verdict: Whether it holds.
        remark: What the figure is taken over, why this limit.

    """

    what: str
    computed: str
    stated: str
    limit: str
    source: str
    verdict: Verdict
    remark: str = ""


@dataclass(frozen=True)
class Findings:
    """All figures of a run."""

    findings: tuple[Finding, ...]

    @property
    def holds(self) -> bool:
        """Whether no figure fails and at least one was judged."""
        verdicts = {finding.verdict for finding in self.findings}
        return Verdict.FAILS not in verdicts and Verdict.HOLDS in verdicts
