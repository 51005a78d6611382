# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint between scans, see ``chain.encoder_filter``: the readings of encoders one by one, live or recorded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor.chain import encoder_filter
from posor.chain.encoder_filter import Twists, predict_endpoints, use_transform, use_transform_row
from posor.chain.encoder_track import JERK_S, SEEN, EncoderFilter
from posor.chain.joint_measurements import JointMeasurements, JointRowLayout, JointRows
from posor.errors import ParameterError
from posor.numerics.compiled import bind
from posor.numerics.stamps import NS
from posor.numerics.vector import wrapped_angles

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import EncodersParameters
    from posor.numerics.array_types import ByteArray, FloatArray

NO_LAYOUT = JointRowLayout(*[0] * 9)
LEAST_TURN = 5e-5  # of a joint or of its encoder, from which the cause of a disagreement is searched [rad]
SAME = 0.1  # largest difference of two motions that are taken for the same, relative
KNOWN_SLOPES = {-1.0: "turns against its POSOR: wrong sign", 180.0 / math.pi: "reads degrees; expected rad"}


def for_each_joint(name: str, values: tuple[float, ...], joints: Sequence[str]) -> FloatArray:
    """Return a parameter for each joint, (j,). Raises ParameterError: neither one value nor one for each joint."""
    if len(values) not in (1, len(joints)):
        what, expected = f"{len(values)} values", f"one, or one for each of {', '.join(joints)}"
        raise ParameterError(what, where=f"parameter 'encoders.{name}'", expected=expected)
    return np.broadcast_to(np.array(values), len(joints))


class EndpointPredictor:
    """Predicts the endpoint of an arm at the readings of its encoders.

    Use the transforms of joints as they arrive (``use_transform``) and read the encoders (``read``). The stamps of both
    are of one clock. A transform is used once the readings have reached its stamp.

    Attributes:
        joints: Names of the joints, in the order of all arrays.
        names: Their names in the readings.
        present: Pose and covariances at the last reading.
        ahead: The same ``lead_time`` later.
        twist: Velocity and angular velocity at the last reading, and their covariance.
        twist_ahead: The same ``lead_time`` later.
        faults: Of the joints at the last reading, (j,): zero, or why there is no endpoint (``chain.encoder_filter``).
        held: Which joints had no transform for longer than ``gap``, (j,).
        measurements: Where ``use_transform`` reads the measurement of a joint.
        rows: Where ``use_row`` reads its serialised transform, (j, bytes), see ``use_row_layout``.

    """

    def __init__(self, chain: Chain, parameters: EncodersParameters) -> None:
        """Begin without readings. Raises ParameterError: a parameter has neither one value nor one for each joint."""
        self.joints = tuple(joint.name for joint in chain.joints)
        self.names = parameters.names or self.joints
        if len(self.names) != len(self.joints) or len(set(self.names)) != len(self.names):
            what, expected = f"names {', '.join(self.names)}", f"another one for each of {', '.join(self.joints)}"
            raise ParameterError(what, where="parameter 'encoders.names'", expected=expected)
        self.present, self.ahead = chain.estimator(), chain.estimator()
        if self.present.vibrations.size:
            what = "set, and beams have accelerometers, so that the vibration between scans is not predicted"
            raise ParameterError(what, where="parameter 'encoders.topic'", expected="no encoders, or no 'vibration'")
        self.twist, self.twist_ahead = Twists.allocate(), Twists.allocate()
        self._parameters, self._filter = parameters, EncoderFilter.allocate(len(self.joints))
        self.faults, self.held = self._filter.faults, self._filter.held
        settings = self._filter.settings
        settings["variance"] = np.square(for_each_joint("sigma", parameters.sigma, self.joints))
        settings["half_backlash"] = 0.5 * for_each_joint("backlash", parameters.backlash, self.joints)
        settings["max_rate"], settings["max_offset"] = parameters.max_rate, parameters.max_offset
        settings["jerk_density"] = parameters.max_jerk**2 * JERK_S
        settings["slope"] = parameters.slope
        settings["stamp_sigma"] = parameters.stamp_sigma
        settings["holdover_ns"], settings["gap_ns"] = round(parameters.max_holdover * NS), round(parameters.gap * NS)
        settings["lead_ns"] = round(parameters.lead_time * NS)
        self._row_layouts = [NO_LAYOUT] * len(self.joints)
        self._rows = JointRows.allocate(self._row_layouts)
        self._prepare_arguments()

    def _prepare_arguments(self) -> None:
        self._arm, history, present, endpoints = self.present.workspace
        _, _, ahead, ahead_endpoints = self.ahead.workspace
        self._measured = (present, ahead)
        self.measurements = JointMeasurements.allocate(1, len(self.joints), present.shared_effects.shape[2])
        at_present = self._arm, history, present, endpoints, self.twist
        self._read = bind(predict_endpoints, (self._filter, *at_present, ahead, ahead_endpoints, self.twist_ahead))
        self._use = bind(use_transform, (self._filter, self._arm, self.measurements))
        self._use_row = bind(use_transform_row, (self._filter, self._arm, self.measurements, self._rows))

    def use_arm_of(self, estimator: EndpointEstimator) -> None:
        """Take shared terms, beams and accelerations of the estimator of the scans."""
        for own in (self.present, self.ahead):
            own.use_arm_of(estimator)
        if self.present.workspace[0] is not self._arm:
            self._prepare_arguments()

    def use_transform(self, joint: int, stamp_ns: int) -> int:
        """Use the measurement of a joint in ``measurements``; return ``USED`` or why not, see ``encoder_filter``."""
        return self._after(joint, self._use(joint, stamp_ns))

    @property
    def rows(self) -> ByteArray:
        """See the class."""
        return self._rows.octets

    def use_row_layout(self, joint: int, layout: JointRowLayout) -> None:
        """Take serialised transforms of a joint with this layout from now on; ``rows`` is then another array."""
        self._row_layouts[joint] = layout
        self._rows = JointRows.allocate(self._row_layouts)
        self._prepare_arguments()

    def use_row(self, joint: int, stamp_ns: int) -> int:
        """Use the transform of a joint in ``rows``, likewise."""
        return self._after(joint, self._use_row(joint, stamp_ns))

    def _after(self, joint: int, result: int) -> int:
        if result == encoder_filter.USED:
            for each in self._measured:
                each.covariances_systematic[0, joint] = self.measurements.covariances_systematic[0, joint]
                each.shared_effects[0, joint] = self.measurements.shared_effects[0, joint]
        return result

    def read(self, stamp_ns: int, angles: FloatArray) -> bool:
        """Take readings [rad] of one stamp, (j,), NaN: none; return whether there is an endpoint at this stamp."""
        self._filter.readings[:] = angles
        return bool(self._read(stamp_ns))

    @property
    def held_joints(self) -> tuple[str, ...]:
        """Names of the joints that had no transform for longer than ``gap`` at the last reading."""
        return tuple(self.joints[j] for j in np.flatnonzero(self.held))

    def reasons(self) -> dict[str, str]:
        """Return why there is no endpoint at the last reading, by joint: clauses that follow its name."""
        own = self._parameters
        texts = {
            encoder_filter.NO_READING: "has no reading of its encoder yet",
            encoder_filter.READING_OLD: f"has no reading of its encoder for more than {own.max_holdover:g} s",
            encoder_filter.NO_TRANSFORM: "has no transform since the first reading of its encoder",
            encoder_filter.HELD_TOO_LONG: f"has no transform for more than {own.max_holdover:g} s",
            encoder_filter.JUMPED: f"has an encoder that moved faster than {own.max_rate:g} rad/s",
            encoder_filter.NOT_FINITE: "gives an endpoint that is not finite",
        }
        found = {}
        for j in np.flatnonzero(self.faults).tolist():
            fault, offset = int(self.faults[j]), float(self._filter.states["offset"][j])
            if fault == encoder_filter.DISAGREES:
                found[self.joints[j]] = f"has an encoder that {self._disagreement(j)}"
            elif fault == encoder_filter.OFFSET:
                expected = f"expected at most {own.max_offset:g}; another zero, or a slipped tooth"
                found[self.joints[j]] = f"has an encoder that reads {offset:+.6f} rad from its POSOR; {expected}"
            else:
                found[self.joints[j]] = texts[fault]
        return found

    def _disagreement(self, joint: int) -> str:
        """Return how the encoder of a joint moved from transform to transform, beside the POSORs of all joints."""
        seen, counts = self._filter.seen, self._filter.states["seen"]
        order = np.arange(max(0, counts[joint] - SEEN), counts[joint]) % SEEN
        turned = wrapped_angles(np.diff(seen[:, order, 0], axis=1))  # of all POSORs
        moved = np.diff(seen[joint, order, 1])
        if min(np.abs(moved).sum(), np.abs(turned).sum(axis=1).max()) < LEAST_TURN:
            return "does not follow its POSOR"
        others = {self.joints[k]: turned[k] for k in np.flatnonzero(counts == counts[joint]).tolist() if k != joint}
        return describe_disagreement(moved, turned[joint], others)


