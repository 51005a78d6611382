# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in the test's own process: composed nodes with intra-process delivery, and a node that refuses to start."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self, TypeVar

import rclpy
from posor_ros.lifecycle_node import PosorNode
from posor_ros.node_program import leave_executor, run_node
from posor_ros.ros_arguments import ros_arguments
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pytest

NodeT = TypeVar("NodeT", bound=PosorNode[Any])


class NodeProcess:
    """Nodes of one rclpy context. Two contexts reach each other only over DDS, as two processes."""

    def __init__(self) -> None:
        """Create a context without nodes."""
        self._context = Context()
        rclpy.init(context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self.nodes: list[PosorNode[Any]] = []

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the nodes, the last one first."""
        for node in reversed(self.nodes):
            leave_executor(node)
            node.stop()
        self._executor.shutdown()
        self._context.try_shutdown()

    def start(
        self, node_class: type[NodeT], namespace: str = "", parameters: Mapping[str, object] | None = None
    ) -> NodeT:
        """Return a new active node."""
        overrides = [Parameter(name, value=value) for name, value in (parameters or {}).items()]
        node = node_class(context=self._context, namespace=namespace, parameter_overrides=overrides)
        self.nodes.append(node)
        node.start()
        self._executor.add_node(node)
        return node

    def spin_once(self) -> None:
        """Execute one event, or let a short time pass."""
        self._executor.spin_once(timeout_sec=0.01)


def run_refused_node(
    node_class: type[PosorNode[Any]],
    parameters: Mapping[str, object],
    capfd: pytest.CaptureFixture[str],
    namespace: str = "",
) -> tuple[int, list[str]]:
    """Run the program of a node that ends by itself; return its exit code and the lines of standard error.

    ``capfd`` is pytest's fixture, which captures the ROS log as well.

    Raises AssertionError: the node wrote to standard output.
    """
    capfd.readouterr()
    code = run_node(node_class, [node_class.NAME, *ros_arguments(parameters, namespace)])
    out, err = capfd.readouterr()
    if out:
        raise AssertionError(f"standard output has '{out}'")
    return code, err.splitlines()
