# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Declares a parameter model on an rclpy node, with descriptors, and validates changes at run time."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Generic

from posor.errors import ParameterError, PosorError
from posor.node_parameters import ParametersT
from posor.parameter_model import (
    ParameterSpec,
    check_boolean_parameters,
    parameter_specs,
    parameter_value,
    validate_parameters,
)
from posor.ros_names import ROS_BOOLEAN_PARAMETERS, ROS_OWN_PARAMETERS
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.node import Node

_TYPES = {
    bool: (Parameter.Type.BOOL, Parameter.Type.BOOL_ARRAY),
    int: (Parameter.Type.INTEGER, Parameter.Type.INTEGER_ARRAY),
    float: (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY),
    str: (Parameter.Type.STRING, Parameter.Type.STRING_ARRAY),
}
"""ROS types of a scalar and of a list."""


def take_overrides(node: Node) -> dict[str, object]:
    """Return the user's values by name, and undeclare them on a node that declared them automatically.

    The node must have been created with ``automatically_declare_parameters_from_overrides``: this is rclpy's only
    public way to see an override that nobody declares, for example a misspelt name. rclpy's own parameters stay
    declared.
    """
    names = [name for name in node.get_parameters_by_prefix("") if not name.startswith(ROS_OWN_PARAMETERS)]
    overrides = {name: node.get_parameter(name).value for name in names}
    for name in overrides:
        node.undeclare_parameter(name)
    return overrides


def descriptor_of(spec: ParameterSpec) -> ParameterDescriptor:
    """Return the ROS descriptor of a declared parameter."""
    descriptor = ParameterDescriptor(
        name=spec.name,
        type=_ros_type(spec).value,
        description=str(spec.field.description),
        additional_constraints=spec.constraint,
        read_only=spec.read_only,
    )
    low, high = spec.bound("ge", "gt"), spec.bound("le", "lt")
    if (low, high) == (None, None) or spec.is_list:
        return descriptor
    if spec.element_type is int:
        first, last = -(2**63) if low is None else int(low), 2**63 - 1 if high is None else int(high)
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last, step=0)]
    elif spec.element_type is float:
        least, greatest = -inf if low is None else float(low), inf if high is None else float(high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=least, to_value=greatest, step=0.0)]
    return descriptor


def _ros_type(spec: ParameterSpec) -> Parameter.Type:
    return _TYPES[spec.element_type][spec.is_list]


class DeclaredParameters(Generic[ParametersT]):
    """The parameters of one node, in force as ``current``: a new frozen model after each accepted change."""

    def __init__(
        self, node: Node, model: type[ParametersT], overrides: dict[str, object], *, is_configured: Callable[[], bool]
    ) -> None:
        """Validate ``overrides``, see ``take_overrides``, and declare every parameter of ``model`` on a node.

        Raises ParameterError: a value is wrong or missing, or a name is unknown.
        """
        self._model = model
        self._node = node.get_fully_qualified_name()
        self._specs = {spec.name: spec for spec in parameter_specs(model)}
        self._is_configured = is_configured
        of_rclpy = {name: node.get_parameter(name).value for name in ROS_BOOLEAN_PARAMETERS if node.has_parameter(name)}
        check_boolean_parameters(of_rclpy, node=self._node)
        self.current = validate_parameters(model, overrides, node=self._node)
        for spec in self._specs.values():
            _declare(node, spec, parameter_value(self.current, spec.name))
        node.add_pre_set_parameters_callback(self._convert)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _changed_model(self, changes: Sequence[Parameter]) -> ParametersT:
        changed = {parameter.name: parameter.value for parameter in changes if parameter.name in self._specs}
        if not changed:  # only parameters of rclpy, such as those of the quality of service
            return self.current
        values = {name: parameter_value(self.current, name) for name in self._specs} | changed
        return validate_parameters(self._model, values, node=self._node)

    def _convert(self, changes: list[Parameter]) -> list[Parameter]:
        """Convert values as at the start: ``ros2 param set`` sends 2 for 2.0, and ``[]`` as a list of booleans."""
        return [self._as_declared(change) for change in changes]

    def _as_declared(self, change: Parameter) -> Parameter:
        spec = self._specs.get(change.name)
        if spec is None or (change.value is None and not spec.is_list):
            return change
        value = spec.as_declared(change.value)
        if value == () and spec.is_list:
            return Parameter(change.name, _ros_type(spec), [])
        return Parameter(change.name, value=list(value) if isinstance(value, tuple) else value)

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._changed_model(changes)
            if self._is_configured():
                self._check_configured(changes)
        except PosorError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_configured(self, changes: list[Parameter]) -> None:
        """Raise ParameterError: a parameter cannot change while the node is configured."""
        for change in changes:
            spec = self._specs.get(change.name)
            if spec is not None and not spec.at_run_time:
                where = f"node {self._node}, parameter '{change.name}'"
                raise ParameterError(
                    "cannot change while the node is configured",
                    where=where,
                    expected="the transition 'cleanup' before",
                    parameter=change.name,
                )

    def _apply(self, changes: list[Parameter]) -> None:
        self.current = self._changed_model(changes)


def _declare(node: Node, spec: ParameterSpec, value: object) -> None:
    descriptor = descriptor_of(spec)
    if value != ():
        node.declare_parameter(spec.name, value, descriptor, ignore_override=True)
        return
    # rclpy takes an empty list for a byte array: declare by type, set while still writable, then make it read-only.
    node.declare_parameter(spec.name, _ros_type(spec), ParameterDescriptor(), ignore_override=True)
    node.set_parameters([Parameter(spec.name, _ros_type(spec), [])])
    node.set_descriptor(spec.name, descriptor)
