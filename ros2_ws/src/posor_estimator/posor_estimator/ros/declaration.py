"""Declares a parameter model on an rclpy node, with descriptors, and watches over changes at run time."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Generic

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from posor_estimator.errors import PosorError
from posor_estimator.ros.parameters import ParameterSpec, ParametersT, specs, validate, value_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

ROS_OWN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Parameters (or groups) that rclpy declares by itself on any node."""

_SCALARS = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_LISTS = {
    bool: Parameter.Type.BOOL_ARRAY,
    int: Parameter.Type.INTEGER_ARRAY,
    float: Parameter.Type.DOUBLE_ARRAY,
    str: Parameter.Type.STRING_ARRAY,
}


def take_overrides(node: Node) -> dict[str, object]:
    """Take the values that the user gave, by name, out of a node that declared them automatically.

    The node must have been made with ``automatically_declare_parameters_from_overrides``: that is rclpy's only public
    way to see an override nobody declared, such as a misspelt one. rclpy's own parameters are left where they are.
    """
    names = [name for name in node.get_parameters_by_prefix("") if not name.startswith(ROS_OWN)]
    overrides = {name: node.get_parameter(name).value for name in names}
    for name in overrides:
        node.undeclare_parameter(name)
    return overrides


def descriptor_of(spec: ParameterSpec) -> ParameterDescriptor:
    """Return the ROS descriptor of one declared parameter."""
    descriptor = ParameterDescriptor(
        name=spec.name,
        type=_type_of(spec).value,
        description=str(spec.field.description),
        additional_constraints=spec.constraint,
        read_only=spec.read_only,
    )
    least, greatest = spec.bounds
    if (least, greatest) != (None, None) and not spec.is_list:
        if spec.element_type is int:
            low, high = (-(2**63) if least is None else int(least)), (2**63 - 1 if greatest is None else int(greatest))
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
        elif spec.element_type is float:
            low_x, high_x = (-inf if least is None else float(least)), (inf if greatest is None else float(greatest))
            descriptor.floating_point_range = [FloatingPointRange(from_value=low_x, to_value=high_x, step=0.0)]
    return descriptor


def _type_of(spec: ParameterSpec) -> Parameter.Type:
    return (_LISTS if spec.is_list else _SCALARS)[spec.element_type]


class DeclaredParameters(Generic[ParametersT]):
    """The parameters of one node: declared at construction, then kept up to date.

    Attributes:
        current: The values in force; a new frozen model after each accepted change.

    """

    def __init__(
        self,
        node: Node,
        model: type[ParametersT],
        overrides: dict[str, object],
        *,
        accept: Callable[[ParametersT], None],
        changed: Callable[[ParametersT], None],
    ) -> None:
        """Validate ``overrides`` and declare every parameter of ``model``.

        Args:
            node: The node to declare on.
            model: Declaration of the parameters.
            overrides: The user's values by name, see ``take_overrides``.
            accept: Called with new values before a change; may raise a PosorError to refuse them.
            changed: Called with the new values after a change.

        Raises:
            ParameterError: a value is wrong or missing, or a name is unknown.

        """
        self._model = model
        self._node = node.get_fully_qualified_name()
        self._specs = {spec.name: spec for spec in specs(model)}
        self._accept = accept
        self._changed = changed
        self.current = validate(model, overrides, node=self._node)
        for spec in self._specs.values():
            _declare(node, spec, value_of(self.current, spec.name))
        node.add_pre_set_parameters_callback(self._widen)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take)

    def _with(self, changes: Sequence[Parameter]) -> ParametersT:
        values = {name: value_of(self.current, name) for name in self._specs}
        values |= {parameter.name: parameter.value for parameter in changes if parameter.name in self._specs}
        return validate(self._model, values, node=self._node)

    def _widen(self, changes: list[Parameter]) -> list[Parameter]:
        """Take an integer for a float, as at the start: ``ros2 param set`` sends 2 for 2.0."""
        return [
            Parameter(change.name, value=float(change.value))
            if change.type_ == Parameter.Type.INTEGER and self._is_float(change.name)
            else change
            for change in changes
        ]

    def _is_float(self, name: str) -> bool:
        spec = self._specs.get(name)
        return spec is not None and spec.element_type is float and not spec.is_list

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._accept(self._with(changes))
        except PosorError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take(self, changes: list[Parameter]) -> None:
        new = self._with(changes)
        if new != self.current:
            self.current = new
            self._changed(new)


def _declare(node: Node, spec: ParameterSpec, value: object) -> None:
    descriptor = descriptor_of(spec)
    if value != ():
        node.declare_parameter(spec.name, value, descriptor, ignore_override=True)
        return
    # rclpy takes every empty list for a byte array: declare by type, set while still writable, then close it.
    node.declare_parameter(spec.name, _type_of(spec), ParameterDescriptor(), ignore_override=True)
    node.set_parameters([Parameter(spec.name, _type_of(spec), [])])
    node.set_descriptor(spec.name, descriptor)
