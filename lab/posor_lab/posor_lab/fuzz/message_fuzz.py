# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged raw scans and joint transforms through the byte path of the nodes, compared with the undamaged ones.

A pose published as valid is wrong if it differs from the pose of the undamaged message by over 5 standard deviations,
unless the damaged bytes are a message that the sensors could have sent:

- a raw scan in which one reading differs, by less than the redundant readings detect: within the protection level;
- a raw scan in which several readings, or supply and temperature, differ so that they agree with one another.
"""

from __future__ import annotations

import random
import struct
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.errors import TopicError
from posor.estimation.posor import Posor
from posor.messages.joint_transform import JointTransformFormat
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.messages.message_stream import RawScanStream
from posor.messages.message_table import LEAD
from posor.messages.raw_scan import scan_of
from posor.model.fault import USABLE_STATES
from posor.model.scan import Scans
from posor.ros_names import JOINT_TRANSFORM, RAW_SCAN
from posor.uncertainty.protection_level import joint_protection_levels
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.faults.pose_judge import SIGMAS, small_errors

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray

WORDS = tuple(  # numbers of 8 bytes that programs handle badly
    struct.pack("<d", value)
    for value in (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 1e300, -1e300, 5e-324, 1.0, -1.0)
)
MOST_BITS = 8


def _flip_bit(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def _flip_bits(data: bytearray, chance: random.Random) -> None:
    for _ in range(chance.randint(1, MOST_BITS)):
        _flip_bit(data, chance)


def _set_byte(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(len(data))] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256)))


def _set_word(data: bytearray, chance: random.Random) -> None:
    begin = _place(data, chance)
    data[begin : begin + 8] = chance.choice(WORDS)


def _swap_words(data: bytearray, chance: random.Random) -> None:
    one, other = _place(data, chance), _place(data, chance)
    data[one : one + 8], data[other : other + 8] = data[other : other + 8], data[one : one + 8]


def _cut(data: bytearray, chance: random.Random) -> None:
    del data[chance.randrange(len(data)) :]


def _insert(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    data[begin:begin] = chance.randbytes(chance.randint(1, 16))


def _remove(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    del data[begin : begin + chance.randint(1, 16)]


def _randomise(data: bytearray, chance: random.Random) -> None:
    begin = chance.randrange(len(data))
    length = min(chance.randint(1, 32), len(data) - begin)
    data[begin : begin + length] = chance.randbytes(length)


def _place(data: bytearray, chance: random.Random) -> int:
    """Return where a number of 8 bytes may begin: aligned as in CDR, behind the encapsulation header of 4 bytes."""
    return 4 + 8 * chance.randrange(max(1, (len(data) - 4) // 8))


MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    *(_flip_bit, _flip_bits, _set_byte, _set_word, _swap_words, _cut, _insert, _remove, _randomise),
)


def mutate(data: bytes, chance: random.Random) -> bytes:
    """Return damaged bytes: one kind of damage at a random place; may equal ``data`` by chance."""
    if not data:
        return chance.randbytes(1)
    changed = bytearray(data)
    chance.choice(MUTATIONS)(changed, chance)
    return bytes(changed)


SCANS = 200  # scans of each joint that are damaged, again and again
READINGS = ("gap_voltages", "ring_voltages", "diode_currents", "lit_sources")
ENVIRONMENT = "supply or temperature"
COUPLED = (ENVIRONMENT, "diode_currents")
"""Damage to one of these changes several readings: those of all probes, or both coordinates of a spot."""
OUTCOMES = ("refused", "unharmed", "within the protection level", "possible", "wrong")
"""No pose, or the message refused; a pose that does not differ; a pose that differs, with one reading damaged; a pose
that differs, with several readings or the environment damaged, which agree with one another; a pose that differs
otherwise."""
MOST_EXAMPLES = 10


@dataclass(frozen=True)
class JointRecording:
    """Undamaged scans of a joint, and their transforms and estimates by the byte path."""

    posor: Posor
    stream: RawScanStream  # byte path of posor_node
    scans: list[bytes]  # serialised raw scans
    transforms: list[bytes]  # serialised transforms of them
    estimates: list[Any]  # records of dtype ESTIMATE
    trackers: list[Any]  # state of the tracker before each scan
    usable: list[int]  # scans with a pose, all but the first


def record(simulation: ArmSimulation, joint: str, count: int = SCANS, cycle: int = 0) -> JointRecording:
    """Estimate simulated scans of a joint from the beginning of a cycle of the scenario on."""
    messages = SimulatedMessages(MessageTypes(), simulation)
    ticks = np.arange(1, count + 1) + cycle * simulation.scenario.cycle_ticks
    simulated = simulation.scans(joint, ticks, simulation.truth(ticks))
    scans = [messages.raw_scan(joint, simulated, n).data for n in range(count)]
    posor = Posor(simulation.calibrations[joint])
    stream = RawScanStream(posor, scans[0])
    trackers, transforms, estimates = [], [], []
    for data in scans:
        trackers.append(posor.model.workspace["tracker"].copy())
        transforms.append(stream.estimate_message(data) or b"")
        estimates.append(stream.last_scan().estimate)
    usable = [n for n in range(1, count) if estimates[n]["state"] in USABLE_STATES]
    return JointRecording(posor, stream, scans, transforms, estimates, trackers, usable)


class MessageFuzz(ABC):
    """Counts the outcomes of damaged messages, by ``OUTCOMES``; keeps the first ``examples`` of a wrong pose."""

    def __init__(self, seed: str) -> None:
        self.outcomes, self.examples = Counter(dict.fromkeys(OUTCOMES, 0)), list[str]()
        self.chance = random.Random(seed)  # noqa: S311  damage

    def run(self, mutations: int) -> None:
        """Damage messages ``mutations`` times."""
        for _ in range(mutations):
            self._damage_one()

    @abstractmethod
    def _damage_one(self) -> None: ...

    def _count(self, outcome: str, example: str = "") -> None:
        self.outcomes[outcome] += 1
        if example and len(self.examples) < MOST_EXAMPLES:
            self.examples.append(example)


class ScanFuzz(MessageFuzz):
    """Damaged raw scans of one joint, each estimated after the undamaged scan before it."""

    def __init__(self, simulation: ArmSimulation, joint: str, seed: int) -> None:
        """Estimate the undamaged scans; ``seed`` is that of the damage."""
        super().__init__(f"{joint} {seed}")
        self._simulation, self._joint = simulation, joint
        self.begin_cycle(0)

    def begin_cycle(self, cycle: int) -> None:
        """Damage scans from the beginning of this cycle of the scenario on."""
        self.recording = record(self._simulation, self._joint, cycle=cycle)
        self._levels: dict[int, FloatArray] = {}

    def _damage_one(self) -> None:
        n = self.chance.choice(self.recording.usable)
        data = mutate(self.recording.scans[n], self.chance)
        found = self._estimate(n, data)
        self.judge(n, data, None if found is None or found["state"] not in USABLE_STATES else _pose_of(found))

    def judge(self, n: int, data: bytes, found: pin.SE3 | None) -> None:
        """Count the outcome of damaged bytes in place of scan n; ``found``: pose published as valid, or None."""
        if found is None:
            self._count("refused")
            return
        if self.is_near(n, found):
            self._count("unharmed")
            return
        error = pose_difference(found, _pose_of(self.recording.estimates[n]))
        changed = changed_readings(self.recording.scans[n], data)
        if len(changed) == 1 and ENVIRONMENT not in changed and np.all(np.abs(error) <= self._protection_level(n)):
            self._count("within the protection level")
        elif len(changed) > 1 or any(name.startswith(COUPLED) for name in changed):
            self._count("possible")
        else:
            readings = ", ".join(sorted(changed)) or "no reading"
            self._count("wrong", f"scan {n}, {readings} changed: off by {_micro(error)}")

    def is_near(self, n: int, found: pin.SE3) -> bool:
        """Return whether a pose agrees with scan n within 5 standard deviations."""
        expected = self.recording.estimates[n]
        sigmas = np.sqrt(np.diag(expected["random"] + expected["systematic"]))
        return bool(np.all(np.abs(pose_difference(found, _pose_of(expected))) <= SIGMAS * sigmas))

    def _estimate(self, n: int, data: bytes) -> Any | None:
        """Return the estimate of damaged bytes in place of scan n, as posor_node makes it; None: refused."""
        recording = self.recording
        recording.posor.model.workspace["tracker"] = recording.trackers[n]
        stream = recording.stream
        if stream.identity(data) is None or stream.estimate_message(data) is None:
            try:
                data = installed_schema(RAW_SCAN).normal(data)
                stream = RawScanStream(recording.posor, data)
            except TopicError:
                return None
            if stream.estimate_message(data) is None:
                return None
        last = stream.last_scan()
        return last.estimate if last.stamp_ns and not last.refusal else None

    def _protection_level(self, n: int) -> FloatArray:
        """Return the bound of the error of pose n by one reading, (6,)."""
        if n not in self._levels:
            recording, tracker = self.recording, self.recording.posor.tracker.copy()
            recording.posor.model.workspace["tracker"] = recording.trackers[n]
            scans = Scans.of([scan_of(recording.scans[n])])
            found = recording.posor.estimate_all(scans, fault_effects=True)
            recording.posor.model.workspace["tracker"] = tracker
            self._levels[n] = joint_protection_levels(recording.posor, found).levels[0]
        return self._levels[n]


def _pose_of(estimate: Any) -> pin.SE3:
    """Return the pose of a record of dtype ESTIMATE."""
    return pin.SE3(estimate["rotation"], estimate["translation"])


def _micro(error: FloatArray) -> str:
    return f"{np.round(1e6 * error, 2).tolist()} um, urad"


def pose_difference(found: pin.SE3, expected: pin.SE3) -> FloatArray:
    """Return the difference of two poses in ROS order, (6,)."""
    one, other = (PoseArray(np.array([each.rotation]), np.array([each.translation])) for each in (found, expected))
    return np.asarray(small_errors(one, other)[0])


def changed_readings(before: bytes, after: bytes) -> set[str]:
    """Return which readings differ between two scans, those of a diode as one; ENVIRONMENT for supply, temperature."""
    one, other = scan_of(before), scan_of(after)
    changed = set()
    for name in READINGS:
        values, others = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        if values.shape != others.shape:
            return {name, f"number of {name}"}
        if values.size:
            differs = (values != others).reshape(len(values), -1).any(axis=1)
            changed |= {f"{name}[{i}]" for i in np.flatnonzero(differs)}
    first, second = ((each.supply_voltage, each.temperature, each.reference_voltage) for each in (one, other))
    if not np.array_equal(first, second, equal_nan=True):
        changed.add(ENVIRONMENT)
    return changed


class TransformFuzz(MessageFuzz):
    """Damaged transforms of one joint of a whole scan, read as chain_node reads them."""

    def __init__(self, simulation: ArmSimulation, seed: int) -> None:
        """Estimate the undamaged scans of all joints."""
        super().__init__(f"transforms {seed}")
        chain = simulation.chain
        recordings = [record(simulation, joint.name) for joint in chain.joints]
        self._formats = [JointTransformFormat(each.transforms[0]) for each in recordings]
        self._estimator = chain.estimator(0.0, [each.row_layout for each in self._formats])
        usable = set.intersection(*(set(each.usable) for each in recordings))
        self._scans = [[each.transforms[n] for each in recordings] for n in sorted(usable)]

    def _damage_one(self) -> None:
        scan, j = self.choose()
        found = self._endpoint([*scan[:j], mutate(scan[j], self.chance), *scan[j + 1 :]])
        self.judge(scan, j, None if found is None else found[0])

    def choose(self) -> tuple[list[bytes], int]:
        """Return the transforms of a scan, and the index of the joint whose transform is to be damaged."""
        return self.chance.choice(self._scans), self.chance.randrange(len(self._formats))

    def judge(self, scan: list[bytes], j: int, found: pin.SE3 | None) -> None:
        """Count the outcome of a scan with a damaged transform of joint j; ``found``: endpoint pose, or None."""
        if found is None:
            self._count("refused")
        elif self.is_near(scan, found):
            self._count("unharmed")
        else:
            error = pose_difference(found, self._expected(scan)[0])
            self._count("wrong", f"joint {j}: endpoint off by {_micro(error)}")

    def is_near(self, scan: list[bytes], found: pin.SE3) -> bool:
        """Return whether an endpoint pose agrees with the undamaged transforms within 5 standard deviations."""
        pose, covariance = self._expected(scan)
        return bool(np.all(np.abs(pose_difference(found, pose)) <= SIGMAS * np.sqrt(np.diag(covariance))))

    def _expected(self, scan: list[bytes]) -> tuple[pin.SE3, FloatArray]:
        expected = self._endpoint(scan)
        if expected is None:
            raise TopicError("undamaged transforms were refused", where="fuzz")
        return expected

    def _endpoint(self, scan: list[bytes]) -> tuple[pin.SE3, FloatArray] | None:
        """Return pose and covariance of the endpoint; None: refused."""
        for row, kind, data in zip(self._estimator.rows, self._formats, scan, strict=True):
            plain = data
            if not kind.matches(data):
                try:
                    plain = installed_schema(JOINT_TRANSFORM).normal(data)
                    found = JointTransformFormat(plain)
                except TopicError:
                    return None
                if found.constants != kind.constants:
                    return None
            row[LEAD : LEAD + kind.size] = np.frombuffer(plain[: kind.size], dtype=np.uint8)
        if self._estimator.estimate_rows(1) < 0:
            return None
        return pin.XYZQUATToSE3(self._estimator.pose), self._estimator.covariance()


def fuzz_simulation(arm: ArmFile) -> ArmSimulation:
    """Return the simulation of an arm whose only imperfection is noise."""
    return ArmSimulation(arm, Imperfections.only("noise"))
