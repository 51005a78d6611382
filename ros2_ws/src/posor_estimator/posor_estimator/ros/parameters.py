"""One declaration of a node's parameters: a frozen pydantic model.

From the model come the types, defaults, ranges and texts that ``ros2 param describe`` shows, the checks, the
sentences that refuse a wrong value, and the text of ``--help``. A field that is itself a model is a group: field
``path`` of group ``bag`` is the ROS parameter ``bag.path``.
"""

from __future__ import annotations

import difflib
import math
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_origin

import annotated_types
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from pydantic_core import PydanticUndefined

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pydantic.fields import FieldInfo


class ChangeableAtRunTime:
    """Marker in a field's ``Annotated[...]``: may be set while the node runs. All other parameters are read-only."""


class ParameterGroup(FrozenModel):
    """Base of parameter models: frozen, strict (an integer is accepted for a float, nothing else is converted)."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=True), ChangeableAtRunTime()]


class LimitParameters(ParameterGroup):
    """Beyond which figures of a node's timing the diagnostics warn."""

    latency: _Limit = Field(
        default=math.inf, description="warn where a scan was published later than this after its stamp [s]; .inf: never"
    )
    jitter: _Limit = Field(
        default=math.inf,
        description="warn where the time between two publications was off its mean by more than this [s]; .inf: never",
    )
    pause: _Limit = Field(
        default=math.inf,
        description="warn where the garbage collector held the process up for longer than this [s]; .inf: never",
    )


class RealtimeParameters(ParameterGroup):
    """What the whole process asks of the operating system, for all of its threads."""

    priority: Annotated[int, Field(ge=0, le=99)] = Field(
        default=0, description="real-time priority (SCHED_FIFO) of the process; 0: none, share as everybody does"
    )
    cpus: tuple[int, ...] = Field(
        default=(), description="processors that the process may run on, counted from 0; empty: all"
    )
    lock_memory: bool = Field(default=False, description="keep all memory of the process from being swapped out")
    required: bool = Field(
        default=False, description="do not start if the system refuses any of this; false: warn in the diagnostics"
    )

    @field_validator("cpus", mode="before")
    @classmethod
    def _tuple(cls, cpus: object) -> object:
        return tuple(cpus) if isinstance(cpus, list) else cpus

    @field_validator("cpus")
    @classmethod
    def _not_negative(cls, cpus: tuple[int, ...]) -> tuple[int, ...]:
        if any(cpu < 0 for cpu in cpus):
            message = f"{list(cpus)} is wrong; expected numbers of processors, at least 0"
            raise ValueError(message)
        return cpus


class NodeParameters(ParameterGroup):
    """Parameters that every node has."""

    autostart: bool = Field(
        default=True, description="configure and activate at start; false: wait for the lifecycle services"
    )
    hardware_id: str = Field(
        default="", description="hardware named in the diagnostics; empty: the node's namespace, or its name"
    )
    qos_reliability: Literal["best_effort", "reliable"] = Field(
        default="best_effort", description="reliability of the sensor topics that this node publishes and subscribes to"
    )
    qos_depth: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=10, description="history depth of the sensor topics in messages; 0: keep all, for replays without loss"
    )
    limits: LimitParameters = LimitParameters()
    realtime: RealtimeParameters = RealtimeParameters()


ParametersT = TypeVar("ParametersT", bound=NodeParameters)


