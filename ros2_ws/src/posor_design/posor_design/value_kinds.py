# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arguments and results of calculators by their kind: a quantity, several of them, a count, or one of several names."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin

import numpy as np
from posor.errors import ParameterError, similar_name

from posor_design.calculators import type_of, unit_of
from posor_design.quantity_text import describe_unit, format_quantity, parse_quantity, split_list

LONGEST_LINE = 12  # numbers of a value that a line shows


def parse_value(kind: Any, text: str, where: str) -> Any:
    """Return the value of an argument; commas separate several values, and the last unit holds for values without one.

    ``kind``: annotation of the argument. ``text``: text of the command line. ``where``: name of the argument, for
    errors. Raises ParameterError: the text is not a value of this kind.
    """
    bare = type_of(kind)
    if get_origin(bare) is tuple:
        entries, kinds = split_list(text), get_args(bare)
        if kinds[-1] is not Ellipsis and len(kinds) != len(entries):
            raise ParameterError(f"{len(entries)} values in '{text}'", where=where, expected=describe_kind(kind))
        return tuple(parse_quantity(entry, unit_of(kind), where) for entry in entries)
    if get_origin(bare) is Literal:
        if text not in get_args(bare):
            expected = similar_name(text, get_args(bare), describe_kind(kind))
            raise ParameterError(f"'{text}' is unknown", where=where, expected=expected)
        return text
    if bare is int:
        try:
            return int(text)
        except ValueError:
            raise ParameterError(f"'{text}' is not a whole number", where=where, expected=describe_kind(kind)) from None
    return parse_quantity(text, unit_of(kind), where)


def describe_kind(kind: Any) -> str:
    """Return what an argument of this kind is: ``a number in m (mm, um, in)``."""
    bare, number = type_of(kind), describe_unit(unit_of(kind))
    if get_origin(bare) is tuple:
        count = "" if get_args(bare)[-1] is Ellipsis else f"{len(get_args(bare))} "
        return f"{count}numbers separated by commas, each {number}"
    if get_origin(bare) is Literal:
        return f"one of {', '.join(get_args(bare))}"
    return "a whole number" if bare is int else number


def name_kind(kind: Any) -> str:
    """Return units or choices of a value in short, for help and pages: ``m, m``, ``m, ...``, ``tube or box``."""

    def name(bare: Any) -> str:
        if get_origin(bare) is tuple:
            return ", ".join(map(name, get_args(bare)))
        if get_origin(bare) is Literal:
            return " or ".join(get_args(bare))
        return {Ellipsis: "...", int: "whole number"}.get(bare, unit_of(kind))

    return name(type_of(kind))


def format_value(kind: Any, value: Any) -> str:
    """Return a value as text with unit; values of a tuple are separated by commas, tuples of a tuple by semicolons."""
    if isinstance(value, tuple):
        separator = "; " if value and isinstance(value[0], tuple) else ", "
        return separator.join(format_value(kind, each) for each in value)
    return str(value) if isinstance(value, int | str) else format_quantity(value, unit_of(kind))


def is_series(value: Any) -> bool:
    """Return whether a value has more numbers than a line shows."""
    return isinstance(value, tuple) and np.size(value) > LONGEST_LINE


def summarise_value(kind: Any, value: Any) -> str:
    """Return a value as ``format_value`` does, but size and range of a series."""
    if not is_series(value):
        return format_value(kind, value)
    size = " x ".join(map(str, np.shape(value)))
    low, high = (format_quantity(float(end(value)), unit_of(kind)) for end in (np.min, np.max))
    return f"{size} values from {low} to {high}"
