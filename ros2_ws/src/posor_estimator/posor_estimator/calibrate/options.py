"""A procedure's options on the command line, made from the model that declares them."""

from __future__ import annotations

from types import NoneType
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import PydanticUndefined

from posor_estimator.core.calibration.entry import shown
from posor_estimator.core.calibration.sentences import first_complaint
from posor_estimator.errors import ParameterError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable

    from pydantic.fields import FieldInfo

    from posor_estimator.core.calibrate.procedure import Options

NONE = "none"


def add_options(parser: argparse.ArgumentParser, model: type[Options], *, but: Iterable[str] = ()) -> None:
    """Add one option for each field of a model, all as text; ``options_of`` makes the model of it.

    Args:
        parser: Where to.
        model: The options.
        but: Fields that are left out.

    """
    group = parser.add_argument_group("options of the procedure")
    for name, field in model.model_fields.items():
        if name in but:
            continue
        several: dict[str, Any] = {"nargs": "+"} if _is_list(field) else {}
        text = f"{field.description} (default: {_default(field)})".replace("%", "%%")
        group.add_argument(flag(name), metavar=_metavar(field), dest=destination(name), help=text, **several)


def options_of(model: type[Options], arguments: argparse.Namespace) -> Options:
    """Return the options that a command line gives.

    Raises:
        ParameterError: One is wrong.

    """
    given = {name: _read(model.model_fields[name], text) for name, text in given_options(model, arguments).items()}
    try:
        return model.model_validate(given)
    except ValidationError as error:
        complaint = first_complaint(error)
        name = str(complaint.location[0]) if complaint.location else ""
        where = f"option {flag(name)}" if name else ""
        raise ParameterError(complaint.what, where=where, expected=complaint.expected) from None


def given_options(model: type[Options], arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that were given, by field, as they were written."""
    named = {name: getattr(arguments, destination(name), None) for name in model.model_fields}
    return {name: text for name, text in named.items() if text is not None}


def destination(name: str) -> str:
    """Return where a parsed command line holds a field, apart from the options that every procedure has."""
    return f"option_{name}"


def flag(name: str) -> str:
    """Return how a field is written on the command line."""
    return "--" + name.replace("_", "-")


def _read(field: FieldInfo, text: Any) -> Any:
    return None if text == NONE and NoneType in get_args(field.annotation) else text


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) in (tuple, list)


def _metavar(field: FieldInfo) -> str:
    annotation: Any = field.annotation
    if _is_list(field):
        annotation = get_args(annotation)[0]
    kinds = [kind for kind in get_args(annotation) if kind is not NoneType]
    if get_origin(annotation) is Literal:
        return "|".join(map(str, kinds))
    if kinds:
        annotation = kinds[0]
    names: dict[Any, str] = {float: "NUMBER", int: "COUNT", bool: "true|false", str: "TEXT"}
    return names.get(annotation, "VALUE")


def _default(field: FieldInfo) -> str:
    default = field.get_default(call_default_factory=True, validated_data={})
    if default is PydanticUndefined:
        return "none, must be given"
    if default is None:
        return NONE
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, tuple | list):
        return " ".join(map(str, default))
    return "empty" if default == "" else str(default) if isinstance(default, str) else shown(default)
