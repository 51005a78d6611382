# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates the joints of an arm and its endpoint from recorded scans, without any node: the nodes' numbers."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.bags.block_synchroniser import BlockSynchroniser, joint_rows
from posor.bags.reprocess_task import EndpointSummary, JointSummary
from posor.calibration.shared_terms import check_same_terms
from posor.chain.beam_temperatures import PERIOD_NS, BeamTemperatures
from posor.chain.fault_bounds import EndpointBounds
from posor.errors import ChainError
from posor.estimation.estimate import Estimates
from posor.estimation.posor import Posor
from posor.messages.estimate_arrays import ArmEstimates, EndpointEstimates, estimate_joint
from posor.messages.joint_transform import TransformConstants
from posor.model.fault import USABLE_STATES, Fault, State
from posor.model.scan import Scans
from posor.numerics.stamps import NS
from posor.reporting.fault_texts import FAULT_TEXTS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from posor.bags.reprocess_task import Settings
    from posor.calibration.calibration_file import Calibration
    from posor.chain.forward_kinematics import Endpoints
    from posor.chain.kinematic_chain import Chain
    from posor.messages.raw_scan import RecordedScans
    from posor.node_parameters import ChainParameters
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

NO_TIMES = np.empty(0, dtype=np.int64)
NO_SCANS = Scans.from_fields(stamps_ns=np.empty(0, dtype=np.int64))


class RecordedTemperature(NamedTuple):
    """A recorded message of a thermometer."""

    name: str
    stamp_ns: int
    celsius: float  # [degree Celsius]
    frame: str


class ArmEstimator:
    """The POSORs of an arm and its kinematic chain, block after block of recorded scans.

    Attributes:
        transforms: What is the same in all transforms of each joint.
        endpoint: The kinematic chain; None: joints only.
        thermometers: Names of the thermometers of its beams, and ends of their topics.

    """

    def __init__(self, settings: Settings) -> None:
        """Load calibrations and chain. Raises PosorError: a calibration, the chain or a parameter is invalid."""
        calibrations = {name: joint.load() for name, joint in settings.joints.items()}
        self._joints = {
            name: _JointEstimator(calibrations[name], joint.false_alarm) for name, joint in settings.joints.items()
        }
        self.transforms = {name: joint.transforms for name, joint in self._joints.items()}
        loaded = settings.load_chain()
        self.endpoint = None if loaded is None else EndpointPipeline(*loaded, self.transforms)
        names = () if self.endpoint is None else self.endpoint.temperatures.names
        prefix = "" if loaded is None else loaded[1].temperature_topic.strip("/")
        self.thermometers = {name: f"/{prefix}/{name}" for name in names}
        files = {str(settings.joints[name].calibration): each.shared for name, each in calibrations.items()}
        if loaded is not None:
            check_same_terms({loaded[1].beams: loaded[0].shared, **files})

    def estimate_block(
        self, scans: Mapping[str, Sequence[RecordedScans]], readings: Sequence[RecordedTemperature] = ()
    ) -> ArmEstimates:
        """Return the transforms of all joints, and the endpoint at all stamps that become complete with them.

        ``scans``: the next scans of each joint; ``readings``: of thermometers, recorded with them.
        """
        joints = {name: joint.estimate(scans[name]) for name, joint in self._joints.items()}
        if self.endpoint is None:
            return ArmEstimates(joints, EndpointEstimates.none())
        for reading in readings:
            self.endpoint.temperatures.add(*reading)
        orders = {
            name: np.concatenate([np.empty(0, dtype=np.int64), *(part.order for part in scans[name])])
            for name in self.endpoint.joints
        }
        return ArmEstimates(joints, self.endpoint.estimate(joints, orders), self.endpoint.joints)

    def finish(self) -> None:
        """Count the stamps that are incomplete at the end."""
        if self.endpoint is not None:
            self.endpoint.synchroniser.finish()

    def notes(self) -> list[str]:
        """Return sentences on stamps that go back, joints without a pose, incomplete stamps and thermometers."""
        notes = []
        for name, joint in self._joints.items():
            if joint.backward:
                notes.append(
                    f"stamps of {name} that are not after the one before: {joint.backward:,}, as where a recording "
                    "starts over, scans are repeated or a clock was set"
                )
            if joint.scans and not joint.usable:
                notes.append(f"no scan of {name} has a usable pose: {joint.reason}")
        if (end := self.endpoint) is not None:
            notes += _different_ages({name: self._joints[name] for name in end.joints})
            if end.synchroniser.incomplete:
                missing = ", ".join(f"{n:,} of {name}" for name, n in end.synchroniser.missing.items() if n)
                notes.append(
                    f"stamps without a transform of each joint: {end.synchroniser.incomplete:,}; missing {missing}"
                )
                if not end.poses + end.unusable:
                    notes.append("the joints have no stamp in common, which an endpoint needs")
            total, affected = end.poses, end.affected_by_beams
            notes += [f"{reason}: {count:,} of {total:,} poses" for reason, count in affected.items()]
        return notes

    def summarise(self) -> tuple[dict[str, JointSummary], EndpointSummary | None]:
        """Return the counts of the joints' scans and of the endpoint's stamps."""
        end = self.endpoint
        summaries = {}
        for name, joint in self._joints.items():
            in_chain = end is not None and name in end.joints
            missing, refused = (end.synchroniser.missing[name], end.refused[name]) if end and in_chain else (0, 0)
            summaries[name] = JointSummary(joint.scans, joint.lost, dict(joint.faults), missing, refused)
        if end is None:
            return summaries, None
        return summaries, EndpointSummary(end.poses, end.degraded, end.unusable, end.synchroniser.incomplete)


