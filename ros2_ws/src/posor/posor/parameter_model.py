# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Node parameters as frozen pydantic models, independent of rclpy.

A field declares one ROS parameter: type, default, range and description. The validation, the error messages, the
descriptors of ``ros2 param describe`` and the text of ``--help`` follow from it. A field that is a model is a group:
field ``path`` of group ``bag`` is the ROS parameter ``bag.path``.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticUndefined

from posor.calibration.file_model import FrozenModel, format_value
from posor.errors import ParameterError, similar_name, sum_up
from posor.ros_names import ROS_BOOLEAN_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails

ModelT = TypeVar("ModelT", bound=BaseModel)

_NOUNS = {
    bool: ("true or false", "booleans"),
    int: ("an integer", "integers"),
    float: ("a number", "numbers"),
    str: ("a string", "strings"),
}
REPLACED = {"covariance": "none: 'covariance_random' and 'covariance_systematic' are always published"}
"""What replaced a parameter that no longer exists."""
_BOUNDS = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most", "min_length": "of length"}


class ChangeableAtRunTime:
    """Marker in a field's ``Annotated[...]``: may be set while the node runs.

    A parameter without a marker may be set while the node is unconfigured.
    """


class FixedAtStart:
    """Marker in a field's ``Annotated[...]``: read-only, because the process or the node itself is made by it."""


class ParameterGroup(FrozenModel):
    """Base of parameter models: frozen, finite, strict; ``as_declared`` states what is converted."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class ParameterSpec:
    """One ROS parameter as its model declares it."""

    name: str
    field: FieldInfo

    @property
    def read_only(self) -> bool:
        """Whether the parameter is fixed once the node has started."""
        return self._is_marked(FixedAtStart)

    @property
    def at_run_time(self) -> bool:
        """Whether the parameter may be set while the node is configured."""
        return self._is_marked(ChangeableAtRunTime)

    def _is_marked(self, marker: type) -> bool:
        return any(marker in (item, type(item)) for item in self.field.metadata)

    @property
    def required(self) -> bool:
        """Whether the parameter has no default."""
        return self.field.is_required()

    @property
    def is_list(self) -> bool:
        """Whether the value is a list of elements."""
        return get_origin(self.field.annotation) is tuple

    @property
    def choices(self) -> tuple[object, ...]:
        """The permitted values, empty where the type alone decides."""
        annotation = self._element_annotation
        return get_args(annotation) if get_origin(annotation) is Literal else ()

    @property
    def element_type(self) -> type:
        """The Python type of the value, or of one element of a list."""
        element = type(self.choices[0]) if self.choices else self._element_annotation
        if not isinstance(element, type):
            message = f"{self.name}: {element} is no type of a ROS parameter"
            raise TypeError(message)
        return element

    @property
    def _element_annotation(self) -> Any:
        return get_args(self.field.annotation)[0] if self.is_list else self.field.annotation

    @property
    def when(self) -> str:
        """When the parameter may be set after the start, in words; empty: while the node is unconfigured."""
        return "at run time" if self.at_run_time else "only at the start" if self.read_only else ""

    def as_declared(self, value: object) -> object:
        """Return a value with the type of the parameter where no information is lost; any other value as received.

        A list becomes a tuple, a value that is not set an empty list, an integer a float, and a float without
        fraction an integer: YAML and command lines write 2 for 2.0, ``[]`` has no type, and some tools write 2.0 for 2.
        """
        if self.is_list and value is None:
            return ()
        if self.is_list:
            return tuple(map(self._element, value)) if isinstance(value, list | tuple | array) else value
        return self._element(value)

    def _element(self, value: object) -> object:
        if self.element_type is float and type(value) is int:
            return float(value)
        if self.element_type is int and isinstance(value, float) and value.is_integer():
            return int(value)
        return value

    def bound(self, *kinds: str) -> float | None:
        """Return the bound of the first of the kinds (``ge``, ``gt``, ``le``, ``lt``) that the field has, if any."""
        bounds = (getattr(item, kind, None) for kind in kinds for item in self.field.metadata)
        return next((bound for bound in bounds if bound is not None), None)

    @property
    def constraint(self) -> str:
        """The permitted values, in words."""
        if self.choices:
            noun = "one of " + ", ".join(f"'{choice}'" for choice in self.choices)
            return f"a list, each {noun}" if self.is_list else noun
        singular, plural = _NOUNS[self.element_type]
        bounds = [
            f"{words} {bound}" + (" or more" if kind == "min_length" else "")
            for kind, words in _BOUNDS.items()
            if (bound := self.bound(kind)) is not None
        ]
        return " ".join([f"a list of {plural}" if self.is_list else singular, " and ".join(bounds)]).rstrip()

    @property
    def default_text(self) -> str:
        """The default, as written on a command line."""
        default = self.field.default
        if default is PydanticUndefined:
            return "none, must be given"
        if isinstance(default, bool):
            return str(default).lower()
        if isinstance(default, tuple):
            return "[" + ", ".join(map(str, default)) + "]"
        return f"'{default}'" if isinstance(default, str) else str(default)


def parameter_specs(model: type[BaseModel], prefix: str = "") -> Iterator[ParameterSpec]:
    """Yield every ROS parameter that ``model`` declares, groups flattened, in the order of declaration."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from parameter_specs(field.annotation, f"{prefix}{name}.")
        else:
            yield ParameterSpec(prefix + name, field)


