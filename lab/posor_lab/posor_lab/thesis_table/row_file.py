# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of rows: the thesis table as data, and its evaluation.

A file is a YAML mapping:

- ``title``: subject of the rows.
- ``modules``: modules of the functions that the values call by their names.
- ``inputs``: anchors that several values share; not evaluated.
- ``sources``: values by name that rows share; evaluated when the first row refers to them.
- ``rows``: by section a list of rows, each with ``quantity``, ``unit``, ``printed`` (digits; empty: not legible) and
  ``value``, and as needed ``scale`` (unit or number that divides the value; default: ``unit``), ``reason`` (a text, or
  texts by quantity), ``kind``, ``input_rounding``, ``values`` (sources of this row) and ``tables``: the row is repeated
  for each combination of their rows, and uses their columns. A table has ``columns`` and ``rows``, or is a call.
- ``figures``: see ``figure_data``. ``budgets``: see ``budget_tables``.

A value is a number with its unit (``5/32 in``), a reference (``$source.field.0``; in capitals: a constant of a module),
a list of values, a text, an operation on a list (``ratio: [$a, $b]``; see ``ARITHMETIC``), or a call: a mapping with
``function`` (its name, and the field of its result) and its arguments. A text may contain a column (``{name}``) or a
number in a unit (``{source.field ksi:.1f}``).
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import yaml
from posor.calibration.yaml_document import FastLoader
from posor.errors import DataFileError, similar_name

from posor_lab.thesis_data import amount
from posor_lab.thesis_table.formulas import ARITHMETIC
from posor_lab.thesis_table.thesis_row import Agreement, ComparisonKind, ThesisRow

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

_REQUIRED = {"quantity", "unit", "printed", "value"}
_OPTIONAL = {"scale", "reason", "kind", "input_rounding", "values", "tables"}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(?:/(\d+))?(?: (\S.*))?", re.ASCII)
_PLACEHOLDER = re.compile(r"\{([^{}: ]+)(?: ([^{}:]+))?(?::([^{}]+))?\}")


class _TextLoader(FastLoader):
    """Reads every scalar as text, so that printed digits stay as they are."""


_TextLoader.yaml_implicit_resolvers = {"<": [("tag:yaml.org,2002:merge", re.compile("<<"))]}


