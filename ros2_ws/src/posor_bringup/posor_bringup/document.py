"""What a report of this package is made of: the estimator's pages, and on them a table of findings."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from posor_estimator.reporting.document import Picture, Section, cells, document, image, notes_list, table, terms_list

from posor_bringup.findings import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_bringup.findings import Finding, Findings

__all__ = ["Picture", "Section", "cells", "document", "findings_table", "image", "notes_list", "table", "terms_list"]

_CLASSES: Mapping[Verdict, str] = {Verdict.HOLDS: "holds", Verdict.FAILS: "fails", Verdict.SHOWN: "shown"}


def findings_table(findings: Findings, headings: Mapping[str, str]) -> str:
    """Return the findings as a table.

    Args:
        findings: What was found.
        headings: What the columns between the quantity and the verdict are called, by attribute of ``Finding``.

    """
    rows = [
        [
            *cells([finding.what, *(getattr(finding, attribute) for attribute in headings), finding.remark]),
            _verdict(finding),
        ]
        for finding in findings.findings
    ]
    return table(("quantity", *headings.values(), "remark", "verdict"), rows)


def _verdict(finding: Finding) -> str:
    return f'<td class="{_CLASSES[finding.verdict]}">{escape(finding.verdict.value)}</td>'
