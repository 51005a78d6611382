# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The main program of one or several nodes: initialise ROS, spin until a signal or the end of all nodes, shut down."""

from __future__ import annotations

import re
import sys
from collections import deque
from contextlib import ExitStack, closing, contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any, Self

import rclpy
from posor.errors import NodeError, ParameterError, PosorError
from posor.lazy_program import interrupts_handled
from posor.node_parameters import RealtimeParameters
from posor.reporting.program_errors import reports_errors
from posor.ros_names import TOPIC_NAME_RULE
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from posor_ros.idle_scheduler import run_when_idle
from posor_ros.lifecycle_node import INPUT_CHECK_S
from posor_ros.parameter_files import parameter_files_of, refuse_octal_arguments
from posor_ros.realtime_process import PROCESS_STATUS, ProcessHealth, apply_realtime_parameters, prepare_heap
from posor_ros.service_manager import ServiceManager

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType, TracebackType

    from rclpy.node import Node

    from posor_ros.lifecycle_node import PosorNode

SPIN_TIMEOUT_S = 0.1
"""Longest time between a signal and the reaction to it: spin_once() returns after an event or this time."""


class StopSignal(ExitStack):
    """Records SIGINT, SIGTERM and SIGHUP in a ``with`` block. Further signals change nothing: launch repeats Ctrl-C.

    rclpy's own handlers would shut the context down before the nodes have published their end and closed their files.
    """

    requested = False

    def __enter__(self) -> Self:
        self.enter_context(interrupts_handled(self._on_signal))
        return self

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True


@contextmanager
def ros_context(arguments: Sequence[str]) -> Iterator[StopSignal]:
    """Initialise ROS for a ``with`` block by a command line, program name first; yield the flag that a signal sets.

    Raises ParameterError: ROS cannot parse its part of the command line, or reads a decimal number in it as octal.
    """
    with StopSignal() as stop:
        try:
            non_ros_arguments(arguments)  # fails where rclpy.init would fail, but without a log line
            refuse_octal_arguments(arguments)
            try:
                rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            except RuntimeError as error:
                raise _argument_error(error) from None
            yield stop
        finally:
            try_shutdown()


def non_ros_arguments(arguments: Sequence[str]) -> list[str]:
    """Return a command line without the program name and without ROS arguments.

    Raises ParameterError: ROS cannot parse its part.
    """
    try:
        return list(remove_ros_args(list(arguments)))[1:]
    except RuntimeError as error:
        raise _argument_error(error) from None


_RULE = re.compile(r"(parameter|remap)\b[^']* rule: '(-\S+) (.*)'\. Error:", re.DOTALL)
"""How rcl names an argument that it cannot parse; the reason follows as numbers of its parser."""
_RULES = {
    "parameter": "NAME:=VALUE, the value in YAML",
    "remap": f"OLD:=NEW, {TOPIC_NAME_RULE}; a namespace begins with '/'",
}


def _argument_error(error: RuntimeError) -> ParameterError:
    if rule := _RULE.search(str(error)):
        kind, option, given = rule.groups()
        return ParameterError(f"'{given}' cannot be understood", where=f"ROS argument {option}", expected=_RULES[kind])
    reason = " ".join(str(error).split(", at ")[0].split()).rstrip(".")
    return ParameterError(f"cannot be understood, {reason}", where="ROS arguments")


@contextmanager
def node_executor(nodes: Sequence[Any]) -> Iterator[Any]:
    """Yield an executor of the nodes; the nodes left in the end are removed."""
    executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    try:
        yield executor
    finally:
        for node in nodes:
            node.executor = None
        executor.shutdown()


def leave_executor(node: Any) -> None:
    """Remove a node from its spinning executor, until no event of the node is queued there."""
    executor = node.executor
    node.executor = None
    # The executor forgets the node's entities before the first task, and drops their queued events before the second.
    for _ in range(2):
        task = executor.create_task(lambda: None)
        while not task.done():
            executor.spin_once(timeout_sec=SPIN_TIMEOUT_S)


def spin_until(node: Node, done: Callable[[], bool]) -> None:
    """Execute the node's callbacks until ``done()``, which is polled after each event and every ``SPIN_TIMEOUT_S``."""
    with node_executor([node]) as executor:
        while not done():
            executor.spin_once(timeout_sec=SPIN_TIMEOUT_S)