class _JointEstimator:
    """Estimates the transforms of one joint, each scan from the pose before.

    Attributes:
        scans: Number of scans.
        usable: Number of scans with a pose that is OK or DEGRADED.
        lost: Number of scans without a pose.
        faults: Number of scans without a pose, by fault.
        backward: Number of stamps that are not after the one before.
        ages_s: Times from stamp to log, the median of each part that was read [s].
        intervals_s: Intervals of the stamps, likewise [s].

    """

    def __init__(self, calibration: Calibration, false_alarm: float) -> None:
        self._posor = Posor(calibration, false_alarm=false_alarm)
        self.transforms = TransformConstants.of(self._posor)
        self.scans = self.usable = self.lost = self.backward = 0
        self.faults: Counter[str] = Counter()
        self.ages_s, self.intervals_s = list[float](), list[float]()
        self._last_ns = np.empty(0, dtype=np.int64)  # the last stamp, if any

    def estimate(self, scans: Sequence[RecordedScans]) -> Estimates:
        parts = [estimate_joint(self._posor, each) for each in scans]
        estimates = Estimates.concatenate(parts) if parts else self._posor.estimate_all(NO_SCANS, fault_effects=True)
        lost = estimates.states == int(State.LOST)
        self.scans += len(estimates)
        self.usable += int(np.count_nonzero(np.isin(estimates.states, USABLE_STATES)))
        self.lost += int(np.count_nonzero(lost))
        faults = estimates.faults[lost]
        counts = {fault.name: int(np.count_nonzero(faults & fault.value)) for fault in Fault if fault.name}
        self.faults.update({name: count for name, count in counts.items() if count})
        log_times_ns = np.concatenate([NO_TIMES, *(each.log_times_ns for each in scans)])
        stamps_ns = estimates.stamps_ns[estimates.stamps_ns != 0]
        if len(stamps_ns) == len(log_times_ns) > 1:
            self.ages_s.append(float(np.median(log_times_ns - stamps_ns)) / NS)
            self.intervals_s.append(float(np.median(np.diff(stamps_ns))) / NS)
        stamps_ns = np.concatenate([self._last_ns, stamps_ns])
        self.backward += int(np.count_nonzero(np.diff(stamps_ns) <= 0))
        self._last_ns = stamps_ns[-1:]
        return estimates

    @property
    def reason(self) -> str:
        """Why no scan has a usable pose: the most frequent fault, or no home mark."""
        if self.lost < self.scans:
            return f"{self.scans - self.lost:,} of {self.scans:,} are UNCOUNTED, because none passes a home mark"
        fault, count = self.faults.most_common(1)[0] if self.faults else ("", 0)
        what = f"{FAULT_TEXTS.get(fault, 'another frame or invalid times')} ({count or self.lost:,} of {self.scans:,})"
        return f"{what}; the calibration may be that of another POSOR" if fault in CONTRADICTIONS else what


