# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""EndpointState of chain_node, as a plain subscriber sees it, and checks of the transforms that it receives."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from posor.messages.joint_transform import stamp_ns_of
from posor.numerics.stamps import NS
from posor_lab.harness.graph import Graph, wait_for_value
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.ros_arguments import ros_arguments
from posor_ros.throttled_publisher import PERIOD_NS
from rclpy.qos import QoSProfile

from .chain_program import PLATES, RANDOM_SHARE, URDF, lost_transform, transform_of
from .live_topics import PERIOD_S, POSOR, ScanSender

pytestmark = pytest.mark.usefixtures("ros_domain")

CHAIN = {"urdf": str(URDF), "lossless": True}
SOUND_COVARIANCE = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 4.0]) * 1e-12


class Rig:
    """A chain_node with the limits of a live source, and a subscriber to its state."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.states: list[Any] = []
        self.arrivals: list[float] = []
        graph.node.create_subscription(EndpointState, "endpoint/state", self._on_state, QoSProfile(depth=10))
        graph.watch_diagnostics()
        self.publisher = graph.publisher(JointTransform, "joint1/transform")
        graph.wait_until(lambda: bool(self.states), "a state")

    def _on_state(self, state: Any) -> None:
        self.states.append(state)
        self.arrivals.append(time.monotonic())

    def send(self, message: Any, age_s: float = 0.0) -> int:
        """Publish a transform with a stamp of this age; return the stamp [ns]."""
        now_ns = time.time_ns() - round(age_s * NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, NS)
        self.publisher.publish(message)
        return now_ns

    def state_of(self, message: Any, age_s: float = 0.0) -> Any:
        """Return the state of a scan that consists of one transform."""
        wanted = self.send(message, age_s)
        self.graph.wait_until(lambda: any(stamp_ns(state) == wanted for state in self.states), "the state")
        return next(state for state in self.states if stamp_ns(state) == wanted)

    def wait_for_state(self, state: int) -> Any:
        """Return the next state of a kind."""
        self.states.clear()
        self.graph.wait_until(lambda: any(each.state == state for each in self.states), f"state {state}")
        return next(each for each in self.states if each.state == state)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    command = [*installed("posor_estimator", "chain_node"), *ros_arguments(CHAIN)]
    with Program(command) as node, Graph() as graph:
        yield Rig(graph)
        assert node.end() == 0


def has_pose(state: Any) -> bool:
    """Return whether the numbers of a state are all finite; all NaN otherwise."""
    position, orientation = state.pose.position, state.pose.orientation
    numbers = np.array([position.x, position.y, position.z, orientation.x, orientation.w])
    numbers = np.concatenate([numbers, state.covariance_random, state.covariance_systematic])
    assert np.isfinite(numbers).all() or np.isnan(numbers).all()
    return bool(np.isfinite(numbers[0]))


def test_before_the_first_scan_the_state_is_stale_without_an_age(rig: Rig) -> None:
    state = rig.wait_for_state(EndpointState.STATE_STALE)
    assert (state.header.stamp.sec, state.joint, state.faults) == (0, "joint1", 0)
    assert (state.header.frame_id, state.child_frame_id) == ("machining_centre", "endpoint")
    assert state.reason.startswith("no input on /joint1/transform since activation")
    assert math.isnan(state.age)
    assert not has_pose(state)
    assert np.isnan(state.protection_level).all()


def test_a_sound_scan_has_a_pose_an_age_and_no_reason(rig: Rig) -> None:
    state = rig.state_of(transform_of(1))
    assert (state.state, state.faults, state.joint, state.reason) == (EndpointState.STATE_OK, 0, "", "")
    assert has_pose(state)
    assert 0.0 <= state.age < 1.0
    assert state.pose.position.x == pytest.approx(-0.84836)
    random, systematic = (np.reshape(each, (6, 6)) for each in (state.covariance_random, state.covariance_systematic))
    assert random[4, 4] == pytest.approx(RANDOM_SHARE * 4e-12, rel=1e-9)
    assert systematic[4, 4] == pytest.approx((1.0 - RANDOM_SHARE) * 4e-12, rel=1e-9)


def test_a_single_lost_scan_is_a_warning_and_several_in_a_row_an_error(rig: Rig) -> None:
    """Runs before the other tests have lost more scans than false alarms explain."""

    def send_after_sound_scan(lost: int, level: bytes) -> set[bytes]:
        rig.state_of(transform_of(1))
        rig.graph.wait_for_status("/chain_node: endpoint", "ok")
        rig.graph.diagnostics.clear()
        for _ in range(lost):
            rig.send(lost_transform(1, JointTransform.FAULT_RESIDUAL))
            time.sleep(0.001)
        name, text = "/chain_node: endpoint", "no pose: joint1 is lost (RESIDUAL)"

        def levels() -> set[bytes]:
            return {s.level for s in rig.graph.diagnostics if s.name == name and text in s.message}

        rig.graph.wait_until(lambda: level in levels(), f"level {level!r}")
        rig.state_of(transform_of(1))
        return levels()

    assert send_after_sound_scan(1, b"\x01") == {b"\x01"}
    assert b"\x02" in send_after_sound_scan(5, b"\x02")


def test_the_throttled_topic_has_every_change_and_the_first_scan_of_each_period(rig: Rig) -> None:
    throttled: list[Any] = rig.graph.collect(EndpointState, "endpoint/state_throttle")
    rig.graph.wait_until(lambda: bool(throttled), "a throttled state", lambda: rig.send(transform_of(1)))
    degraded = transform_of(1)
    degraded.state, degraded.faults = JointTransform.STATE_DEGRADED, JointTransform.FAULT_FLAGGED
    rig.states.clear()
    begin_ns, due = stamp_ns(rig.state_of(transform_of(1))), list[tuple[int, int, str]]()
    while len(due) < 6 or len(rig.states) < 2 * len(due):
        rig.state_of(degraded if len(due) == 2 else transform_of(1))
        keys = [(stamp_ns(each), each.state, each.reason) for each in rig.states]
        due = [new for old, new in pairwise(keys) if (old[0] // PERIOD_NS, *old[1:]) != (new[0] // PERIOD_NS, *new[1:])]

    def received() -> list[tuple[int, int, str]]:
        return [(stamp_ns(each), each.state, each.reason) for each in throttled if stamp_ns(each) > begin_ns]

    rig.graph.wait_until(lambda: received()[-1:] == due[-1:], "the throttled states")
    assert received() == [each for each in due if each[0] > begin_ns]
    assert {each[1] for each in due} >= {EndpointState.STATE_OK, EndpointState.STATE_DEGRADED}


def test_a_degraded_joint_shows_with_its_faults(rig: Rig) -> None:
    degraded = transform_of(1)
    degraded.state, degraded.faults = JointTransform.STATE_DEGRADED, JointTransform.FAULT_FLAGGED
    state = rig.state_of(degraded)
    assert (state.state, state.faults) == (EndpointState.STATE_DEGRADED, JointTransform.FAULT_FLAGGED)
    assert (state.joint, state.reason) == ("joint1", "degraded: joint1 (FLAGGED)")
    assert has_pose(state)


@pytest.mark.parametrize(
    ("joint_state", "expected", "reason"),
    [
        (JointTransform.STATE_LOST, EndpointState.STATE_LOST, "joint1 is lost (SOURCE|LATCHED)"),
        (JointTransform.STATE_UNCOUNTED, EndpointState.STATE_UNCOUNTED, "joint1 is uncounted (SOURCE|LATCHED)"),
        (200, EndpointState.STATE_LOST, "joint1 has the unknown state 200 (SOURCE|LATCHED)"),
    ],
)
def test_an_unusable_joint_is_named_with_its_faults(rig: Rig, joint_state: int, expected: int, reason: str) -> None:
    faults = JointTransform.FAULT_SOURCE | JointTransform.FAULT_LATCHED
    message = lost_transform(1, faults)
    message.state = joint_state
    state = rig.state_of(message)
    assert (state.state, state.faults, state.joint, state.reason) == (expected, faults, "joint1", reason)
    assert not has_pose(state)


@pytest.mark.parametrize(("age_s", "reason"), [(3600.0, "s old; expected"), (-3600.0, "s ahead of ROS time")])
def test_a_scan_that_is_too_old_or_ahead_gives_no_pose(rig: Rig, age_s: float, reason: str) -> None:
    state = rig.state_of(transform_of(1), age_s)
    assert state.state == EndpointState.STATE_LOST
    assert reason in state.reason
    assert not has_pose(state)


def test_a_transform_between_other_frames_is_refused_in_the_state(rig: Rig) -> None:
    wrong = transform_of(1, plates=("posor_receiving", "another_plate"))
    state = rig.state_of(wrong)
    assert (state.state, state.faults, state.joint) == (EndpointState.STATE_LOST, 0, "joint1")
    assert state.reason == (
        "joint1: transforms from 'posor_receiving' to 'another_plate' arrive; "
        "expected 'posor_receiving' to 'posor_target', as in the URDF"
    )
    assert 0.0 <= state.age < 1.0
    assert not has_pose(state)
    for _ in range(20):  # longer than max_silence: wrong transforms do not conceal themselves
        rig.send(wrong)
        time.sleep(PERIOD_S)
    newest = rig.send(wrong)
    rig.graph.wait_until(lambda: stamp_ns(rig.states[-1]) == newest, "the latest state")
    assert (rig.states[-1].state, rig.states[-1].reason) == (EndpointState.STATE_LOST, state.reason)
    assert rig.state_of(transform_of(1)).state == EndpointState.STATE_OK


@pytest.mark.parametrize(
    ("plates", "reason"),
    [
        (PLATES, "joint1: the stamp of a transform is zero, or its nanoseconds are a second or more; expected"),
        (("posor_receiving", "x"), "joint1: transforms from 'posor_receiving' to 'x' arrive; expected"),
    ],
)
def test_a_transform_without_a_stamp_is_refused_in_the_state(rig: Rig, plates: tuple[str, str], reason: str) -> None:
    """The state has the stamp of the last complete scan."""
    complete = stamp_ns(rig.state_of(transform_of(1)))
    rig.states.clear()
    unstamped = transform_of(0, plates=plates)
    unstamped.header.stamp.nanosec = 0
    rig.publisher.publish(unstamped)
    state = rig.wait_for_state(EndpointState.STATE_LOST)
    assert (stamp_ns(state), state.joint) == (complete, "joint1")
    assert state.reason.startswith(reason)
    assert 0.0 < state.age < 2.0
    assert not has_pose(state)


@pytest.mark.parametrize(
    ("fields", "entries", "reason"),
    [
        ({}, {(0, 0): -1e-12}, "has a covariance that is not positive semi-definite"),
        ({}, {(0, 1): 2e-12, (1, 0): 2e-12}, "has a covariance that is not positive semi-definite"),
        ({}, {(0, 5): 1e-13}, "has a covariance that is not symmetric"),
        ({}, {(3, 3): 1e300}, "has a variance above 100 m^2 or rad^2"),
        ({}, {(0, 1): math.nan}, "has a covariance that is not finite"),
        ({"x": 1e300}, {}, "is further than 0.02 m from the nominal joint of the URDF"),
        ({"x": 0.2}, {}, "is further than 0.02 m from the nominal joint of the URDF"),
        ({"x": math.inf}, {}, "has a pose that is not finite"),
        ({"alpha": math.nan}, {}, "has native coordinates that are not finite or do not agree with its pose"),
        ({"x": 0.001}, {}, "has native coordinates that are not finite or do not agree with its pose"),
    ],
)
@pytest.mark.parametrize("part", ["covariance_random", "covariance_systematic"])
def test_numbers_that_cannot_be_are_refused_and_named(
    rig: Rig, part: str, fields: dict[str, float], entries: dict[tuple[int, int], float], reason: str
) -> None:
    message, covariance = transform_of(1), SOUND_COVARIANCE.copy()
    for place, value in entries.items():
        covariance[place] = value
    setattr(message, part, covariance.ravel())
    message.pose.position.x = fields.get("x", 0.0)
    message.native[3] = fields.get("alpha", 0.0)
    state = rig.state_of(message)
    assert (state.state, state.joint, state.reason) == (EndpointState.STATE_LOST, "joint1", f"joint1 {reason}")
    assert not has_pose(state)


@pytest.mark.parametrize("shift", [-1e-9, math.nan])
def test_a_stamp_shift_that_cannot_be_is_refused_and_named(rig: Rig, shift: float) -> None:
    message = transform_of(1)
    message.stamp_shift[4] = shift
    state = rig.state_of(message)
    assert (state.state, state.reason) == (
        EndpointState.STATE_LOST,
        "joint1 has a stamp shift that is negative or not a number",
    )
    assert not has_pose(state)


LEVER = np.array([1.0, -2.0, 0.0, 0.0, 3.0, 1.0])


def test_a_singular_covariance_is_accepted_and_one_of_zeros_is_not(rig: Rig) -> None:
    message = transform_of(1)
    message.covariance_systematic = 1e-12 * np.outer(LEVER, LEVER).ravel()
    message.covariance_random = np.zeros(36)
    assert rig.state_of(message).state == EndpointState.STATE_OK
    unset = transform_of(2)
    unset.covariance_random = unset.covariance_systematic = np.zeros(36)
    state = rig.state_of(unset)
    assert (state.state, state.reason) == (
        EndpointState.STATE_LOST,
        "joint1 has covariances of zeros, which mean unknown",
    )


@pytest.mark.parametrize(
    ("message_type", "topic"), [(JointTransform, "joint1/transform"), (EndpointState, "endpoint/state")]
)
def test_two_publishers_of_a_joint_or_of_the_state_give_no_pose(rig: Rig, message_type: Any, topic: str) -> None:
    impostor = rig.graph.node.create_publisher(message_type, topic, rig.publisher.qos_profile)
    try:
        rig.graph.wait_until(lambda: impostor.get_subscription_count() == 1, "the match")
        wait_for_error = f"2 publishers on /{topic}; expected one"
        assert rig.graph.wait_for_status("/chain_node: input", wait_for_error).level == b"\x02"
        state = rig.state_of(transform_of(1))
        assert (state.state, state.reason) == (EndpointState.STATE_LOST, wait_for_error)
    finally:
        rig.graph.node.destroy_publisher(impostor)
    rig.graph.wait_until(lambda: rig.state_of(transform_of(1)).state == EndpointState.STATE_OK, "a pose")


def test_without_scans_the_state_is_stale_at_ten_hertz(rig: Rig) -> None:
    for _ in range(20):
        rig.state_of(transform_of(1))
        time.sleep(PERIOD_S / 2.0)
    state = rig.wait_for_state(EndpointState.STATE_STALE)
    assert 0.2 < state.age < 0.5
    assert state.reason.startswith("no input on /joint1/transform for 0.")
    assert state.header.stamp.sec > 0
    assert not has_pose(state)
    rig.arrivals.clear()
    began = time.monotonic()
    rig.graph.wait_until(lambda: len(rig.arrivals) >= 20, "20 states")
    assert time.monotonic() - began < 4.0  # 1.6 s on an idle host
    assert rig.states[-1].age > state.age


def test_a_killed_posor_node_is_known_soon() -> None:
    """The whole way over DDS: scans, posor_node, chain_node, and a plain subscriber to the state."""
    reliable = {"lossless": True}
    posor = [*installed("posor_estimator", "posor_node"), *ros_arguments({**POSOR, **reliable}, "/joint1")]
    chain = [*installed("posor_estimator", "chain_node"), *ros_arguments(CHAIN)]
    with Program(chain), Program(posor) as victim, Graph() as graph:
        states: list[Any] = graph.collect(EndpointState, "endpoint/state", QoSProfile(depth=10))
        graph.watch_diagnostics()
        wait_for_value(graph, "/joint1/posor_node: listeners", "transform", "1")
        sender = ScanSender(graph, "joint1/raw")
        graph.wait_until(
            lambda: bool(states) and states[-1].state == EndpointState.STATE_OK, "a pose", sender.send_later
        )
        sender.send_for(0.5)
        victim.process.kill()
        killed_ns = time.time_ns()
        states.clear()
        graph.wait_until(lambda: any(s.state == EndpointState.STATE_STALE for s in states), "stale", sender.send_later)
        stale = next(s for s in states if s.state == EndpointState.STATE_STALE)
        elapsed_s = 1e-9 * (time.time_ns() - killed_ns)
        assert 0.1 < stale.age < elapsed_s + 1.0  # the last scan came before; how soon, "make faults" measures
        assert stale.joint == "joint1"
        assert "/joint1/transform" in stale.reason
        assert all(stamp_ns(s) <= killed_ns for s in states)
        assert stamp_ns_of(bytes(8)) == 0