class RowFile:
    """A file of rows: its ``title``, and its ``content`` by section."""

    def __init__(self, path: Path) -> None:
        """Read a file. Raises DataFileError: the file cannot be read, is not YAML, or has a wrong section."""
        self._path = self._where = str(path)
        try:
            content = yaml.load(path.read_text(encoding="utf-8"), _TextLoader)  # noqa: S506  a safe loader
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise DataFileError(f"cannot be read: {error}", where=self._path, expected="a file of rows") from error
        self.check_keys(content, {"title", "modules", "rows"}, {"inputs", "sources", "figures", "budgets"})
        self.title: str = content["title"]
        self.content: Mapping[str, Any] = content
        try:
            self._modules = [import_module(name) for name in content["modules"]]
        except ImportError as error:
            raise self.refusal(f"a module of 'modules' cannot be imported: {error}") from error
        self._unused = dict(content.get("sources", {}))
        self._found: dict[str, Any] = {}
        self._results: dict[tuple[Any, ...], Any] = {}  # of each call

    def rows(self) -> list[ThesisRow]:
        """Return all rows. Raises PosorError: a row is invalid, or its function fails."""
        rows = []
        for section, entries in self.content["rows"].items():
            for entry in entries:
                self.enter(section, entry, "quantity")
                self.check_keys(entry, _REQUIRED, _OPTIONAL)
                rows += [self._row(section, entry, columns) for columns in self.combinations(entry)]
        return rows

    def enter(self, section: str, entry: Any, name: str) -> None:
        """Set the entry of a section, by the text of a key, that later errors name."""
        self._where = f"{self._path}, {section}, {entry.get(name, '') if isinstance(entry, Mapping) else entry}"

    def check_unused(self) -> None:
        """Refuse sources that no row and no figure has used. Raises DataFileError: a source is unused."""
        if self._unused:
            raise DataFileError(f"source '{next(iter(self._unused))}' is not used", where=self._path)

    def combinations(
        self, entry: Mapping[str, Any], outer: Mapping[str, Any] | None = None
    ) -> Iterator[dict[str, Any]]:
        """Return the columns of each combination of the rows of an entry's tables, and its own and the outer values."""
        for parts in itertools.product(*map(self._table, entry.get("tables", []))):
            columns = {**(outer or {}), **{name: cell for part in parts for name, cell in part.items()}}
            for name, value in entry.get("values", {}).items():
                columns[name] = self.evaluate(value, columns)
            yield columns

    def evaluate(self, content: Any, columns: Mapping[str, Any]) -> Any:
        """Return a value; ``columns``: values of the row by name.

        Raises PosorError: the value is invalid, or its function fails.
        """
        if isinstance(content, Mapping):
            return self._call(content, columns)
        if isinstance(content, list):
            return tuple(self.evaluate(each, columns) for each in content)
        text = self.fill(content, columns)
        if text.startswith("$"):
            return self._refer(text[1:], columns)
        match = _NUMBER.fullmatch(text)
        if match is None:
            return text
        number, divisor, unit = match.groups()
        if unit is None and divisor is None and number.isdecimal():
            return int(number)
        return float(number) / int(divisor or 1) * (1.0 if unit is None else self.amount(unit))

    def fill(self, text: str, columns: Mapping[str, Any]) -> str:
        """Return a text with its placeholders replaced."""

        def replaced(match: re.Match[str]) -> str:
            value = self._refer(match[1], columns)
            if isinstance(value, str):
                value = self.fill(value, columns)
            return format(value / self.amount(match[2]) if match[2] else value, match[3] or "")

        return _PLACEHOLDER.sub(replaced, text)

    def amount(self, unit: str) -> float:
        """Return the amount of a unit. Raises DataFileError: the unit is unknown."""
        try:
            return amount(unit)
        except DataFileError as error:
            raise self.refusal(error.what, error.expected) from None

    def refusal(self, what: str, expected: str = "") -> DataFileError:
        """Return an error that names file and row."""
        return DataFileError(what, where=self._where, expected=expected)

    def check_keys(self, content: Any, required: Collection[str], optional: Collection[str]) -> None:
        """Refuse content that is not a mapping with these keys. Raises DataFileError: a key is missing or unknown."""
        if not isinstance(content, Mapping):
            raise self.refusal("is not a mapping", f"keys {', '.join(sorted(required))}")
        for key in content:
            if key not in required and key not in optional:
                known = [*sorted(required), *sorted(optional)]
                raise self.refusal(f"key '{key}' is unknown", similar_name(key, known, f"one of {', '.join(known)}"))
        for key in sorted(required):
            if key not in content:
                raise self.refusal(f"key '{key}' is missing")

    def _row(self, section: str, entry: Mapping[str, Any], columns: dict[str, Any]) -> ThesisRow:
        quantity, unit = self.fill(entry["quantity"], columns), self.fill(entry["unit"], columns)
        reason = entry.get("reason", "")
        reason = reason.get(quantity, "") if isinstance(reason, Mapping) else reason
        kind = self.fill(entry.get("kind", ComparisonKind.COMPUTED.value), columns)
        if kind not in {known.value for known in ComparisonKind}:
            what = f"kind '{kind}' is unknown"
            raise self.refusal(what, f"one of {', '.join(known.value for known in ComparisonKind)}")
        value = self.evaluate(entry["value"], columns)
        scale = self.amount(self.fill(entry.get("scale", unit), columns))
        row = ThesisRow(
            self.fill(section, columns),
            quantity,
            unit,
            self.fill(entry["printed"], columns),
            float(value) / scale,
            self.fill(reason, columns),
            float(self.evaluate(entry.get("input_rounding", "0"), columns)),
            ComparisonKind(kind),
        )
        if not math.isfinite(row.computed):
            raise self.refusal(f"'{quantity}' is computed as {row.computed}", "a finite number")
        if row.verdict is not Agreement.AGREES and not row.reason:
            numbers = f"printed '{row.printed}', computed {row.computed:g}"
            raise self.refusal(f"'{quantity}' {row.verdict.value} without a reason: {numbers}", "key 'reason'")
        return row

    def _table(self, content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        if "function" in content:
            return list(self.evaluate(content, {}))
        self.check_keys(content, {"columns", "rows"}, ())
        for row in content["rows"]:
            if len(row) != len(content["columns"]):
                raise self.refusal(f"row {row} of its table has {len(row)} cells", f"{len(content['columns'])}")
        return [
            {name: self._cell(cell) for name, cell in zip(content["columns"], row, strict=True)}
            for row in content["rows"]
        ]

    def _cell(self, content: Any) -> Any:
        """Return a cell of a table: a text, or a value that has no text."""
        return content if isinstance(content, str) and not content.startswith("$") else self.evaluate(content, {})

    def _call(self, content: Mapping[str, Any], columns: Mapping[str, Any]) -> Any:
        operation = next(iter(content), "")
        if len(content) == 1 and operation in ARITHMETIC:
            operands = self.evaluate(content[operation], columns)
            try:
                return ARITHMETIC[operation](*operands)
            except TypeError as error:
                raise self.refusal(f"{operation} of {operands}: {error}") from None
        self.check_keys(content, {"function"}, content)
        name, *fields = self.fill(content["function"], columns).split(".")
        found = (vars(module).get(name) for module in self._modules)
        function = next((each for each in found if getattr(each, "__module__", "") in self.content["modules"]), None)
        if name.startswith("_") or not callable(function):
            raise self.refusal(f"function '{name}' is unknown", f"a function of {', '.join(self.content['modules'])}")
        signature = inspect.signature(function)
        texts = {key for key, parameter in signature.parameters.items() if parameter.annotation == "str"}
        arguments = {
            key: self.fill(each, columns) if key in texts else self.evaluate(each, columns)
            for key, each in content.items()
            if key != "function"
        }
        call = (function, tuple(arguments.items()))
        try:
            signature.bind(**arguments)
            if not _is_hashable(call):
                return self._follow(function(**arguments), fields)
            if call not in self._results:
                self._results[call] = function(**arguments)
        except TypeError as error:
            raise self.refusal(f"function '{name}': {error}") from error
        return self._follow(self._results[call], fields)

    def _refer(self, path: str, columns: Mapping[str, Any]) -> Any:
        name, *fields = path.split(".")
        if name in columns:
            return self._follow(columns[name], fields)
        if name in self._unused:
            self._found[name] = self.evaluate(self._unused.pop(name), {})
        elif name.isupper():  # a constant
            self._found[name] = next((vars(module)[name] for module in self._modules if name in vars(module)), None)
        if self._found.get(name) is None:
            raise self.refusal(f"'{name}' is unknown or refers to itself", "a column or a source")
        return self._follow(self._found[name], fields)

    def _follow(self, value: Any, fields: list[str]) -> Any:
        try:
            for field in fields:
                if isinstance(value, Mapping):
                    value = value[field]
                else:
                    value = value[int(field)] if field.lstrip("-").isdecimal() else getattr(value, field)
        except (LookupError, TypeError, AttributeError):
            raise self.refusal(f"'{'.'.join(fields)}' is not a field of {value!r:.60}") from None
        return value


def _is_hashable(value: object) -> bool:
    """Return whether a value has a hash; an array has none."""
    try:
        hash(value)
    except TypeError:
        return False
    return True