CONTRADICTIONS = {"BAD_READING", "OUT_OF_RANGE", "NOT_CONVERGED", "ILL_CONDITIONED", "RESIDUAL", "INNOVATION", "SOURCE"}
"""Faults of scans whose readings or frame do not fit the calibration."""


def _different_ages(joints: Mapping[str, _JointEstimator]) -> list[str]:
    """Return a sentence where joints were recorded at different times after their stamps: a stamp may be wrong."""
    ages_s = {name: float(np.median(joint.ages_s)) for name, joint in joints.items() if joint.ages_s}
    intervals_s = [interval_s for joint in joints.values() for interval_s in joint.intervals_s]
    if not ages_s:
        return []
    oldest, youngest = max(ages_s, key=ages_s.__getitem__), min(ages_s, key=ages_s.__getitem__)
    difference_s = ages_s[oldest] - ages_s[youngest]
    if difference_s <= max(LEAST_AGE_DIFFERENCE_S, LEAST_INTERVALS * float(np.median(intervals_s))):
        return []
    first, second = (
        f"{name} were recorded {abs(1e3 * ages_s[name]):.3g} ms {'after' if ages_s[name] >= 0.0 else 'before'}"
        for name in (youngest, oldest)
    )
    wrong = f"the stamps of one of them may be wrong by {1e3 * difference_s:.3g} ms"
    return [f"scans of {first} their stamps, and those of {second} theirs: {wrong}"]


LEAST_AGE_DIFFERENCE_S, LEAST_INTERVALS = 5e-3, 1.0
"""Difference of the joints' ages that is reported: at least this time, and this number of intervals."""
UNREAD = "accelerometers of beams are not read offline: their beams are at rest, with the stated spread"