def parameter_value(parameters: BaseModel, name: str) -> object:
    """Return the value of the ROS parameter ``name``, for instance ``bag.path``."""
    value: object = parameters
    for part in name.split("."):
        value = getattr(value, part)
    return value


def validate_parameters(model: type[ModelT], values: Mapping[str, object], *, node: str) -> ModelT:
    """Check ``values``, by ROS parameter name, against ``model``.

    Raises ParameterError: a value is wrong or missing, or a name is unknown; names ``node``.
    """
    known = {spec.name: spec for spec in parameter_specs(model)}
    errors = []
    for name in values:
        if name not in known:
            where = f"node {node}, parameter '{name}'"
            expected = REPLACED.get(name) or similar_name(name, known, "a parameter of the node", least=0.0)
            errors.append(ParameterError("there is no such parameter", where=where, expected=expected, parameter=name))
    tree: dict[str, Any] = {}
    for name, spec in known.items():
        *groups, leaf = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        if name in values:
            branch[leaf] = spec.as_declared(values[name])
    try:
        parameters = model.model_validate(tree)
    except ValidationError as error:
        found = [_parameter_error(details, known, node) for details in error.errors(include_url=False)]
        meant = {each.expected for each in errors}  # by a misspelt name, so that its parameter is not set
        errors += [each for each in found if f"perhaps '{each.parameter}'" not in meant]
    if errors:
        raise sum_up(errors)
    return parameters


def check_boolean_parameters(values: Mapping[str, object], *, node: str) -> None:
    """Raise ParameterError: a boolean parameter that rclpy declares is not true or false; rclpy would ignore it."""
    for name in ROS_BOOLEAN_PARAMETERS:
        if not isinstance(values.get(name, False), bool):
            where = f"node {node}, parameter '{name}'"
            raise ParameterError(format_value(values[name]), where=where, expected=_NOUNS[bool][0], parameter=name)


def _parameter_error(details: ErrorDetails, known: Mapping[str, ParameterSpec], node: str) -> ParameterError:
    path = [str(part) for part in details["loc"]]
    while path and ".".join(path) not in known:
        path.pop()  # an index within a list
    name = ".".join(path)
    where = f"node {node}, parameter '{name}'" if name else f"node {node}"
    if details["type"] == "value_error":
        return ParameterError(str(details["ctx"]["error"]), where=where, parameter=name)
    spec = known[name]
    if details["type"] == "missing":
        expected = f"{spec.constraint}: {spec.field.description}"
        return ParameterError("is not set", where=where, expected=expected, parameter=name)
    return ParameterError(f"{details['input']!r} is wrong", where=where, expected=spec.constraint, parameter=name)


def help_text(model: type[BaseModel], prefix: str = "") -> str:
    """Return the parameters of a model as plain text."""
    lines = []
    for spec in parameter_specs(model, prefix):
        lines.append(f"  {spec.name}: {spec.constraint} (default: {spec.default_text})")
        lines.append(f"      {spec.field.description}" + (f" [may be set {spec.when}]" if spec.when else ""))
    return "\n".join(lines)