class NodeGroup:
    """The nodes of this process; leaving the ``with`` block stops them, the last one first."""

    def __init__(self, realtime: RealtimeParameters | None = None) -> None:
        """Create an empty group; ``realtime`` are the settings of the process, None: those of its only node."""
        self._realtime = realtime
        self._locations: dict[PosorNode[Any], Callable[[PosorError], str]] = {}
        self._health: ProcessHealth | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop all nodes, the last one first, even if one of them raises."""
        with ExitStack() as cleanups:
            if self._health is not None:
                cleanups.callback(self._health.close)
            for node in self._locations:
                cleanups.callback(node.stop)
            self._locations = {}

    def add(self, node: PosorNode[Any], location: Callable[[PosorError], str] = lambda _: "") -> None:
        """Add a node; ``location`` returns the place in a file that causes an error of the node.

        Raises ParameterError: the node sets real-time parameters, which belong to the whole process.
        """
        self._locations[node] = location
        if self._realtime is not None and node.parameters.realtime != RealtimeParameters():
            raise ParameterError(
                "parameters 'realtime.*' are of the whole process",
                where=f"node {node.get_fully_qualified_name()}",
                expected="them under the key 'realtime' of the composition file",
            )

    def run(self, stop: Callable[[], bool]) -> None:
        """Start the nodes in the order of their addition and execute them until ``stop()``.

        A node that requests its exit, such as a driver at the end of its recording, is stopped; the others continue
        until no node is left. Raises NodeError: one of several nodes, or a node of a file, cannot start or has failed;
        PosorError: the only node cannot start or has failed; SystemRefusal: the system refuses a required setting.
        """
        several = len(self._locations) > 1
        manager = ServiceManager()
        self._report_process_health()
        with node_executor(list(self._locations)) as executor, closing(manager):
            for node, location in self._locations.items():
                if stop():
                    return
                node.stop_requested = stop
                with _name_node_in_errors(node, location, several=several):
                    node.start()
                node.check_timer.cancel()
            prepare_heap()
            manager.report_ready()
            next_check_s = 0.0
            unchecked: deque[PosorNode[Any]] = deque()
            while self._locations and not stop():
                executor.spin_once(timeout_sec=0.0 if unchecked else INPUT_CHECK_S)
                if not unchecked and (now_s := monotonic()) >= next_check_s:
                    next_check_s, unchecked = now_s + INPUT_CHECK_S, deque(self._locations)
                if unchecked:  # one at a time: messages do not wait for the checks of all nodes
                    run_when_idle(unchecked.popleft().run_checks)
                manager.report_alive()
                for node in [node for node in self._locations if node.exit_requested]:
                    leave_executor(node)
                    del self._locations[node]
                    unchecked.clear()
                    with _name_node_in_errors(node, lambda _: "", several=several):
                        node.stop()
                        node.raise_failure()
                        if several and node.was_shut_down:
                            raise PosorError("was shut down by its lifecycle", expected="'deactivate' or 'cleanup'")

    def _report_process_health(self) -> None:
        """Apply the real-time settings; the first node reports the refusals."""
        first = next(iter(self._locations))
        refusals = apply_realtime_parameters(self._realtime or first.parameters.realtime)
        for refusal in refusals:
            first.get_logger().warning(str(refusal))
        status = first.diagnostics.add_status(PROCESS_STATUS)
        self._health = ProcessHealth(status, refusals, lambda: first.parameters.limits)
        first.diagnostics.add_refresh(self._health.report)


@contextmanager
def _name_node_in_errors(
    node: PosorNode[Any], location: Callable[[PosorError], str], *, several: bool
) -> Iterator[None]:
    """Add the name of one of several nodes, and the place in a file, to an error."""
    name = node.get_fully_qualified_name()
    try:
        yield
    except PosorError as error:
        where = location(error)
        if several or where:
            raise NodeError(error, name, where) from error
        raise
    except Exception as error:
        if several:
            error.add_note(f"in node {name}")
        raise


@reports_errors
def run_node(node_class: type[PosorNode[Any]], arguments: Sequence[str] | None = None) -> int:
    """Run one node as a program, until a signal or the end of the node; return the exit code.

    ``arguments`` is the command line, program name first; None: that of this process.
    """
    arguments = sys.argv if arguments is None else arguments
    with ros_context(arguments) as stop:
        own = non_ros_arguments(arguments)
        if own in (["-h"], ["--help"]):
            sys.stdout.write(node_class.help() + "\n")
            return 0
        if own:
            raise ParameterError(
                f"argument '{own[0]}' is unknown", where=node_class.NAME, expected="--ros-args -p name:=value"
            )
        with NodeGroup() as nodes:
            nodes.add(node_class(parameter_files=parameter_files_of(arguments)))
            nodes.run(lambda: stop.requested)
    return 0
