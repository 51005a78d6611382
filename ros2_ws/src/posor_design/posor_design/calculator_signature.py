# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a user can know about a calculator: its arguments, results and documentation, read from the function itself."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_design.calculators import CALCULATORS, annotations_of
from posor_design.data_file import read_data

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class Value:
    """An argument of a calculator, or a field of its result."""

    name: str  # name in Python
    kind: Any  # annotation: type, unit, limits and meaning, see ``calculators.py``
    # value of an argument that is left out; ``inspect.Parameter.empty``: the argument is required
    default: Any = inspect.Parameter.empty

    @property
    def description(self) -> str:
        """Meaning."""
        return str(self.kind.__metadata__[-1])

    @property
    def required(self) -> bool:
        """Whether an argument has no default."""
        return self.default is inspect.Parameter.empty

    @property
    def option(self) -> str:
        """Option of the command line."""
        return "--" + self.name.replace("_", "-")


@dataclass(frozen=True)
class CalculatorSignature:
    """A calculator: its function, its documentation, its arguments and the fields of its result."""

    name: str
    function: Callable[..., Any]
    summary: str
    description: str
    source: str
    example: str
    arguments: tuple[Value, ...]
    results: tuple[Value, ...]


def read_signature(name: str) -> CalculatorSignature:
    """Return the signature of the calculator with a name of ``CALCULATORS``."""
    function = CALCULATORS[name]
    kinds, parameters = annotations_of(function), inspect.signature(function).parameters
    text, _, source = inspect.cleandoc(str(function.__doc__)).partition("\nSource: ")
    summary, _, description = text.partition("\n")
    return CalculatorSignature(
        name=name,
        function=function,
        summary=summary.rstrip("."),
        description=description.strip(),
        source=" ".join(source.split()),
        example=f"posor design {name} {read_data('calculator_examples')[name]}",
        arguments=tuple(Value(key, kinds[key], each.default) for key, each in parameters.items()),
        results=tuple(Value(key, kind) for key, kind in annotations_of(kinds["return"]).items()),
    )
