"""Arguments and results of calculators by their kind: a quantity, several of them, a count, or one of several names."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin

import numpy as np
from posor.errors import ParameterError, similar_name

from posor_design.quantity_text import describe_unit, format_quantity, parse_quantity, split_unit
from posor_design.units import unit_of

LONGEST_LINE = 12
"""Numbers of a value that a line shows."""


def parse_value(kind: Any, text: str, where: str) -> Any:
    """Return the value of an argument; commas separate several values, and the last unit holds for values without one.

    Args:
        kind: Type of the argument.
        text: Text of the command line.
        where: Name of the argument, for errors.

    Raises:
        ParameterError: The text is not a value of this kind.

    """
    if get_origin(kind) is tuple:
        return _parse_tuple(kind, text, where)
    if get_origin(kind) is Literal:
        names = get_args(kind)
        if text not in names:
            expected = similar_name(text, names, f"one of {', '.join(names)}")
            raise ParameterError(f"'{text}' is unknown", where=where, expected=expected)
        return text
    if kind is int:
        try:
            return int(text)
        except ValueError:
            raise ParameterError(f"'{text}' is not a whole number", where=where, expected=describe_kind(kind)) from None
    return parse_quantity(text, unit_of(kind), where)


def _parse_tuple(kind: Any, text: str, where: str) -> tuple[Any, ...]:
    entries = [entry.strip() for entry in text.split(",")]
    last_unit = split_unit(entries[-1])
    kinds = _entry_kinds(kind, len(entries))
    if len(kinds) != len(entries):
        raise ParameterError(f"{len(entries)} values in '{text}'", where=where, expected=describe_kind(kind))
    entries = [entry if split_unit(entry) else f"{entry} {last_unit}".strip() for entry in entries]
    return tuple(parse_value(each, entry, where) for each, entry in zip(kinds, entries, strict=True))


def describe_kind(kind: Any) -> str:
    """Return what an argument of this kind is: ``a number in m (mm, um, in)``."""
    if get_origin(kind) is tuple:
        kinds = get_args(kind)
        number = "numbers" if kinds[-1] is Ellipsis else f"{len(kinds)} numbers"
        return f"{number} separated by commas, each {describe_kind(kinds[0])}"
    if get_origin(kind) is Literal:
        return f"one of {', '.join(get_args(kind))}"
    if kind is int:
        return "a whole number"
    return describe_unit(unit_of(kind))


def name_kind(kind: Any) -> str:
    """Return units or choices of a value in short, for help and pages: ``m, m``, ``m, ...``, ``tube or box``."""
    if get_origin(kind) is tuple:
        return ", ".join("..." if each is Ellipsis else name_kind(each) for each in get_args(kind))
    if get_origin(kind) is Literal:
        return " or ".join(get_args(kind))
    return "whole number" if kind is int else unit_of(kind)


def format_value(kind: Any, value: Any) -> str:
    """Return a value as text with unit; values of a tuple are separated by commas, tuples of a tuple by semicolons."""
    if get_origin(kind) is tuple:
        kinds = _entry_kinds(kind, len(value))
        separator = "; " if kinds and get_origin(kinds[0]) is tuple else ", "
        return separator.join(format_value(each, entry) for each, entry in zip(kinds, value, strict=True))
    if kind is int or kind is str or get_origin(kind) is Literal:
        return str(value)
    return format_quantity(value, unit_of(kind))


def is_series(kind: Any, value: Any) -> bool:
    """Return whether a value has more numbers than a line shows."""
    return get_origin(kind) is tuple and np.size(value) > LONGEST_LINE


def summarise_value(kind: Any, value: Any) -> str:
    """Return a value as ``format_value`` does, but size and range of a series."""
    if not is_series(kind, value):
        return format_value(kind, value)
    size = " x ".join(map(str, np.shape(value)))
    low, high = (format_quantity(float(end(value)), unit_of(kind)) for end in (np.min, np.max))
    return f"{size} values from {low} to {high}"


def _entry_kinds(kind: Any, length: int) -> tuple[Any, ...]:
    """Return the kind of each entry of a tuple of a length."""
    kinds = get_args(kind)
    return kinds[:1] * length if kinds[-1] is Ellipsis else kinds
