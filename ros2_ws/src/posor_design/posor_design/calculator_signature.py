"""What a user can know about a calculator: its arguments, results and documentation, read from the function itself."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_type_hints

from posor_design import units
from posor_design.calculators import load_calculator

if TYPE_CHECKING:
    from collections.abc import Callable

_ENTRY = re.compile(r"(\w+): (.*)")
_SECTION = re.compile(r"(Args|Attributes|Example|Raises|Returns|Source):(.*)")


@dataclass(frozen=True)
class Value:
    """An argument of a calculator, or a field of its result.

    Attributes:
        name: Name in Python.
        kind: Type, with its unit as ``units.py`` annotates it.
        description: Text of the docstring.
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
    function = load_calculator(name)
    hints = _type_hints(function)
    text = _sections(function)
    descriptions = _entries(text.get("Args", ""))
    arguments = tuple(
        Value(parameter.name, hints[parameter.name], descriptions[parameter.name], parameter.default)
        for parameter in inspect.signature(function).parameters.values()
    )
    summary, _, description = text[""].partition("\n")
    return CalculatorSignature(
        name=name,
        function=function,
        summary=summary.rstrip("."),
        description=description.strip(),
        source=" ".join(text["Source"].split()),
        example=" ".join(text["Example"].split()),
        arguments=arguments,
        results=result_values(hints["return"]),
    )


def result_values(result: type) -> tuple[Value, ...]:
    """Return the fields of a result, a dataclass."""
    hints = _type_hints(result)
    descriptions = _entries(_sections(result).get("Attributes", ""))
    return tuple(Value(each.name, hints[each.name], descriptions[each.name]) for each in dataclasses.fields(result))


def _type_hints(item: Any) -> dict[str, Any]:
    """Return annotations with their units; modules import ``units.py`` for type checkers only."""
    return get_type_hints(item, localns=vars(units), include_extras=True)


def _sections(item: Any) -> dict[str, str]:
    """Return the sections of a docstring by name; the text before the first has the name ``""``."""
    sections, name = {"": ""}, ""
    for line in inspect.cleandoc(item.__doc__).splitlines():
        heading = _SECTION.match(line)
        name = heading[1] if heading else name
        sections[name] = sections.get(name, "") + (heading[2].strip() if heading else line) + "\n"
    return {key: textwrap.dedent(text).strip("\n") for key, text in sections.items()}


def _entries(section: str) -> dict[str, str]:
    """Return the entries of a section such as ``Args``: description by name."""
    entries: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        entry = _ENTRY.match(line)
        if entry:
            name = entry[1]
            entries[name] = entry[2]
        elif name and line.strip():
            entries[name] += " " + line.strip()
    return entries
