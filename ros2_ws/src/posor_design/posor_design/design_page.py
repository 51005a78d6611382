# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Page of a calculator: results, arguments, effect of each argument on each result, and method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from posor.errors import ParameterError
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, definition_list, paragraph, render_page, table

from posor_design.calculators import unit_of
from posor_design.value_kinds import is_series, summarise_value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.reporting.plot import Plot

    from posor_design.calculator_signature import CalculatorSignature, Value

_COLOURS = (BLUE, ORANGE, GREEN, LIGHT_BLUE, GREY)
_INCREASE = 0.01  # relative growth of each argument


def render_design_page(signature: CalculatorSignature, arguments: Mapping[str, Any], results: Mapping[str, Any]) -> str:
    """Return the page of a result, as HTML that loads nothing from elsewhere."""
    about = paragraph(signature.description) if signature.description else Markup()
    return render_page(
        f"posor design {signature.name}",
        f"{signature.summary}.",
        holds=True,
        sections=(
            Section("Results", _value_table(signature.results, results), _plots(signature.results, results)),
            Section("Arguments", _value_table(signature.arguments, arguments)),
            Section(
                f"Change of the results if an argument grows by {_INCREASE:.0%}",
                _effects(signature, arguments, results),
            ),
            Section("Method", about + definition_list({"Source": signature.source, "Example": signature.example})),
        ),
    )


def _plots(fields: Sequence[Value], results: Mapping[str, Any]) -> list[Plot]:
    """Return a plot of each series over the first one, such as mode shapes over positions."""
    series = [each for each in fields if is_series(results[each.name])]
    if not series:
        return []
    from posor.reporting.plot import Plot  # noqa: PLC0415  takes a second to load

    across, *others = series
    plots = []
    for each in others:
        plot = Plot(each.description.rstrip("."), *(f"{axis.name} [{unit_of(axis.kind)}]" for axis in (across, each)))
        for number, curve in enumerate(np.atleast_2d(results[each.name])):
            plot.curve(f"{each.name} {number + 1}", results[across.name], curve, _COLOURS[number % len(_COLOURS)])
        plots.append(plot)
    return plots


def _value_table(fields: Sequence[Value], values: Mapping[str, Any]) -> Markup:
    rows = [(each.name, summarise_value(each.kind, values[each.name]), each.description) for each in fields]
    return table(("quantity", "value", "meaning"), rows)


def _effects(signature: CalculatorSignature, arguments: Mapping[str, Any], results: Mapping[str, Any]) -> Markup:
    """Return the relative change of each result that is a number or a few, by each argument that is one number."""
    names = [each.name for each in signature.results if _has_numbers(results[each.name])]
    rows = []
    for argument, value in arguments.items():
        if not isinstance(value, float) or value == 0.0:
            continue
        try:
            changed = signature.function(**{**arguments, argument: value * (1.0 + _INCREASE)})
        except ParameterError as error:
            rows.append((argument, *("",) * len(names), f"refused: {error}"))
            continue
        rows.append((argument, *(_relative_change(results[name], getattr(changed, name)) for name in names), ""))
    return table(("argument", *names, ""), rows)


def _has_numbers(value: Any) -> bool:
    return np.asarray(value).dtype.kind == "f" and not is_series(value)


def _relative_change(before: Any, after: Any) -> str:
    """Return the relative change of each number; a change from 0 has none."""
    pairs = zip(np.ravel(before), np.ravel(after), strict=True)
    return ", ".join(f"{new / old - 1.0:+.2%}" if old else "from 0" for old, new in pairs)
