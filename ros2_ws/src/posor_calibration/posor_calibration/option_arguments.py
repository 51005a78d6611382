# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line options of a procedure, generated from the model that declares them."""

from __future__ import annotations

from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from posor.calibration.file_model import format_value
from pydantic_core import PydanticUndefined

from posor_calibration.calibration_fit import NONE, check_options

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    from pydantic.fields import FieldInfo

    from posor_calibration.procedure import Options

TYPE_NAMES: dict[Any, str] = {float: "NUMBER", int: "COUNT", bool: "true|false", str: "TEXT"}


def add_options(parser: argparse.ArgumentParser, model: type[Options], *, exclude: Iterable[str] = ()) -> None:
    """Add one text option for each field of a model but the excluded ones; ``read_options`` validates them."""
    group = parser.add_argument_group("options of the procedure")
    for name, field in model.model_fields.items():
        if name in exclude:
            continue
        text = f"{field.description} (default: {_format_default(field)})".replace("%", "%%")
        many: dict[str, Any] = {"nargs": "+"} if _is_list(field) else {}
        group.add_argument(flag(name), metavar=_metavar(field), dest=destination(name), help=text, **many)


def read_options(model: type[Options], arguments: argparse.Namespace) -> Options:
    """Return the options of a parsed command line; raise ParameterError for an invalid one."""
    return check_options(model, given_options(model, arguments), lambda name: f"option {flag(name)}")


def given_options(model: type[Options], arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given, by field, as text."""
    named = {name: getattr(arguments, destination(name), None) for name in model.model_fields}
    return {name: text for name, text in named.items() if text is not None}


def destination(name: str) -> str:
    """Return the attribute of a parsed command line for a field, distinct from options common to all procedures."""
    return f"option_{name}"


def flag(name: str) -> str:
    """Return the command-line flag of a field."""
    return "--" + name.replace("_", "-")


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) in (tuple, list)


def _metavar(field: FieldInfo) -> str:
    annotation: Any = get_args(field.annotation)[0] if _is_list(field) else field.annotation
    kinds = [kind for kind in get_args(annotation) if kind is not NoneType]
    if get_origin(annotation) is Literal:
        return "|".join(map(str, kinds))
    return TYPE_NAMES.get(kinds[0] if kinds else annotation, "VALUE")


def _format_default(field: FieldInfo) -> str:
    default = field.get_default(call_default_factory=True, validated_data={})
    if default is PydanticUndefined:
        return "none, must be given"
    if default is None:
        return NONE
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple | list):
        return " ".join(map(str, default))
    return (default or "empty") if isinstance(default, str) else format_value(default)
