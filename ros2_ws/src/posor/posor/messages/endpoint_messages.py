# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The endpoint's messages as bytes: many from arrays, or scan after scan from the arrays of an endpoint estimator."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.messages.cdr_schema import STAMP
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import TableLayout
from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE, JOINT_STATE, POSE_STAMPED, POSE_WITH_COVARIANCE_STAMPED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.messages.estimate_arrays import EndpointEstimates
    from posor.messages.message_table import MessageTable
    from posor.numerics.array_types import FloatArray

MAX_JOINT, MAX_REASON = 128, 255  # bounds of the strings in ``posor_msgs/EndpointState`` [bytes]
WRITERS = 256  # number of verdicts and causes of levels whose messages are kept prepared
POSE, COVARIANCE_POSE = "pose.position.x", "pose.pose.position.x"  # first of the seven numbers of a pose


def _constant_values(frame: str, joints: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the strings and lengths of all messages by path, for each type of message."""
    header = {"header.frame_id": frame}
    joint_states = {"name": list(joints), "position": [0.0] * len(joints)}
    return {POSE_STAMPED: header, POSE_WITH_COVARIANCE_STAMPED: header, JOINT_STATE: joint_states}


def endpoint_layouts(frame: str, joints: Sequence[str]) -> list[TableLayout]:
    """Return the layouts of PoseStamped, PoseWithCovarianceStamped and JointState."""
    schemas = {installed_schema(name): values for name, values in _constant_values(frame, joints).items()}
    return [TableLayout.of(schema.encode(values), schema) for schema, values in schemas.items()]


def pack_endpoint(layouts: Sequence[TableLayout], estimates: EndpointEstimates) -> list[MessageTable]:
    """Return a message of each layout for each pose of the endpoint."""
    pose, with_covariance, joint_states = tables = [layout.copies(len(estimates)) for layout in layouts]
    for table in tables:
        table["header.stamp.sec"], table["header.stamp.nanosec"] = np.divmod(estimates.stamps_ns, NS)
    pose.span(POSE, 7)[:] = with_covariance.span(COVARIANCE_POSE, 7)[:] = estimates.poses
    with_covariance["pose.covariance"] = estimates.covariances().reshape(-1, 36)
    joint_states["position"] = estimates.angles
    return tables


class MessageWriter:
    """Writes messages of one type into one buffer: only stamp and numbers change from message to message."""

    def __init__(self, name: str, values: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> None:
        """Prepare for messages of type ``name`` with a header, and with ``values`` by path; a field without is zero.

        The present numbers of ``arrays`` are written into every message from a field on: the seven numbers of a pose
        begin at ``pose.position.x``. Raises TopicError: a sequence is longer than its bound.
        """
        schema = installed_schema(name)
        data = schema.encode(values)
        layout, self._buffer = schema.layout(data), memoryview(bytearray(data))
        places = ((layout[path].offset, array) for path, array in arrays.items() if array.size)
        self._copies = [(self._buffer[at : at + array.nbytes], array.data.cast("B")) for at, array in places]

    def write(self, stamp: bytes) -> bytes:
        """Return the message with the present numbers; ``stamp``: the eight bytes of its stamp (``STAMP``)."""
        data = self._buffer
        data[STAMP] = stamp
        for part, numbers in self._copies:
            part[:] = numbers
        return data.tobytes()


class EndpointWriter:
    """Writes the results of an endpoint estimator in a frame, in the axes at home if they are ``relative``.

    Attributes:
        pose: Of ``PoseStamped``.
        joint_states: Of ``JointState``, the positions only.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, *, relative: bool) -> None:
        pose, random, systematic = estimator.result(relative=relative)
        covariance = np.empty((6, 6))
        self._summands_and_sum = random, systematic, covariance
        arrays = ({POSE: pose}, {COVARIANCE_POSE: pose, "pose.covariance": covariance}, {"position": estimator.angles})
        values = _constant_values(frame, estimator.joints).items()
        self.pose, self._pose_with_covariance, self.joint_states = (
            MessageWriter(name, same, numbers) for (name, same), numbers in zip(values, arrays, strict=True)
        )

    def write_pose_with_covariance(self, stamp: bytes) -> bytes:
        """Return ``PoseWithCovarianceStamped`` with the sum of both covariances; ``stamp``: as ``MessageWriter``."""
        np.add(*self._summands_and_sum)
        return self._pose_with_covariance.write(stamp)


class EndpointVerdict(NamedTuple):
    """Whether there is an endpoint, and why not; the fields of ``posor_msgs/EndpointState``."""

    state: int
    faults: int = 0
    joint: str = ""
    reason: str = ""
    is_waiting: bool = False  # each joint that gives no pose has no fault and only waits to be counted; no field there

    @property
    def has_pose(self) -> bool:
        """Whether the endpoint's numbers are valid."""
        return self.state in USABLE_STATES


class EndpointStateWriter:
    """Writes ``EndpointState``; pose, covariances and protection level are NaN without a pose.

    Attributes:
        identity: Of the arm, 64 hexadecimal digits; empty: not known yet.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, child_frame: str, *, relative: bool) -> None:
        pose, random, systematic = estimator.result(relative=relative)
        self._estimator, self._is_relative = estimator, relative
        self._causes: tuple[tuple[str, str], ...] = ()
        self.identity, self._age = "", np.full(1, np.nan)
        endpoint = {POSE: pose, "covariance_random": random, "covariance_systematic": systematic}
        endpoint["protection_level"] = estimator.protection_level
        nothing = {name: np.full(numbers.shape, np.nan) for name, numbers in endpoint.items()}
        frames = {"header.frame_id": frame, "child_frame_id": child_frame}

        @lru_cache(maxsize=WRITERS)
        def writer_of(verdict: EndpointVerdict, causes: tuple[tuple[str, str], ...], identity: str) -> MessageWriter:
            values: dict[str, Any] = {"state": verdict.state, "faults": verdict.faults, "identity": identity}
            for name, text, limit in (("joint", verdict.joint, MAX_JOINT), ("reason", verdict.reason, MAX_REASON)):
                values |= {name: text.encode()[:limit].decode(errors="ignore")}
            values["protection_causes"] = [f"{joint}: {cause}" if cause else "" for joint, cause in causes]
            numbers = {"age": self._age, **(endpoint if verdict.has_pose else nothing)}
            return MessageWriter(ENDPOINT_STATE, frames | values, numbers)

        self._writer_of = writer_of

    def bound_error(self) -> None:
        """Find the protection level of the endpoint in the estimator, for the next message."""
        self._causes = self._estimator.bound_error(relative=self._is_relative)

    def write(self, stamp: bytes, age_s: float, verdict: EndpointVerdict) -> bytes:
        """Return the message; ``stamp``: its eight bytes (``STAMP``); ``age_s``: until now [s], NaN: no scan yet."""
        self._age[0] = age_s
        return self._writer_of(verdict, self._causes if verdict.has_pose else (), self.identity).write(stamp)
