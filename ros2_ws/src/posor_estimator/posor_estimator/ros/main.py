"""The main program of one node or of several: initialise, spin until a signal or until they are done, end cleanly."""

from __future__ import annotations

import re
import signal
import sys
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Self

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args, try_shutdown

from posor_estimator.errors import NodeError, ParameterError, PosorError
from posor_estimator.ros.parameters import RealtimeParameters
from posor_estimator.ros.process import STATUS as PROCESS
from posor_estimator.ros.process import ProcessHealth, settle
from posor_estimator.ros.realtime import ask_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType, TracebackType

    from rclpy.node import Node

    from posor_estimator.ros.node import PosorNode

WAKE_S = 0.1
"""Longest time between a signal and the reaction to it: nothing but an event or a timeout ends spin_once()."""


class StopSignal:
    """Remembers that SIGINT or SIGTERM came; a second one ends the program at once.

    rclpy's own handlers would shut the context down under a node that has yet to say good-bye and close its files.
    """

    def __init__(self) -> None:
        self.requested = False
        self._former = {number: signal.signal(number, self._handle) for number in (signal.SIGINT, signal.SIGTERM)}

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.requested:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        self.requested = True

    def restore(self) -> None:
        """Put the former handlers back."""
        for number, handler in self._former.items():
            signal.signal(number, handler)


@contextmanager
def ros(arguments: Sequence[str]) -> Iterator[StopSignal]:
    """Initialise ROS for the duration of a ``with`` block; yields the flag that a signal sets.

    Args:
        arguments: The command line, program name first.

    Raises:
        ParameterError: ROS cannot read its part of the command line.

    """
    stop = StopSignal()
    try:
        own_arguments(arguments)  # fails on what rclpy.init would fail on, but without a log line
        try:
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise _not_understood(error) from None
        yield stop
    finally:
        try_shutdown()
        stop.restore()


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """Return what is left of a command line without the program name and without what is meant for ROS.

    Raises:
        ParameterError: ROS cannot read its part.

    """
    try:
        return list(remove_ros_args(list(arguments)))[1:]
    except RuntimeError as error:
        raise _not_understood(error) from None


_RULE = re.compile(r"(parameter|remap)\b[^']* rule: '(-\S+) (.*)'\. Error:", re.DOTALL)
"""How rcl tells which of the arguments it cannot read; why, it tells by numbers of its own parser."""
_RULES = {"parameter": "NAME:=VALUE, the value in YAML", "remap": "OLD:=NEW"}


def _not_understood(error: RuntimeError) -> ParameterError:
    if rule := _RULE.search(str(error)):
        kind, option, given = rule.groups()
        return ParameterError(f"'{given}' cannot be understood", where=f"ROS argument {option}", expected=_RULES[kind])
    reason = " ".join(str(error).split(", at ")[0].split()).rstrip(".")
    return ParameterError(f"cannot be understood, {reason}", where="ROS arguments")


@contextmanager
def executor_of(nodes: Sequence[Node]) -> Iterator[Any]:
    """Yield an executor of the nodes; it forgets those that it still has in the end."""
    executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    try:
        yield executor
    finally:
        for node in executor.get_nodes():
            executor.remove_node(node)
        executor.shutdown()


def spin(node: Node, done: Callable[[], bool]) -> None:
    """Execute the node's callbacks until ``done()``; it is asked after each event, at least every ``WAKE_S``."""
    with executor_of([node]) as executor:
        while not done():
            executor.spin_once(timeout_sec=WAKE_S)


def _nowhere(_error: PosorError) -> str:
    """Return that no file asks for a node."""
    return ""