@dataclass(frozen=True)
class ParameterSpec:
    """One ROS parameter as its model declares it."""

    name: str
    field: FieldInfo

    @property
    def read_only(self) -> bool:
        """Whether the parameter is fixed once the node has started."""
        return not any(
            isinstance(item, ChangeableAtRunTime) or item is ChangeableAtRunTime for item in self.field.metadata
        )

    @property
    def required(self) -> bool:
        """Whether the parameter has no default."""
        return self.field.is_required()

    @property
    def element_type(self) -> type:
        """The Python type of the value, or of one element of a list."""
        annotation = self.field.annotation
        if get_origin(annotation) is tuple:
            annotation = get_args(annotation)[0]
        if get_origin(annotation) is Literal:
            annotation = type(get_args(annotation)[0])
        if not isinstance(annotation, type):
            message = f"{self.name}: {annotation} is no type of a ROS parameter"
            raise TypeError(message)
        return annotation

    @property
    def is_list(self) -> bool:
        """Whether the value is a list of elements."""
        return get_origin(self.field.annotation) is tuple

    @property
    def choices(self) -> tuple[object, ...]:
        """The values to choose from, empty when there is no such list."""
        annotation = self.field.annotation
        if self.is_list:
            annotation = get_args(annotation)[0]
        return get_args(annotation) if get_origin(annotation) is Literal else ()

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """The least and the greatest value, ``None`` where there is no bound."""
        least = greatest = None
        for item in self.field.metadata:
            least = getattr(item, "ge", getattr(item, "gt", least))
            greatest = getattr(item, "le", getattr(item, "lt", greatest))
        return least, greatest

    @property
    def constraint(self) -> str:
        """The values that are right, in words."""
        if self.choices:
            noun = "one of " + ", ".join(f"'{choice}'" for choice in self.choices)
            return f"a list, each {noun}" if self.is_list else noun
        names = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}
        plurals = {bool: "booleans", int: "integers", float: "numbers", str: "strings"}
        noun = f"a list of {plurals[self.element_type]}" if self.is_list else names[self.element_type]
        return " ".join([noun, *_bounds_in_words(self.field)])

    @property
    def default_text(self) -> str:
        """The default, as it is written on a command line."""
        default = self.field.default
        if default is PydanticUndefined:
            return "none, must be given"
        if isinstance(default, bool):
            return "true" if default else "false"
        if isinstance(default, tuple):
            return "[" + ", ".join(str(item) for item in default) + "]"
        return f"'{default}'" if isinstance(default, str) else str(default)


def _bounds_in_words(field: FieldInfo) -> Iterator[str]:
    phrases = (
        (annotated_types.Gt, "gt", "greater than {}"),
        (annotated_types.Ge, "ge", "at least {}"),
        (annotated_types.Lt, "lt", "less than {}"),
        (annotated_types.Le, "le", "at most {}"),
        (annotated_types.MinLen, "min_length", "of length {} or more"),
    )
    words = [
        phrase.format(getattr(item, attribute))
        for kind, attribute, phrase in phrases
        for item in field.metadata
        if isinstance(item, kind)
    ]
    if words:
        yield " and ".join(words)


def specs(model: type[BaseModel], prefix: str = "") -> Iterator[ParameterSpec]:
    """Yield every ROS parameter that ``model`` declares, groups flattened, in the order of declaration."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from specs(field.annotation, f"{prefix}{name}.")
        else:
            yield ParameterSpec(prefix + name, field)


def value_of(parameters: BaseModel, name: str) -> object:
    """Return the value of the ROS parameter ``name``, for instance ``bag.path``."""
    value: object = parameters
    for part in name.split("."):
        value = getattr(value, part)
    return value


def validate(model: type[ParametersT], values: Mapping[str, object], *, node: str) -> ParametersT:
    """Check ``values`` (by ROS parameter name) against ``model``.

    Raises:
        ParameterError: a value is wrong or missing, or a name is not one of the model's; names ``node``.

    """
    known = {spec.name: spec for spec in specs(model)}
    for name in values:
        if name not in known:
            nearest = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
            raise ParameterError(
                "there is no such parameter",
                where=f"node {node}, parameter '{name}'",
                expected=f"perhaps '{nearest}'",
                parameter=name,
            )
    tree: dict[str, Any] = {}
    for name in known:
        *groups, leaf = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        if name in values:
            value = values[name]
            branch[leaf] = tuple(value) if isinstance(value, list | array) else value
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise _refusal(error, known, node) from None


def _refusal(error: ValidationError, known: Mapping[str, ParameterSpec], node: str) -> ParameterError:
    """Return the sentence for the first thing that pydantic found wrong."""
    first = error.errors(include_url=False)[0]
    path = [str(part) for part in first["loc"]]
    while path and ".".join(path) not in known:
        path.pop()  # the place inside a list
    name = ".".join(path)
    where = f"node {node}, parameter '{name}'" if name else f"node {node}"
    if first["type"] == "value_error":
        return ParameterError(str(first["ctx"]["error"]), where=where, parameter=name)
    spec = known[name]
    if first["type"] == "missing":
        expected = f"{spec.constraint}: {spec.field.description}"
        return ParameterError("is not set", where=where, expected=expected, parameter=name)
    return ParameterError(f"{first['input']!r} is wrong", where=where, expected=spec.constraint, parameter=name)


def help_text(model: type[BaseModel], prefix: str = "") -> str:
    """Return a table of the parameters in plain text, from their declaration."""
    lines = []
    for spec in specs(model, prefix):
        lines.append(f"  {spec.name}: {spec.constraint} (default: {spec.default_text})")
        lines.append(f"      {spec.field.description}" + ("" if spec.read_only else " [may be set at run time]"))
    return "\n".join(lines)
