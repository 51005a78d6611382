"""The base of every node of the stack: a lifecycle node that starts by itself unless told otherwise."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, ClassVar, Generic

from lifecycle_msgs.srv import ChangeState
from rclpy.exceptions import NameValidationException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from posor_estimator.errors import ParameterError, PosorError
from posor_estimator.ros.declaration import DeclaredParameters, take_overrides
from posor_estimator.ros.diagnostics import Diagnostics, Level
from posor_estimator.ros.parameters import ParametersT, help_text
from posor_estimator.ros.timing import STATUS as TIMING
from posor_estimator.ros.timing import Timing

if TYPE_CHECKING:
    from collections.abc import Callable


class PosorNode(LifecycleNode, Generic[ParametersT]):
    """Lifecycle node with declared parameters and diagnostics.

    A subclass names its parameter model in ``Parameters`` and fills the hooks ``configure``, ``activate`` and
    ``deactivate``. A hook that raises a PosorError refuses the transition: with ``autostart`` that ends the program
    with the error's sentence, otherwise the node stays in its former state and reports it. What ``configure`` has
    opened by then, and told ``when_cleaned_up`` of, is closed again.
    Shutting down deactivates and cleans up as far as that is due.

    Attributes:
        NAME: Default node name.
        Parameters: Model of the node's parameters.
        diagnostics: Where the node reports its health.
        timing: Where the node notes the stamp of what it has published, for the figures of its diagnostics.
        exit_requested: Whether the node wants its program to end.
        may_publish: Whether the node is active, or about to be: outlets say nothing while it is not.

    """

    NAME: ClassVar[str]
    Parameters: ClassVar[type[Any]]

    def __init__(self, **options: Any) -> None:
        """Create the node and declare its parameters.

        Args:
            options: Passed on to rclpy: ``context``, ``namespace``, ``parameter_overrides``...

        Raises:
            ParameterError: a parameter is wrong, missing or unknown.

        """
        try:
            super().__init__(self.NAME, automatically_declare_parameters_from_overrides=True, **options)
        except (RuntimeError, NameValidationException) as error:
            reason = " ".join(str(error).split(", at ")[0].split())
            raise ParameterError(reason, where=f"node {self.NAME}") from None
        self._forgive_impossible_transitions()
        self.exit_requested = self.may_publish = False
        self._failure: Exception | None = None
        self._refusal: Exception | None = None
        self._starting = False
        self._finalized = False
        self._undo = ExitStack()
        try:
            overrides = take_overrides(self)
            self._declared: DeclaredParameters[ParametersT] = DeclaredParameters(
                self,
                self.parameter_model(overrides),
                overrides,
                accept=self.accept_parameters,
                changed=self.parameters_changed,
            )
        except PosorError:
            self.destroy_node()
            raise
        self.diagnostics = Diagnostics(self, self.parameters.hardware_id)
        self._lifecycle = self.diagnostics.add("lifecycle")
        self._lifecycle.report(Level.WARN, "unconfigured")
        self.timing = Timing(self.diagnostics.add(TIMING), self.get_clock(), lambda: self.parameters.limits)
        self.diagnostics.before_each(self.timing.report)

    def _forgive_impossible_transitions(self) -> None:
        """Answer a request for a transition that does not exist here with "no"; rclpy lets it kill the program."""
        service = next(service for service in self.services if service.srv_type is ChangeState)
        change_state = service.callback

        def answer(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change_state(request, response)
            except RuntimeError as error:
                self.get_logger().error(f"transition refused: {str(error).split(', at ')[0]}")
                response.success = False
                return response

        service.callback = answer

    @property
    def parameters(self) -> ParametersT:
        """The parameters in force, an immutable model."""
        return self._declared.current

    @classmethod
    def help(cls) -> str:
        """Return what the program says about itself, from the class docstring and the declared parameters."""
        summary = (cls.__doc__ or "").strip().splitlines()[0]
        return f"{cls.NAME}: {summary}\n\nParameters (--ros-args -p name:=value):\n{help_text(cls.Parameters)}"

    @classmethod
    def parameter_model(cls, overrides: dict[str, object]) -> type[ParametersT]:
        """Return the parameter model; a subclass whose parameters depend on the user's values looks at those."""
        del overrides
        return cls.Parameters

    def accept_parameters(self, parameters: ParametersT) -> None:
        """Raise a PosorError to refuse a change at run time that the model itself allows."""

    def parameters_changed(self, parameters: ParametersT) -> None:
        """Use values that were changed at run time."""

    def configure(self) -> None:
        """Read files, create publishers, tell ``when_cleaned_up``; raise a PosorError if that is impossible."""

    def activate(self) -> None:
        """Begin to work; outlets and publishers made with ``create_lifecycle_publisher`` are active already."""

    def deactivate(self) -> None:
        """Stop working; after this nothing is published."""

    def when_cleaned_up(self, undo: Callable[..., object], *arguments: object) -> None:
        """Have something done that undoes a part of ``configure``; the last part is undone first."""
        self._undo.callback(undo, *arguments)

    def request_exit(self, failure: Exception | None = None) -> None:
        """Ask the main loop, from any thread, to end the program; with ``failure``, as one that failed.

        Of several failures the first is told.
        """
        self._failure = self._failure or failure
        self.exit_requested = True

    def raise_failure(self) -> None:
        """Raise the failure that ``request_exit`` was given, if any."""
        if self._failure is not None:
            raise self._failure

    def start(self) -> None:
        """Configure and activate if the parameter ``autostart`` says so.

        Raises:
            PosorError: a hook refused.

        """
        if not self.parameters.autostart:
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS and self._refusal is not None:
                raise self._refusal
        self._starting = False

    def stop(self) -> None:
        """Shut down through the lifecycle and destroy the node."""
        if not self._finalized:
            self.trigger_shutdown()
        self.diagnostics.close()
        self.destroy_node()
        # rclpy leaves this to the garbage collector; until then the node stays in the graph.
        self._state_machine.destroy_when_not_in_use()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook, then those of managed entities."""
        result = self._transition("inactive", self.configure, lambda: super(PosorNode, self).on_configure(state))
        if result != TransitionCallbackReturn.SUCCESS:
            self._undo.close()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the publishers, then run the hook; if it refuses, the publishers are silent again."""
        self.timing.restart()
        result = self._transition("active", lambda: self._open_up(state), self.activate)
        if result != TransitionCallbackReturn.SUCCESS:
            self._silence(state)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run the hook, then deactivate the publishers."""
        return self._transition("inactive", self.deactivate, lambda: self._silence(state))

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo what was configured, then run the hooks of managed entities."""
        return self._transition("unconfigured", self._undo.close, lambda: super(PosorNode, self).on_cleanup(state))

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo what was done, in reverse order; the program then ends."""
        due: dict[str, list[Callable[[], object]]] = {
            "active": [self.deactivate, lambda: self._silence(state), self._undo.close],
            "inactive": [self._undo.close],
        }
        steps = due.get(state.label, [])
        result = self._transition("finalized", *steps, lambda: super(PosorNode, self).on_shutdown(state))
        self._finalized = result == TransitionCallbackReturn.SUCCESS
        self.exit_requested = True
        return result

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo what was configured, after a hook has raised what is no PosorError: the node is unconfigured then."""
        self.may_publish = False
        self._undo.close()
        return super().on_error(state)

    def _open_up(self, state: LifecycleState) -> None:
        super().on_activate(state)
        self.may_publish = True

    def _silence(self, state: LifecycleState) -> None:
        self.may_publish = False
        super().on_deactivate(state)

    def _transition(self, goal: str, *steps: Callable[[], object]) -> TransitionCallbackReturn:
        try:
            for step in steps:
                step()
        except PosorError as error:
            self._refused(error, str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001  rclpy would swallow it without a word
            self._refused(error, traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self._lifecycle.report(Level.OK if goal == "active" else Level.WARN, goal)
        return TransitionCallbackReturn.SUCCESS

    def _refused(self, error: Exception, text: str) -> None:
        self._refusal = error
        self._lifecycle.report(Level.ERROR, str(error))
        if not self._starting:
            self.get_logger().error(text)
