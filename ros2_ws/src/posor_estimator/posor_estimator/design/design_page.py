"""Page of a calculator: results, arguments and method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from posor_estimator.design.value_kinds import format_value
from posor_estimator.reporting.html_page import Section, definition_list, paragraph, render_page, table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.design.calculator_signature import CalculatorSignature, Value

_HEADER = ("quantity", "value", "meaning")


def render_design_page(signature: CalculatorSignature, arguments: Mapping[str, Any], results: Mapping[str, Any]) -> str:
    """Return the page of a result, as HTML that loads nothing from elsewhere."""
    about = paragraph(signature.description) if signature.description else Markup()
    return render_page(
        f"posor design {signature.name}",
        f"{signature.summary}.",
        holds=True,
        sections=(
            Section("Results", _value_table(signature.results, results)),
            Section("Arguments", _value_table(signature.arguments, arguments)),
            Section("Method", about + definition_list({"Source": signature.source, "Example": signature.example})),
        ),
    )


def _value_table(fields: Sequence[Value], values: Mapping[str, Any]) -> Markup:
    rows = [(each.name, format_value(each.kind, values[each.name]), each.description) for each in fields]
    return table(_HEADER, rows)
