# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recording of a commissioning of a simulated arm, with exchanged plugs, inverted signals and wrong files.

The simulator moves the arm through all steps; probes are lifted, diodes covered and plugs exchanged in its raw scans.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from numpy.polynomial import polynomial
from posor.arm_names import ARM_FILE, find_arm
from posor.bags.recording import Track
from posor.calibration.calibration_file import calibration_from
from posor.chain.arm_file import load_arm_file
from posor.model.scan import HOME_BUMP
from posor.numerics.stamps import tick_stamp_ns
from posor.ros_names import COMMISSIONING_STEP, COMMISSIONING_TOPIC, JOINT_STATE, POINT_STAMPED
from posor_calibration.commissioning.commissioning_recording import BEGIN, END, CommissioningRecording, RecordedStep
from posor_calibration.commissioning.plan import CommissioningSettings, diodes_of, probe_gaps, probes_of, steps_of
from posor_drivers.message_builder import header, point_stamped
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections

from posor_lab.harness.beams import quantity
from posor_lab.harness.calibration_bag import TYPES, Entry, raw, write_bag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray
    from posor_calibration.commissioning.plan import Step

RATE = 40  # scans per second: below 28 bumpy rings lose their count
REST_S, SWEEP_S, MOVE_S = 0.5, 12.0, 8.0  # time of a step at rest, of a sweep, and of the way to a posture
POSTURES = 8
SETTINGS = CommissioningSettings(postures=POSTURES)
IMPERFECTIONS = Imperfections(dropouts=False, zero_drift=False)
LARGEST_ANGLE = 0.6  # of a joint in a posture [rad]
START_S = 1_767_225_600
GRID = 20_001  # points of a curve that is inverted
REFERENCE = "/reference"
READINGS = ("gap_voltages", "ring_voltages", "diode_currents", "lit_sources")


@dataclass(frozen=True)
class WiringFault:
    """What is wrong with an arm; a signal is ``joint channel``, of one contact ``joint diode contact``."""

    name: str
    found_by: tuple[str, ...]  # kinds of checks that may find it
    exchange: tuple[
        tuple[str, ...], ...
    ] = ()  # the signal of each entry arrives as the next one, that of the last as the first
    invert: tuple[str, ...] = ()  # signals of the wrong sign; ``joint encoder`` is that of an encoder
    shift_sources: Mapping[str, int] = field(default_factory=dict)  # by which light sources are misnumbered, by joint
    calibration: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # factors of numbers, by joint and key
    calibration_of: Mapping[str, str] = field(default_factory=dict)  # another joint's file, by joint
    longer: Mapping[str, float] = field(default_factory=dict)  # by which the URDF has a beam longer [m]
    gravity: tuple[float, ...] = ()  # in the beams file [m/s^2]; empty: as it is
    serial: str = ""  # on the arm's plate; empty: that of the arm file