class Nodes:
    """The nodes of this process; leaving the ``with`` block stops them, the last one first."""

    def __init__(self, realtime: RealtimeParameters | None = None) -> None:
        """Have none yet.

        Args:
            realtime: What the process asks of the system; None: what its only node's parameters say.

        """
        self._realtime = realtime
        self._nodes: list[PosorNode[Any]] = []
        self._places: dict[PosorNode[Any], Callable[[PosorError], str]] = {}
        self._health: ProcessHealth | None = None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop all nodes, the last one first, even if one of them raises."""
        with ExitStack() as everything:
            if self._health is not None:
                everything.callback(self._health.close)
            for node in self._nodes:
                everything.callback(node.stop)
            self._nodes = []

    def add(self, node: PosorNode[Any], place: Callable[[PosorError], str] = _nowhere) -> None:
        """Take a node into the process.

        Args:
            node: The node.
            place: Tells where a file asks for what keeps the node from starting.

        Raises:
            ParameterError: It asks for itself what is the process's to ask.

        """
        self._nodes.append(node)
        self._places[node] = place
        if self._realtime is not None and node.parameters.realtime != RealtimeParameters():
            raise ParameterError(
                "parameters 'realtime.*' are of the whole process",
                where=f"node {node.get_fully_qualified_name()}",
                expected="them under the key 'realtime' of the composition file",
            )

    def run(self, stop: Callable[[], bool]) -> None:
        """Start the nodes in the order in which they were added, and execute them until ``stop()``.

        A node that is done, such as a driver at the end of its record, is stopped; the others go on. When all are done,
        so is this.

        Raises:
            NodeError: One of several nodes, or one that a file asks for, cannot start or has failed; names it.
            PosorError: The only one cannot start, or has failed.
            SystemRefusal: The system refuses what is required of it.

        """
        several = len(self._nodes) > 1
        self._watch_process()
        with executor_of(self._nodes) as executor:
            for node in self._nodes:
                with _named(node, several=several, place=self._places[node]):
                    node.start()
            settle()
            while self._nodes and not stop():
                executor.spin_once(timeout_sec=WAKE_S)
                for node in [node for node in self._nodes if node.exit_requested]:
                    executor.remove_node(node)
                    self._nodes.remove(node)
                    with _named(node, several=several):
                        node.stop()
                        node.raise_failure()

    def _watch_process(self) -> None:
        """Ask the system for what is wanted, and have the first node tell what became of it."""
        first = self._nodes[0]
        refusals = ask_for(first.parameters.realtime if self._realtime is None else self._realtime)
        for refusal in refusals:
            first.get_logger().warning(str(refusal))
        self._health = ProcessHealth(first.diagnostics.add(PROCESS), refusals, lambda: first.parameters.limits)
        first.diagnostics.before_each(self._health.report)


@contextmanager
def _named(node: PosorNode[Any], *, several: bool, place: Callable[[PosorError], str] = _nowhere) -> Iterator[None]:
    """Say which of several nodes an error is of, and what place in a file it is due to."""
    name = node.get_fully_qualified_name()
    try:
        yield
    except PosorError as error:
        where = place(error)
        if several or where:
            raise NodeError(error, name, where) from error
        raise
    except Exception as error:
        if several:
            error.add_note(f"in node {name}")
        raise


def exit_code_of(program: Callable[[], None]) -> int:
    """Run ``program``; return 0, or after a PosorError, whose sentence goes to stderr, the error's exit code."""
    try:
        program()
    except PosorError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def run(node_class: type[PosorNode[Any]], arguments: Sequence[str] | None = None) -> int:
    """Run one node as a program, until a signal comes or the node is done.

    Args:
        node_class: The node.
        arguments: The command line, program name first; ``None``: that of this process.

    Returns:
        The exit code.

    """
    return exit_code_of(lambda: _run(node_class, sys.argv if arguments is None else arguments))


def _run(node_class: type[PosorNode[Any]], arguments: Sequence[str]) -> None:
    with ros(arguments) as stop:
        own = own_arguments(arguments)
        if own in (["-h"], ["--help"]):
            sys.stdout.write(node_class.help() + "\n")
            return
        if own:
            raise ParameterError(
                f"argument '{own[0]}' is unknown", where=node_class.NAME, expected="--ros-args -p name:=value"
            )
        with Nodes() as nodes:
            nodes.add(node_class())
            nodes.run(lambda: stop.requested)
