# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Test cases as data in YAML files beside the tests, and the errors that refused input gives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from posor.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Callable

ErrorT = TypeVar("ErrorT", bound=PosorError)


def cases(test_file: str, table: str) -> dict[str, Any]:
    """Return the rows of a table as the arguments of ``pytest.mark.parametrize``.

    ``test_file``: ``__file__`` of the test. ``table``: name of the YAML file beside the test: a list of mappings from
    argument to value, all with the same keys. The key ``id``, if any, names the case.
    """
    rows = yaml.load(Path(test_file).with_name(table).read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    ids = [row.pop("id", None) for row in rows]
    names = list(rows[0])
    return {"argnames": names, "argvalues": [[row[name] for name in names] for row in rows], "ids": ids}


def edited(text: str, old: str, new: str) -> str:
    """Return a text with the first occurrence of a part replaced. Raises AssertionError: the part does not occur."""
    if old not in text:
        raise AssertionError(f"no '{old}' in the text")
    return text.replace(old, new, 1)


def refusal(kind: type[ErrorT], call: Callable[..., object], *arguments: Any, **options: Any) -> ErrorT:
    """Call a function that must refuse its arguments, and return its error.

    Raises AssertionError: there is no such error, or its text is not one sentence on one line.
    """
    try:
        call(*arguments, **options)
    except kind as error:
        sentence = str(error)
        if "\n" in sentence or not sentence.endswith("."):
            raise AssertionError(f"'{sentence}' is not one sentence") from error
        return error
    raise AssertionError(f"no {kind.__name__}")
