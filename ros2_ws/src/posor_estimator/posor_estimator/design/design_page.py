"""Page of a calculator: results, arguments, effect of each argument on each result, and method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from posor_estimator.design.value_kinds import format_value
from posor_estimator.errors import ParameterError
from posor_estimator.reporting.html_page import Section, definition_list, paragraph, render_page, table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.design.calculator_signature import CalculatorSignature, Value

_MORE = 0.01
"""Share by which each argument is increased."""


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
            Section(
                f"Change of the results by {_MORE:.0%} more of an argument", _effects(signature, arguments, results)
            ),
            Section("Method", about + definition_list({"Source": signature.source, "Example": signature.example})),
        ),
    )


def _value_table(fields: Sequence[Value], values: Mapping[str, Any]) -> Markup:
    rows = [(each.name, format_value(each.kind, values[each.name]), each.description) for each in fields]
    return table(("quantity", "value", "meaning"), rows)


def _effects(signature: CalculatorSignature, arguments: Mapping[str, Any], results: Mapping[str, Any]) -> Markup:
    """Return the relative change of each result that is one number, by each argument that is one."""
    names = [name for name, value in results.items() if isinstance(value, float) and value != 0.0]
    varied = [name for name, value in arguments.items() if isinstance(value, float) and value != 0.0]
    rows = []
    for argument in varied:
        try:
            changed = signature.function(**{**arguments, argument: arguments[argument] * (1.0 + _MORE)})
        except ParameterError as error:
            rows.append((argument, *("",) * len(names), f"refused: {error}"))
            continue
        rows.append((argument, *(f"{getattr(changed, name) / results[name] - 1.0:+.2%}" for name in names), ""))
    return table(("argument", *names, ""), rows, "numbers")
