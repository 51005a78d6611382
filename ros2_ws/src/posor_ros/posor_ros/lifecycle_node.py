# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base class of all nodes of the stack: a lifecycle node that starts by itself unless ``autostart`` is false."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from copy import copy
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal

from lifecycle_msgs.srv import ChangeState
from posor.errors import ParameterError, PosorError
from posor.node_parameters import ParametersT
from posor.parameter_model import help_text
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import NameValidationException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleNodeMixin
from rclpy.node import Node
from std_srvs.srv import Trigger

from posor_ros.declared_parameters import DeclaredParameters, take_overrides
from posor_ros.diagnostics import Diagnostics, Level
from posor_ros.idle_scheduler import run_when_idle
from posor_ros.parameter_files import check_sections
from posor_ros.publication_timing import TIMING_STATUS, Timing
from posor_ros.qos_overrides import PREFIX, QosOverrides

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from rclpy.qos import QoSProfile
    from rclpy.service import Service
    from rclpy.subscription import Subscription
    from rclpy.waitable import Waitable

INPUT_CHECK_S = 0.08  # time between two checks of the inputs
GRAPH_CHECK_EVERY = 4
"""Number of these checks after which the node also takes the events of its publishers and subscriptions and counts the
publishers of its topics. These are calls into ROS, after which the thread waits for the interpreter lock."""
STATUS_CHANGES = ("total_count_change", "current_count_change", "alive_count_change", "not_alive_count_change")
"""Fields of the events, not zero after a change."""
LISTENERS_STATUS = "listeners"
"""Name of the status line that counts the subscriptions of each topic.

A volatile publisher sends only to matched subscriptions, and no ROS call tells another program whether they have
matched. A program that starts a graph can wait for this line before a replay; then no message is lost."""


