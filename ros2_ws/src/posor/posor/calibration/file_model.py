# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base of the pydantic models of all YAML files of the project, and the wording of their errors."""

from __future__ import annotations

import re
import reprlib
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from posor.errors import CalibrationError, similar_name
from posor.ros_names import ROS_NAME_RULE, is_ros_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pydantic_core import ErrorDetails

Location = tuple[str | int, ...]  # keys and indices from the root of a file

TEXT = "text, in quotes where YAML would read something else"
_KEY_MARK = "[key]"  # pydantic's mark at the end of the location of a wrong key

# Expected input by pydantic's error type; braces are filled from the context of the error.
_EXPECTED = {
    "string_type": TEXT,
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "finite_number": "a finite number",
    "string_too_short": "text that is not empty",
    "too_short": "at least {min_length}",
    "too_long": "at most {max_length}",
}

_SHORT = reprlib.Repr()
_SHORT.maxlist = _SHORT.maxtuple = 12
_SHORT.maxstring = 80


class EntryError(CalibrationError, ValueError):
    """Raised by validators; pydantic adds the location of the validated part in the file."""

    def __init__(self, what: str, *, key: Location = (), expected: str = "") -> None:
        super().__init__(what, expected=expected)
        self.key = key  # keys and indices from the validated part to the wrong entry; empty for the part itself


def _check_expression(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise EntryError(f"'{text}': {error}", expected="a regular expression") from None
    return text


Expression = Annotated[str, AfterValidator(_check_expression)]
"""A regular expression."""


def _check_ros_name(name: str) -> str:
    if not is_ros_name(name):
        raise EntryError(f"name {format_value(name)}", expected=ROS_NAME_RULE)
    return name


Name = Annotated[str, AfterValidator(_check_ros_name)]
"""Part of a ROS namespace."""


def format_value(value: object) -> str:
    """Return a value as the file has it, shortened if it is long."""
    return _SHORT.repr(value)


class UnknownKeyError(EntryError):
    """A key is not of the format; ``instead``: the known key that it may have meant, or empty."""

    def __init__(self, key: str, free: Sequence[str]) -> None:
        expected = similar_name(key, free, "a key of the format")
        super().__init__(f"unknown key '{key}'", key=(key,), expected=expected)
        self.instead = next((name for name in free if expected == f"perhaps '{name}'"), "")


class FrozenModel(BaseModel):
    """Base of every part of a file: immutable, unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(cached_property,), defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: object) -> object:
        """Report an unknown key before the key that is missing because of it."""
        if isinstance(data, cls):
            return data
        if not isinstance(data, dict):
            raise EntryError(format_value(data), expected="a mapping")
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in data:
            if not isinstance(key, str):
                raise EntryError(f"key {format_value(key)} is not text", key=(key,), expected=TEXT)
            if key not in known:
                raise UnknownKeyError(key, [name for name in known if name not in data])
        return data


def select_model_by_key(key: str, models: Mapping[str, type[FrozenModel] | EntryError]) -> BeforeValidator:
    """Return the annotation of a union whose member is selected by the value of ``key``.

    ``models``: the model of each value, or why there is none. Unlike pydantic's discriminated union it leaves the
    location of an error unchanged.
    """
    classes = tuple(model for model in models.values() if isinstance(model, type))

    def select(part: object) -> object:
        if isinstance(part, classes):
            return part
        if not isinstance(part, dict):
            raise EntryError(format_value(part), expected="a mapping")
        known = ", ".join(f"'{each}'" for each in sorted(models))
        expected = known if len(models) == 1 else f"one of {known}"
        if key not in part:
            raise EntryError(f"key '{key}' is missing", expected=expected)
        name = part[key]
        if not isinstance(name, str) or name not in models:
            raise EntryError(f"{key} {format_value(name)}", key=(key,), expected=expected)
        if isinstance(model := models[name], EntryError):
            raise model
        return model.model_validate(part)

    return BeforeValidator(select)


@dataclass(frozen=True)
class Problem:
    """What is wrong, where, and what is expected."""

    what: str
    location: Location
    expected: str = ""


def first_problem(error: ValidationError) -> Problem:
    """Return the first problem that pydantic has found, with the number of further ones."""
    details = error.errors(include_url=False)
    problem = _problem(details[0])
    if len(details) == 1:
        return problem
    return Problem(f"{problem.what} (and {len(details) - 1} more)", problem.location, problem.expected)


def all_problems(error: ValidationError, content: object, validate: Callable[[Any], object]) -> list[Problem]:
    """Return all problems of a file's content, also those that pydantic does not reach because of an unknown key.

    ``error``: of the first validation; ``validate``: repeats it with other content. An unknown key is replaced by the
    key that it may have meant, or left out, until no further unknown key is found.
    """
    found: dict[Problem, None] = {}
    renamed: dict[Location, str] = {}
    further: ValidationError | None = error
    while further is not None:
        unknown = False
        for details in further.errors(include_url=False):
            problem = _problem(details)
            location = tuple(renamed.get(problem.location[: n + 1], part) for n, part in enumerate(problem.location))
            found[Problem(problem.what, location, problem.expected)] = None
            cause = details.get("ctx", {}).get("error")
            if isinstance(cause, UnknownKeyError):
                content = deepcopy(content)
                unknown |= _replace_key(content, details["loc"], cause)
                renamed[*details["loc"], cause.instead] = str(cause.key[0])
        further = _error_of(content, validate) if unknown else None
    return list(found)


def _replace_key(content: Any, mapping: Location, unknown: UnknownKeyError) -> bool:
    """Replace or remove an unknown key of a mapping in the content; return whether it was found."""
    try:
        for step in mapping:
            content = content[step]
        value = content.pop(unknown.key[0])
    except (LookupError, TypeError, AttributeError):  # pydantic's location is not always one of the content
        return False
    if unknown.instead:
        content[unknown.instead] = value
    return True


def _error_of(content: object, validate: Callable[[Any], object]) -> ValidationError | None:
    try:
        validate(content)
    except ValidationError as error:
        return error
    return None


def _problem(details: ErrorDetails) -> Problem:
    kind, location, value = details["type"], details["loc"], details["input"]
    context: dict[str, Any] = details.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, EntryError):
        return Problem(cause.what, (*location, *cause.key), cause.expected)
    if isinstance(cause, Exception):
        return Problem(str(cause).rstrip("."), location)
    if kind == "missing":
        return Problem(f"key '{location[-1]}' is missing", location[:-1])
    if location and location[-1] == _KEY_MARK:
        return Problem(f"key {format_value(value)} is not text", location[:-1], TEXT)
    if kind not in _EXPECTED:
        return Problem(f"{details['msg']} (value {format_value(value)})", location)
    what = f"has {context['actual_length']} entries" if kind.startswith("too_") else format_value(value)
    return Problem(what, location, _EXPECTED[kind].format(**context))