class EndpointPipeline:
    """Estimates the endpoint from the transforms of all joints.

    Attributes:
        joints: Names of the joints, in the chain's order.
        frame: Frame of the endpoint's pose.
        synchroniser: Joins the transforms by stamp, and counts incomplete stamps.
        poses: Number of poses.
        temperatures: Of the beams with thermometers.
        reasons: What is wrong with thermometers, see ``BeamTemperatures.reason``, by period of the stamps.
        kelvins: Temperatures in use, see ``BeamTemperatures.kelvins``, by period of the stamps.
        affected_by_beams: Number of poses by what is wrong with thermometers, or not read of the beams.
        degraded: Number of poses that depend on a DEGRADED joint, or on a thermometer that cannot be used.
        unusable: Number of complete stamps without a pose, and of transforms with an invalid stamp.
        refused: The same, by the joint whose transform cannot be used.
        bounds: Protection levels of the endpoints that ``estimate`` has returned last.
        set_by: Names joint and cause that set each level of one of them, see ``EndpointEstimator.set_by``.

    """

    def __init__(self, chain: Chain, parameters: ChainParameters, transforms: Mapping[str, TransformConstants]) -> None:
        """Prepare.

        ``parameters``: of chain_node; ``transforms``: of each calibrated joint. Raises ChainError: a joint of the chain
        has no calibration, or one between other frames.
        """
        self.joints = tuple(joint.name for joint in chain.joints)
        where = f"URDF {parameters.urdf}"
        for joint in chain.joints:
            if joint.name not in transforms:
                expected = f"one for each of {', '.join(self.joints)}"
                raise ChainError(f"joint {joint.name} has no calibration", where=where, expected=expected)
            parent, child = transforms[joint.name].parent, transforms[joint.name].child
            if (parent, child) != (joint.parent, joint.child):
                raise ChainError(
                    f"the calibration of {joint.name} is from '{parent}' to '{child}'",
                    where=where,
                    expected=f"'{joint.parent}' to '{joint.child}'",
                )
        self._estimator = chain.estimator(parameters.acceleration_window)
        self.temperatures = BeamTemperatures(chain.beams, self._estimator, chain.plates)
        self.reasons: dict[int, str] = {}
        self.kelvins: dict[int, Mapping[str, float]] = {}
        self.affected_by_beams: Counter[str] = Counter()
        own = [transforms[name] for name in self.joints]
        self._estimator.use_terms([each.shared for each in own])
        self._estimator.use_causes([each.causes for each in own])
        self._terms = max(len(each.shared) for each in own)
        self._relative = parameters.reference == "home"
        self._home: FloatArray | None = None
        self._home_is_degraded: bool | None = None
        self.frame = f"{parameters.endpoint_frame}_home" if self._relative else chain.base_frame
        self._effects = self._estimator.fault_effects.shape[1]
        self.synchroniser = BlockSynchroniser(self.joints, self._effects)
        self.bounds = EndpointBounds.allocate(0)
        self.set_by = self._estimator.set_by
        self.poses = self.degraded = self.unusable = 0
        self.refused = dict.fromkeys(self.joints, 0)

    def estimate(self, joints: Mapping[str, Estimates], orders: Mapping[str, IntArray]) -> EndpointEstimates:
        """Return the endpoint at all stamps that become complete with the next transforms of all joints.

        ``orders``: positions of their scans among those of all joints that were read together, shape (n,).
        """
        rows = [self._with_stamp(name, _joint_rows(joints[name], orders[name], self._effects)) for name in self.joints]
        complete = self.synchroniser.join(rows)
        parts = [(self._estimate(part), self.bounds) for part in self._periods(complete)]
        if len(parts) == 1:
            return parts[0][0]
        self.bounds = EndpointBounds(*map(np.concatenate, zip(*(bounds for _, bounds in parts), strict=True)))
        return EndpointEstimates.concatenate([estimates for estimates, _ in parts])

    def _periods(self, complete: Sequence[NDArray[np.void]]) -> Iterator[Sequence[NDArray[np.void]]]:
        """Yield the transforms of complete stamps in parts with the same temperatures of the beams."""
        stamps = complete[0]["stamp_ns"]
        if not self.temperatures.names or not len(stamps):
            yield complete
            return
        borders = np.flatnonzero(np.diff(stamps // PERIOD_NS)) + 1
        for begin, end in pairwise([0, *borders.tolist(), len(stamps)]):
            self.temperatures.update(int(stamps[begin]))
            period = int(stamps[begin]) // PERIOD_NS
            self.kelvins[period] = self.temperatures.kelvins
            if self.temperatures.reason:
                self.reasons[period] = self.temperatures.reason
            yield [each[begin:end] for each in complete]

    def _estimate(self, complete: Sequence[NDArray[np.void]]) -> EndpointEstimates:
        """Return the endpoint at complete stamps, and write ``bounds``."""
        states = np.array([each["state"] for each in complete])
        usable: BoolArray = np.isin(states, USABLE_STATES)
        all_usable: BoolArray = np.all(usable, axis=0)
        if not all_usable.all():
            complete = [each[all_usable] for each in complete]

        def of_joints(name: str) -> FloatArray:
            return np.stack([each[name] for each in complete], axis=1)

        endpoints = self._estimator.estimate_all(
            of_joints("pose"),
            of_joints("covariance_random"),
            of_joints("covariance_systematic"),
            complete[0]["stamp_ns"],
            of_joints("theta"),
            of_joints("shared_effects")[:, :, : self._terms],
            of_joints("stamp_shift"),
        )
        usable[:, all_usable] &= endpoints.faults.T == 0
        degraded: BoolArray = np.zeros(len(endpoints.poses), dtype=bool)
        degraded[endpoints.usable] = self._count(states, usable)
        return self._endpoint_estimates(complete, endpoints, degraded)

    def _with_stamp(self, joint: str, rows: NDArray[np.void]) -> NDArray[np.void]:
        """Return the transforms with a valid stamp; an invalid one (0) would count as time that goes back."""
        stamped = rows["stamp_ns"] != 0
        if stamped.all():
            return rows
        invalid = int(np.count_nonzero(~stamped))
        self.refused[joint] += invalid
        self.unusable += invalid
        usable: NDArray[np.void] = rows[stamped]
        return usable

    def _count(self, states: IntArray, usable: BoolArray) -> BoolArray:
        """Count n complete stamps; return which of the m poses are degraded, shape (m,).

        ``states`` of the joints, and whether their transforms are ``usable``, shape (joints, n).
        """
        for name, count in zip(self.joints, np.count_nonzero(~usable, axis=1).tolist(), strict=True):
            self.refused[name] += count
        sound = usable.all(axis=0)
        self.poses += int(np.count_nonzero(sound))
        self.unusable += int(np.count_nonzero(~sound))
        degraded: BoolArray = np.any(states[:, sound] == int(State.DEGRADED), axis=0)
        unread = UNREAD if self._estimator.vibrations.size else ""
        if reason := "; ".join(filter(None, (self.temperatures.reason, unread))):
            degraded[:] = True
            self.affected_by_beams[reason] += len(degraded)
        if self._relative and degraded.size:
            self._home_is_degraded = degraded[0] if self._home_is_degraded is None else self._home_is_degraded
            if self._home_is_degraded:
                degraded[:] = True
                self.affected_by_beams["home was taken from a pose that was not OK"] += len(degraded)
        self.degraded += int(np.count_nonzero(degraded))
        return degraded

    def _endpoint_estimates(
        self, complete: Sequence[NDArray[np.void]], endpoints: Endpoints, degraded: BoolArray
    ) -> EndpointEstimates:
        """Return the valid endpoints, relative to the first one if requested."""
        sound = endpoints.usable
        if self._relative and sound.any():
            if self._home is None:
                self._home = endpoints.poses[int(np.argmax(sound))].copy()
            endpoints = endpoints.relative_to(self._home)
        poses, effects, shifts = (
            np.stack([each[name] for each in complete], axis=1) for name in ("pose", "fault_effects", "stamp_shift")
        )
        bounds = self._estimator.bound_all(endpoints, poses, effects, shifts, self._home)
        self.bounds = EndpointBounds(bounds.levels[sound], bounds.joints[sound], bounds.causes[sound])
        log_times_ns = np.max([each["log_time_ns"] for each in complete], axis=0)
        found = EndpointEstimates(
            log_times_ns,
            complete[0]["stamp_ns"],
            endpoints.poses,
            endpoints.covariances_random,
            endpoints.covariances_systematic,
            endpoints.angles,
            endpoints.stamp_shifts,
            bounds.levels,
            degraded,
        )
        return found if sound.all() else found.select(sound)


def _joint_rows(estimates: Estimates, order: IntArray, effects: int) -> NDArray[np.void]:
    rows: NDArray[np.void] = np.empty(len(estimates), dtype=joint_rows(effects))
    rows["fault_effects"][:, : estimates.fault_effects.shape[1]] = estimates.fault_effects
    rows["order"], rows["log_time_ns"], rows["stamp_ns"] = order, estimates.log_times_ns, estimates.stamps_ns
    rows["state"], rows["theta"], rows["pose"] = estimates.states, estimates.thetas, estimates.poses
    rows["covariance_random"] = estimates.covariances_random
    rows["covariance_systematic"] = estimates.covariances_systematic
    rows["shared_effects"] = estimates.shared_effects
    rows["stamp_shift"] = estimates.stamp_shifts
    return rows