class SimulatedCommissioning:
    """The commissioning of a sound arm.

    Attributes:
        arm: A copy of the arm, with a serial number and the motion of the commissioning.
        calibrations: Of its joints.
        recording: Of all steps.

    """

    def __init__(self, name: str, folder: Path, seed: int, settings: CommissioningSettings = SETTINGS) -> None:
        """Write the copy into ``folder``, which does not exist yet, and simulate; the seed draws the arm."""
        shutil.copytree(find_arm(name).parent, folder)
        path = folder / ARM_FILE
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        serial = f"{name}-{seed}"
        path.write_text(yaml.safe_dump(content | {"serial": serial}, sort_keys=False), encoding="utf-8")
        self.arm = load_arm_file(path)
        self.calibrations = {joint: self.arm.calibration(joint) for joint in self.arm.calibrations}
        self.settings = replace(settings, serial=serial)
        self._random = np.random.default_rng(seed)
        spans = self._write_scenario(steps_of(self.calibrations, self.settings), seed)
        simulation = ArmSimulation(self.arm, IMPERFECTIONS)
        cycle = simulation.scenario.cycle_ticks
        ticks = START_S * RATE // cycle * cycle + np.arange(cycle)
        truth, stamps = simulation.truth(ticks), tick_stamp_ns(ticks, RATE)
        steps = [RecordedStep(step, int(stamps[begin]), int(stamps[end - 1])) for step, (begin, end) in spans.items()]
        for joint in simulation.joints:
            simulation.start_at(joint, int(ticks[0]))
        scans = {joint: simulation.scans(joint, ticks).scans for joint in simulation.joints}
        for step in steps:
            self._touch(scans, step)
        encoders = {
            joint: Track(stamps, truth.encoder[:, [column]], np.zeros(1), "encoder")
            for column, joint in enumerate(truth.joints)
        }
        points = truth.endpoint.translations + self.settings.reference * self._random.normal(size=(len(ticks), 3))
        frame = simulation.chain.base_frame
        reference = Track(stamps, points, np.zeros(3), "reference")
        self.recording = CommissioningRecording(scans, encoders, steps, reference, frame, f"simulated {name}")

    def _write_scenario(self, steps: Sequence[Step], seed: int) -> dict[Step, tuple[int, int]]:
        """Write the motion of all steps; return the first tick of each, and the tick after its last."""
        motion: list[dict[str, Any]] = []
        spans: dict[Step, tuple[int, int]] = {}
        now_s, joints = 0.0, list(self.calibrations)

        def move(names: list[str], through: list[list[float]], duration_s: float) -> None:
            nonlocal now_s
            spline = {"kind": "spline", "duration": quantity(duration_s, "s"), "joints": names}
            motion.append(spline | {"through": quantity(through, "rad")})
            now_s += duration_s

        for step in steps:
            if step.action == "posture":
                move(joints, [self._random.uniform(-LARGEST_ANGLE, LARGEST_ANGLE, len(joints)).tolist()], MOVE_S)
            begin = round(now_s * RATE)
            if step.action == "sweep":
                half = 0.5 * step.size
                move([step.joint], [[half], [-half], [0.0]], SWEEP_S)
            else:
                motion.append({"kind": "rest", "duration": quantity(REST_S, "s")})
                now_s += REST_S
            spans[step] = begin, round(now_s * RATE)
        move(joints, [[0.0] * len(joints)], MOVE_S)
        path = self.arm.path.parent / "scenario.yaml"
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content |= {"seed": seed, "rate": quantity(RATE, "Hz"), "duration": quantity(now_s, "s"), "motion": motion}
        content["electronics"].pop("contamination", None)
        for joint in content["joints"].values():
            joint.pop("start", None)
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        return spans

    def _touch(self, scans: dict[str, Scans], step: RecordedStep) -> None:
        """Lift the probe or cover the diode of a step."""
        _, joint, channel, size, _ = step.step
        stamps = scans[joint].stamps_ns if joint else np.empty(0)
        during = (stamps >= step.begin_ns) & (stamps <= step.end_ns)
        calibration = self.calibrations.get(joint)
        if calibration is None or step.step.action not in {"lift", "cover"}:
            return
        if step.step.action == "cover":
            currents = scans[joint].diode_currents.copy()
            currents[during, diodes_of(calibration).index(channel)] = 0.0
            scans[joint] = scans[joint].with_fields({"diode_currents": currents})
            return
        field_name, index, probe = probes_of(calibration)[channel]
        lift = size + self.settings.lift_sigma * self._random.normal()
        low, high = (1.5 * probe.range.array).tolist()
        volts = np.linspace(low, high, GRID)
        curve = polynomial.polyval(volts, probe.volts_to_gap.array)
        order = np.argsort(curve)
        lifted = np.interp(probe_gaps(calibration, scans[joint])[channel] + lift, curve[order], volts[order])
        values = getattr(scans[joint], field_name).copy()
        values[during, index] = lifted[during] - probe.zero_shift.number
        scans[joint] = scans[joint].with_fields({field_name: values})

    def recording_with(self, fault: WiringFault) -> CommissioningRecording:
        """Return the recording of the arm with exchanged plugs and inverted signals."""
        arrays = {
            joint: {name: getattr(scans, name).copy() for name in READINGS}
            for joint, scans in self.recording.scans.items()
        }
        for cycle in fault.exchange:
            places = [self._place(arrays, signal) for signal in cycle]
            values = [array[index].copy() for array, index in places]
            for (array, index), value in zip(places, [values[-1], *values[:-1]], strict=True):
                array[index] = value
        encoders = dict(self.recording.encoders)
        for signal in fault.invert:
            joint, channel = signal.split(maxsplit=1)
            if channel == "encoder":
                encoders[joint] = replace(encoders[joint], values=-encoders[joint].values)
            else:
                array, index = self._place(arrays, signal)
                array[index] *= -1.0
        for joint, shift in fault.shift_sources.items():
            arrays[joint]["lit_sources"] += shift
        scans = {joint: each.with_fields(arrays[joint]) for joint, each in self.recording.scans.items()}
        return replace(self.recording, scans=scans, encoders=encoders)

    def _place(self, arrays: Mapping[str, Mapping[str, Any]], signal: str) -> tuple[Any, tuple[Any, ...]]:
        """Return the array that holds a signal, and its index."""
        joint, channel, *contact = signal.split()
        calibration = self.calibrations[joint]
        if channel in diodes_of(calibration):
            index = (slice(None), diodes_of(calibration).index(channel), *("ABCD".index(each) for each in contact))
            return arrays[joint]["diode_currents"], index
        name, number, _ = probes_of(calibration)[channel]
        return arrays[joint][name], (slice(None), number)

    def write_bag(self, recording: CommissioningRecording, path: Path) -> Path:
        """Write a recording as a bag with the topics of the arm and, on ``/reference``, the reference."""
        name, entries = self.arm.name, list[Entry]()
        for joint, scans in recording.scans.items():
            statuses = (scans.statuses | HOME_BUMP * scans.at_home).tolist()
            entries += [raw(scans[n], status=status, topic=f"/{name}/{joint}/raw") for n, status in enumerate(statuses)]
        joints = list(recording.encoders)
        angles = np.column_stack([track.values for track in recording.encoders.values()])
        for stamp, row in zip(recording.encoders[joints[0]].stamps_ns.tolist(), angles, strict=True):
            stamped, empty = header(TYPES, stamp, ""), np.empty(0)
            message = TYPES.new(JOINT_STATE, header=stamped, name=joints, position=row, velocity=empty, effort=empty)
            entries.append((f"/{name}/encoders", JOINT_STATE, stamp, message))
        for step, begin_ns, end_ns in ((each.step, each.begin_ns, each.end_ns) for each in recording.steps):
            for phase, stamp in ((BEGIN, begin_ns), (END, end_ns)):
                message = TYPES.new(COMMISSIONING_STEP, header=header(TYPES, stamp, ""), phase=phase, **step._asdict())
                entries.append((f"/{name}/{COMMISSIONING_TOPIC}", COMMISSIONING_STEP, stamp, message))
        track = recording.reference
        for stamp, values in () if track is None else zip(track.stamps_ns.tolist(), track.values, strict=True):
            point = point_stamped(TYPES, stamp, recording.reference_frame, values)
            entries.append((REFERENCE, POINT_STAMPED, stamp, point))
        return write_bag(path, entries)

    def files_with(self, fault: WiringFault, folder: Path) -> tuple[ArmFile, dict[str, Calibration]]:
        """Write the wrong files of a fault into a folder; return the arm and the calibrations with them."""
        folder.mkdir()
        arm, calibrations = self.arm, dict(self.calibrations)
        for joint, other in fault.calibration_of.items():
            frames = calibrations[joint].frames
            calibrations[joint] = self.calibrations[other].model_copy(update={"frames": frames})
        for joint, factors in fault.calibration.items():
            content = calibrations[joint].model_dump(mode="json")
            for key, factor in factors.items():
                _multiply(content, key.split("."), factor)
            calibrations[joint] = calibration_from(content)
        if fault.longer:
            arm = replace(arm, urdf=folder / "arm.urdf")
            arm.urdf.write_text(_lengthened(self.arm.urdf.read_text(encoding="utf-8"), fault.longer), encoding="utf-8")
        if fault.gravity and arm.beams is not None:
            content = yaml.safe_load(arm.beams.read_text(encoding="utf-8"))
            content["gravity"] = quantity(list(fault.gravity), "m/s^2")
            arm = replace(arm, beams=folder / "beams.yaml")
            (folder / "beams.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        return arm, calibrations


def _multiply(content: Any, keys: list[str], factor: Any) -> None:
    """Multiply the number or numbers at a key of a file's content; ``*`` is every entry of a list or mapping."""
    key, *rest = keys
    places = range(len(content)) if isinstance(content, list) else content
    for place in list(places) if key == "*" else [int(key) if isinstance(content, list) else key]:
        if rest:
            _multiply(content[place], rest, factor)
        else:
            content[place] = (np.array(content[place]) * np.array(factor)).tolist()


def _lengthened(urdf: str, longer: Mapping[str, float]) -> str:
    """Return a URDF with longer fixed joints [m]."""
    root = ET.fromstring(urdf)  # noqa: S314  our own file
    for joint in root.findall("joint"):
        origin = joint.find("origin")
        if origin is not None and joint.get("name") in longer:
            place: FloatArray = np.array([float(each) for each in origin.get("xyz", "").split()])
            place *= 1.0 + longer[str(joint.get("name"))] / np.linalg.norm(place)
            origin.set("xyz", " ".join(map(repr, place.tolist())))
    return ET.tostring(root, encoding="unicode")
