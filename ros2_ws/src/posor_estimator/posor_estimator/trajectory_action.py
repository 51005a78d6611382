# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The action ``control_msgs/FollowJointTrajectory`` of correction_node, where the package control_msgs is installed.

One goal runs at a time. Its status is ACCEPTED until the result: rclpy's executor would keep a coroutine that waits for
the end of the motion busy all the time.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from posor.errors import TopicError
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from trajectory_msgs.msg import JointTrajectoryPoint

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.numerics.array_types import FloatArray
    from trajectory_msgs.msg import JointTrajectory

ACTION, PACKAGE = "follow_joint_trajectory", "control_msgs"
REPLACED = "another trajectory has replaced it"


class TrajectoryAction:
    """Serves the goals of planners.

    ``start`` starts a trajectory, and returns whether it is accepted; ``end`` ends the present one, slowing down;
    ``refuse`` reports why a goal is refused.
    """

    def __init__(
        self,
        node: Any,
        start: Callable[[JointTrajectory], bool],
        end: Callable[[], None],
        refuse: Callable[[str], None],
    ) -> None:
        self._type = import_module(f"{PACKAGE}.action").FollowJointTrajectory
        self._node, self._start, self._end, self._refuse = node, start, end, refuse
        self._goal: Any = None
        self.server = ActionServer(
            node,
            self._type,
            ACTION,
            lambda _: None,  # ``finish`` states another one for each goal
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )

    @staticmethod
    def is_installed() -> bool:
        """Return whether there is such an action on this host."""
        return find_spec(PACKAGE) is not None

    def close(self) -> None:
        """Destroy the server, of a node without an executor."""
        self.server.destroy()

    def _on_goal(self, request: Any) -> GoalResponse:
        stated = [name for name in request.get_fields_and_field_types() if name.endswith("tolerance")]
        stated = [name for name in stated if getattr(request, name) not in ([], self._type.Goal().goal_time_tolerance)]
        error = None
        if stated:
            error = TopicError(f"states {', '.join(stated)}", expected="none: the offsets have limits of their own")
        elif not request.trajectory.points or request.multi_dof_trajectory.points:
            error = TopicError("has no points of joints, or others", expected="a trajectory of the robot's joints")
        if error is not None:
            self._refuse(f"action {ACTION}: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT if self._start(request.trajectory) else GoalResponse.REJECT

    def _on_accepted(self, goal: Any) -> None:
        self._goal = goal

    def _on_cancel(self, goal: Any) -> CancelResponse:
        if goal != self._goal:
            return CancelResponse.REJECT
        self._end()
        return CancelResponse.ACCEPT

    def finish(self, reason: str = "", error: str = "PATH_TOLERANCE_VIOLATED") -> None:
        """End the present goal, if there is one; ``reason``: why it has failed, with the name of its error code.

        A node that has left its executor, because the program ends, sends no result: clients see the server vanish.
        """
        goal, self._goal = self._goal, None
        if goal is not None and self._node.executor is not None:
            result = self._type.Result(error_string=reason)
            result.error_code = getattr(result, error if reason else "SUCCESSFUL")
            goal.execute(partial(self._conclude, result))

    @staticmethod
    def _conclude(result: Any, goal: Any) -> Any:
        """Set the terminal state of a goal that has ended, and return its result."""
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.error_string:
            goal.abort()
        else:
            goal.succeed()
        return result

    def publish_feedback(self, joints: Sequence[str], desired: FloatArray, actual: FloatArray | None) -> None:
        """Publish commanded and measured angles of the present goal, if there is one; None: they are not measured."""
        if self._goal is None:
            return
        feedback = self._type.Feedback(joint_names=list(joints))
        feedback.desired = JointTrajectoryPoint(positions=desired.tolist())
        if actual is not None:
            feedback.actual = JointTrajectoryPoint(positions=actual.tolist())
            feedback.error = JointTrajectoryPoint(positions=(desired - actual).tolist())
        self._goal.publish_feedback(feedback)