def describe_disagreement(moved: FloatArray, own: FloatArray, others: Mapping[str, FloatArray]) -> str:
    """Return how an encoder moves beside POSORs: a clause.

    ``moved``: successive motions by the encoder [rad], (n,); ``own``: by the POSOR of its joint; ``others``: by the
    POSORs of other joints, by name.
    """
    for name, turned in others.items():
        if is_same_motion(moved, turned):
            return f"follows the POSOR of '{name}': readings of another joint"
    slope = float(own @ moved) / max(float(own @ own), float(np.finfo(float).tiny))
    if is_same_motion(moved, slope * own):
        for known, text in KNOWN_SLOPES.items():
            if abs(slope / known - 1.0) < SAME:
                return text
        return f"turns {slope:.4g} times as far as its POSOR: wrong scale"
    return describe_jump(moved, own) or "does not follow its POSOR"


def describe_jump(moved: FloatArray, own: FloatArray) -> str:
    """Return a clause on an encoder that differs from its POSOR in one motion (n,) alone; else empty."""
    step = int(np.argmax(np.abs(moved - own)))
    rest = np.delete(moved - own, step)
    if SAME * abs(moved[step] - own[step]) > np.abs(rest).max(initial=0.0):
        return f"has jumped by {moved[step] - own[step]:+.6f} rad against its POSOR: a lost count or a slipped tooth"
    return ""


def is_same_motion(motion: FloatArray, other: FloatArray) -> bool:
    """Return whether two motions (n,) differ by less than the share ``SAME``."""
    return bool(np.linalg.norm(motion - other) < SAME * np.linalg.norm(motion))
