"""What a user can know about a calculator: its arguments, results and documentation, read from the function itself."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_design.calculators import CALCULATORS, annotations_of

if TYPE_CHECKING:
    from collections.abc import Callable

_SECTION = re.compile(r"(Example|Source):(.*)")


@dataclass(frozen=True)
class Value:
    """An argument of a calculator, or a field of its result.

    Attributes:
        name: Name in Python.
        kind: Type, with its unit as ``units.py`` annotates it.
        description: Meaning, from the annotation.
        default: Value of an argument that is left out; ``inspect.Parameter.empty``: the argument is required.

    """

    name: str
    kind: Any
    description: str
    default: Any = inspect.Parameter.empty

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
    kinds = annotations_of(function)
    result = kinds["return"]
    text = _sections(function)
    summary, _, description = text[""].partition("\n")
    return CalculatorSignature(
        name=name,
        function=function,
        summary=summary.rstrip("."),
        description=description.strip(),
        source=" ".join(text["Source"].split()),
        example=" ".join(text["Example"].split()),
        arguments=tuple(
            _value(key, kinds[key], parameter.default)
            for key, parameter in inspect.signature(function).parameters.items()
        ),
        results=tuple(_value(each.name, annotations_of(result)[each.name]) for each in dataclasses.fields(result)),
    )


def _value(name: str, kind: Any, default: Any = inspect.Parameter.empty) -> Value:
    """Return a value by its annotation: type, unit of a single quantity, limits, and at last its meaning."""
    bare = kind if kind.__origin__ is float else kind.__origin__
    return Value(name, bare, kind.__metadata__[-1], default)


def _sections(item: Any) -> dict[str, str]:
    """Return the sections of a docstring by name; the text before the first has the name ``""``."""
    sections, name = {"": ""}, ""
    for line in inspect.cleandoc(item.__doc__).splitlines():
        heading = _SECTION.match(line)
        name = heading[1] if heading else name
        sections[name] = sections.get(name, "") + (heading[2].strip() if heading else line) + "\n"
    return {key: textwrap.dedent(text).strip("\n") for key, text in sections.items()}