class PosorNode(LifecycleNode, Generic[ParametersT]):
    """Lifecycle node with declared parameters and diagnostics.

    A subclass sets ``NAME`` and ``Parameters`` and overrides ``configure``, ``activate`` and ``deactivate``. A hook
    that raises a PosorError refuses the transition: with ``autostart`` this ends the program with the error's sentence,
    otherwise the node stays in its former state and reports the error. The cleanups that ``configure`` has registered
    by then are run. Shutting down deactivates and cleans up as far as necessary.

    Attributes:
        NAME: Default node name.
        Parameters: Model of the node's parameters.
        diagnostics: Diagnostics of the node.
        timing: Records the stamps of published scans, for the status line ``timing``.
        exit_requested: Whether the node wants its program to end.
        was_shut_down: Whether a client of its lifecycle has shut the node down.
        qos_overrides: The user's changes of the quality of service of single topics.
        may_publish: Whether the node is active or being activated; publishers are silent otherwise.
        check_timer: Calls ``run_checks`` every ``INPUT_CHECK_S``; see there.
        stop_requested: Returns whether a signal has asked the program to end.

    """

    NAME: ClassVar[str]
    Parameters: ClassVar[type[Any]]

    def __init__(self, *, parameter_files: Sequence[Path] = (), **options: Any) -> None:
        """Create the node and declare its parameters; rclpy receives the options: ``context``, ``namespace``...

        ``parameter_files``: those of the command line, of which each must have a section for this node. Raises
        ParameterError: a parameter is wrong, missing or unknown, or a parameter file is for other nodes.
        """
        try:
            # The two steps of LifecycleNode's initialiser; the parameters decide whether the second opens services.
            Node.__init__(self, self.NAME, automatically_declare_parameters_from_overrides=True, **options)
        except (RuntimeError, NameValidationException) as error:
            reason = " ".join(str(error).split(", at ")[0].split())
            raise ParameterError(reason, where=f"node {self.NAME}") from None
        self.exit_requested = self.was_shut_down = self.may_publish = self._is_configured = False
        self.stop_requested: Callable[[], bool] = lambda: False
        self._failure: Exception | None = None
        self._refusal: Exception | None = None
        self._starting = False
        self._finalized = False
        self._cleanups = ExitStack()
        self._retired: list[Callable[[], object]] = []
        try:
            check_sections(parameter_files, [self.get_fully_qualified_name()], self.get_logger())
            overrides = take_overrides(self)
            qos_names = [name for name in self.get_parameters_by_prefix("") if name.startswith(PREFIX)]
            qos_values = {name: self.get_parameter(name).value for name in qos_names}
            for name in qos_names:  # rclpy declares it again, read-only, with the publisher or subscription
                self.undeclare_parameter(name)
            self.qos_overrides = QosOverrides(self.get_fully_qualified_name(), qos_values)
            model = self.parameter_model(overrides)
            self._declared: DeclaredParameters[ParametersT] = DeclaredParameters(
                self, model, overrides, is_configured=lambda: self._is_configured
            )
        except PosorError:
            self.destroy_node()
            raise
        self._open_lifecycle()
        self.diagnostics = Diagnostics(self, self.parameters.hardware_id)
        self._lifecycle_status = self.diagnostics.add_status("lifecycle")
        self._lifecycle_status.report(Level.WARN, "unconfigured")
        timing_status = self.diagnostics.add_status(TIMING_STATUS)
        self.timing = Timing(timing_status, self.get_clock(), lambda: self.parameters.limits)
        self.diagnostics.add_refresh(self.timing.report)
        self._listener_counts: dict[str, int] = {}
        self._input_checks: list[Callable[[], None]] = []
        self._graph_checks: list[Callable[[], None]] = [self._take_events]
        self._check_number = 0
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.check_timer = self.create_timer(INPUT_CHECK_S, lambda: run_when_idle(self.run_checks), clock=clock)

    def _open_lifecycle(self) -> None:
        """Create the state machine; without ``allow_changes``, keep only the services that read parameters.

        rcl opens all services of the lifecycle or none. The parameter services exist since the creation of the node,
        but no executor has served them yet.
        """
        allow_changes = self.parameters.allow_changes
        LifecycleNodeMixin.__init__(self, enable_communication_interface=allow_changes)
        if allow_changes:
            self._answer_impossible_transitions()
            return
        for service in list(self.services):
            if service.srv_type in (SetParameters, SetParametersAtomically):
                self.destroy_service(service)

    def _answer_impossible_transitions(self) -> None:
        """Refuse a request for a transition that the present state does not have; rclpy would end the program."""
        service = next(service for service in self.services if service.srv_type is ChangeState)
        change_state = service.callback

        def on_change_state(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change_state(request, response)
            except RuntimeError as error:
                self.get_logger().error(f"transition refused: {str(error).split(', at ')[0]}")
                response.success = False
                return response

        service.callback = on_change_state

    @property
    def parameters(self) -> ParametersT:
        """The parameters in force, an immutable model."""
        return self._declared.current

    @classmethod
    def help(cls) -> str:
        """Return the text of ``--help``, from the class docstring and the declared parameters."""
        summary = (cls.__doc__ or "").strip().splitlines()[0]
        return f"{cls.NAME}: {summary}\n\nParameters (--ros-args -p name:=value):\n{help_text(cls.Parameters)}"

    @classmethod
    def parameter_model(cls, overrides: dict[str, object]) -> type[ParametersT]:
        """Return the parameter model; a subclass may choose the model by the user's values."""
        del overrides
        return cls.Parameters

    def configure(self) -> None:
        """Read files, create publishers, register cleanups; raise a PosorError if that is impossible."""

    def activate(self) -> None:
        """Begin to work; publishers are active already."""

    def deactivate(self) -> None:
        """Stop working; nothing is published afterwards."""

    def declare_parameters(self, namespace: str, parameters: Any, *arguments: Any, **options: Any) -> Any:
        """Declare parameters; a value that is not set, as an empty list in a parameter file, may have any type."""
        dynamic = ParameterDescriptor(dynamic_typing=True)
        typed = [(name, None, dynamic) if rest[:1] == [None] else (name, *rest) for name, *rest in parameters]
        return super().declare_parameters(namespace, typed, *arguments, **options)

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any) -> Any:
        """Create a publisher; parameters ``qos_overrides.*`` may change its quality of service."""
        return super().create_publisher(
            msg_type, topic, copy(qos_profile), **self._qos_options("publisher", topic), **options
        )

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: QoSProfile | int, **options: Any
    ) -> Any:
        """Create a subscription; parameters ``qos_overrides.*`` may change its quality of service."""
        return super().create_subscription(
            msg_type, topic, callback, copy(qos_profile), **self._qos_options("subscription", topic), **options
        )

    def _qos_options(self, kind: Literal["publisher", "subscription"], topic: str) -> dict[str, Any]:
        """Return rclpy's argument for the overrides; empty before the overrides are known."""
        if "qos_overrides" not in self.__dict__:
            return {}
        return {"qos_overriding_options": self.qos_overrides.options(kind, self.resolve_topic_name(topic))}

    def add_cleanup(self, cleanup: Callable[..., object], *arguments: object) -> None:
        """Register a function that undoes a part of ``configure``; the last one runs first."""
        self._cleanups.callback(cleanup, *arguments)

    def add_input_check(self, check: Callable[[], None]) -> None:
        """Have the executor's thread call a short function every ``INPUT_CHECK_S``; it must not call into ROS."""
        self._input_checks.append(check)

    def remove_input_check(self, check: Callable[[], None]) -> None:
        """Undo ``add_input_check``."""
        self._input_checks.remove(check)

    def add_graph_check(self, check: Callable[[], None]) -> None:
        """Have the executor's thread call a function before every ``GRAPH_CHECK_EVERY``th check of the inputs."""
        self._graph_checks.append(check)

    def run_checks(self) -> None:
        """Check the inputs and, at times, the graph.

        A `NodeGroup` calls ``run_checks`` of all its nodes in one pass and cancels their timers, because waking the
        executor costs more than the checks. The timer remains for a node outside of a `NodeGroup`.
        """
        self._check_number += 1
        if self._check_number % GRAPH_CHECK_EVERY == 0:
            for check in self._graph_checks:
                check()
        for check in self._input_checks:
            check()

    def add_change_service(self, name: str, callback: Callable[[Any, Any], Any], kind: type[Any] = Trigger) -> None:
        """Open the service ``~/name``, which changes state, until the clean-up; ``kind``: class of the service.

        Without the parameter ``allow_changes`` it is not opened.
        """
        if self.parameters.allow_changes:
            self.add_cleanup(self.destroy_service, self.create_service(kind, f"~/{name}", callback))

    def report_listeners(self, topic: str, count: int) -> None:
        """Report the number of subscriptions of a topic of this node, in any process."""
        if not self._listener_counts:
            self._listeners_status = self.diagnostics.add_status(LISTENERS_STATUS)
        self._listener_counts[topic] = count
        counts = ", ".join(f"{topic} {count}" for topic, count in self._listener_counts.items())
        self._listeners_status.report(Level.OK, f"subscriptions: {counts}", self._listener_counts)

    def is_stopping(self) -> bool:
        """Return whether the node is about to stop, so that it must not wait for others any longer."""
        return self.stop_requested()

    def request_exit(self, failure: Exception | None = None) -> None:
        """Request the end of the program, from any thread; ``raise_failure`` raises the first ``failure``."""
        self._failure = self._failure or failure
        self.exit_requested = True

    def raise_failure(self) -> None:
        """Raise the failure passed to ``request_exit``, if any."""
        if self._failure is not None:
            raise self._failure

    def start(self) -> None:
        """Configure and activate the node if ``autostart`` is true. Raises PosorError: a hook refused."""
        if not self.parameters.autostart:
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS and self._refusal is not None:
                raise self._refusal
        self._starting = False

    def stop(self) -> None:
        """Shut down through the lifecycle and destroy the node; it has no executor any more, see ``leave_executor``."""
        for destroy in self._retired:
            destroy()
        if not self._finalized:
            self.trigger_shutdown()
        self.diagnostics.close()
        self.destroy_node()
        # rclpy leaves this to the garbage collector; until then the node stays in the graph.
        self._state_machine.destroy_when_not_in_use()

    @property
    def waitables(self) -> Iterator[Waitable]:
        """No waitables: ``EventsExecutor`` crashes if it removes one with a queued event, see ``_take_events``."""
        return iter(())

    def _take_events(self) -> None:
        """Call the event callbacks of publishers and subscriptions whose status has changed since the last call."""
        entities: list[Any] = [*self.publishers, *self.subscriptions]
        for entity in entities:
            for handler in entity.event_handlers:
                handler._ready_to_take_data = True  # noqa: SLF001  as the wait set of other executors does
                event = handler.take_data()
                if any(getattr(event, change, 0) for change in STATUS_CHANGES):
                    handler.callback(event)

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription, see ``_retire``; return whether it was one of this node."""
        self._retire(subscription)
        return super().destroy_subscription(subscription)

    def destroy_service(self, service: Service) -> bool:
        """Destroy a service, see ``_retire``; return whether it was one of this node."""
        self._retire(service)
        return super().destroy_service(service)

    def _retire(self, entity: Any) -> None:
        """Destroy an entity that the node forgets now once no event of it is queued in the executor.

        ``EventsExecutor`` drops a queued event if it does not know the address of the entity. A new entity may have the
        address of a destroyed one; the event would then reach the destroyed one and crash the process.

        The executor forgets the entity in its next step, before the first task; the second task runs after the events
        that were queued until then.
        """
        executor, destroy = self.executor, entity.destroy
        if executor is None:
            return

        def destroy_retired() -> None:
            self._retired.remove(destroy)
            destroy()

        entity.destroy = lambda: None
        self._retired.append(destroy)
        executor.create_task(executor.create_task, destroy_retired)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run ``configure``, then the hooks of managed entities."""
        result = self._run_steps(
            "inactive",
            self.configure,
            self.qos_overrides.check_names,
            lambda: super(PosorNode, self).on_configure(state),
        )
        self._is_configured = result == TransitionCallbackReturn.SUCCESS
        if not self._is_configured:
            self._cleanups.close()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the publishers, then run ``activate``; if it refuses, the publishers are deactivated."""
        self.timing.restart()
        result = self._run_steps("active", lambda: self._activate_publishers(state), self.activate)
        if result == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info("ready")
        else:
            self._deactivate_publishers(state)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run ``deactivate``, then deactivate the publishers."""
        return self._run_steps("inactive", self.deactivate, lambda: self._deactivate_publishers(state))

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the cleanups, then the hooks of managed entities."""
        result = self._run_steps("unconfigured", self._cleanups.close, lambda: super(PosorNode, self).on_cleanup(state))
        self._is_configured = self._is_configured and result != TransitionCallbackReturn.SUCCESS
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up as far as the state requires; the program then ends."""
        steps: dict[str, list[Callable[[], object]]] = {
            "active": [self.deactivate, lambda: self._deactivate_publishers(state), self._cleanups.close],
            "inactive": [self._cleanups.close],
        }
        result = self._run_steps(
            "finalized", *steps.get(state.label, []), lambda: super(PosorNode, self).on_shutdown(state)
        )
        self._finalized = result == TransitionCallbackReturn.SUCCESS
        self.was_shut_down = not (self.exit_requested or self.is_stopping())
        self.exit_requested = True
        return result

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up after a hook has raised an unexpected exception; the node is then unconfigured."""
        self.may_publish = self._is_configured = False
        self._cleanups.close()
        return super().on_error(state)

    def _activate_publishers(self, state: LifecycleState) -> None:
        super().on_activate(state)
        self.may_publish = True

    def _deactivate_publishers(self, state: LifecycleState) -> None:
        self.may_publish = False
        super().on_deactivate(state)

    def _run_steps(self, goal: str, *steps: Callable[[], object]) -> TransitionCallbackReturn:
        try:
            for step in steps:
                step()
        except PosorError as error:
            self._report_refusal(error, str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001  rclpy would discard it silently
            self._report_refusal(error, traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self._lifecycle_status.report(Level.OK if goal == "active" else Level.WARN, goal)
        return TransitionCallbackReturn.SUCCESS

    def _report_refusal(self, error: Exception, text: str) -> None:
        self._refusal = error
        self._lifecycle_status.report(Level.ERROR, str(error))
        if not self._starting:
            self.get_logger().error(text)
