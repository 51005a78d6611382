# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arms of any number of POSORs for the benchmark, made of the parts of the six-axis arm, and a bag of their scans.

Joint 7 is the base turn again, mounted on the endpoint of the first six, and so on. The scans of a joint do not
depend on the number of joints, so all arms play the same bag: simulated motion from the home marks and back.
"""

from __future__ import annotations

import math
import struct
from copy import deepcopy
from itertools import count
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from posor.bags.bag_writer import BagWriter
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.node_parameters import NodeParameters
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_bringup.arms import load_checked_arm
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_ros.qos import result_qos

from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = "six_axis"
NAME = "bench"
RATE = 2000  # rate of the bag [Hz]
TICKS = 1000  # scans of each joint in the bag; the source plays every second one forwards, the others backwards
SPEED = 0.2  # mean speed of every joint while it moves, as recorded; the source plays it twice as fast [rad/s]
SIMULATED = Imperfections(
    ambient_light=False, dropouts=False, calibration_errors=False, beam_errors=False, inertia=False
)
"""Imperfections that would make scans unusable are off: an arm of sixteen joints overloads its POSORs."""
PROVENANCE = {"source": "assumed", "method": f"made of the parts of {PARTS} by the benchmark", "date": "none"}


def generate_arm(folder: Path, joints: int, scans: Path) -> ArmFile:
    """Write the files of an arm into a new folder and load it; its drivers play the bag ``scans``."""
    folder.mkdir(parents=True)
    parts = load_checked_arm(PARTS)
    chain = _Chain(parts, joints)
    (folder / "bench.urdf").write_text(ET.tostring(chain.robot, encoding="unicode"), encoding="utf-8")
    _write(folder / "beams.yaml", {**_read(parts.beams), "name": NAME, "provenance": PROVENANCE, "beams": chain.beams})
    for joint, calibration in chain.calibrations.items():
        _write(folder / f"{joint}.yaml", calibration)
    _write(folder / "scenario.yaml", _scenario(_read(parts.scenario), list(chain.calibrations)))
    driver = {"looped.path": str(scans), "looped.topic": f"/{{arm}}/{{joint}}/{RAW_TOPIC}"}
    content = {
        **_head("posor_arm"),
        "urdf": "bench.urdf",
        "endpoint_frame": chain.endpoint,
        "beams": "beams.yaml",
        "joints": {joint: {"calibration": f"{joint}.yaml"} for joint in chain.calibrations},
        "chain": {"parameters": dict(parts.chain_parameters)},
        "driver": {"source": "looped", "parameters": driver},
        "scenario": "scenario.yaml",
    }
    _write(folder / "arm.yaml", content)
    return load_arm_file(folder / "arm.yaml")


def record_scans(arm: ArmFile, path: Path, fault_interval: int = 0) -> None:
    """Write the scans of one cycle of an arm's scenario into a new bag.

    ``fault_interval``: scans of the first joint from one without a reading to the next; 0: no faults.
    """
    simulation, types = ArmSimulation(arm, SIMULATED), MessageTypes()
    make, ticks = SimulatedMessages(types, simulation), np.arange(1, TICKS + 1)
    qos = [result_qos(NodeParameters())]
    with BagWriter(path) as bag:
        for number, joint in enumerate(simulation.joints):
            topic = f"/{arm.name}/{joint}/{RAW_TOPIC}"
            bag.add_topic(topic, RAW_SCAN, types.definition(RAW_SCAN), qos)
            scans = simulation.scans(joint, ticks)
            for n in range(TICKS):
                message = make.raw_scan(joint, scans, n)
                is_faulty = number == 0 and fault_interval > 0 and n % fault_interval == fault_interval // 2
                bag.write(topic, message.time_ns, _without_a_reading(message.data) if is_faulty else message.data)


def _without_a_reading(data: bytes) -> bytes:
    """Return a raw scan with NaN as its first gap voltage."""
    faulty = bytearray(data)
    struct.pack_into("<d", faulty, installed_schema(RAW_SCAN).layout(data)["gap_voltages"].offset, math.nan)
    return bytes(faulty)


class _Chain:
    """The first joints of an arm that repeats the same six joints."""

    def __init__(self, parts: ArmFile, joints: int) -> None:
        tree = ET.parse(parts.urdf).getroot()  # noqa: S314  installed with this package
        self._links = {str(link.get("name")): link for link in tree.findall("link")}
        self._joints = {_end(joint, "parent"): joint for joint in tree.findall("joint")}
        self._parts = parts
        known = {beam["joint"]: beam for beam in _read(parts.beams)["beams"]}
        self.robot = ET.Element("robot", name=NAME)
        self.robot.extend(deepcopy(tree.findall("material")))
        self.robot.append(deepcopy(self._links["base"]))
        self.beams: list[Any] = []
        self.calibrations: dict[str, Any] = {}
        self.endpoint = ""
        for name, joint, suffix in self._walk():
            if joint.get("type") == "floating":
                self.calibrations[name + suffix] = self._calibration(name, joint)
            else:
                self.endpoint = _end(joint, "child")
                if name in known:
                    self.beams.append({**known[name], "joint": name + suffix})
                if len(self.calibrations) == joints:
                    return

    def _walk(self) -> Iterator[tuple[str, ET.Element, str]]:
        """Yield original name, renamed element and suffix of each joint; append the joint and its child link."""
        above = "base"
        for copy in count(1):
            suffix, link = f"_{copy}" if copy > 1 else "", "base"
            while link in self._joints:
                joint, child = deepcopy(self._joints[link]), deepcopy(self._links[_end(self._joints[link], "child")])
                link = str(child.get("name"))
                name, below = str(joint.get("name")), link + suffix
                joint.set("name", name + suffix)
                for end, where in (("parent", above), ("child", below)):
                    for element in joint.findall(end):
                        element.set("link", where)
                child.set("name", below)
                self.robot.extend([joint, child])
                above = below
                yield name, joint, suffix

    def _calibration(self, name: str, joint: ET.Element) -> Any:
        frames = {"parent": _end(joint, "parent"), "child": _end(joint, "child")}
        return {**_read(self._parts.calibrations[name]), "frames": frames}


def _end(joint: ET.Element, which: str) -> str:
    found = joint.find(which)
    return "" if found is None else str(found.get("link"))


def _head(file_format: str) -> dict[str, Any]:
    return {"format": file_format, "version": 1, "name": NAME, "provenance": PROVENANCE}


def _scenario(content: Any, joints: list[str]) -> dict[str, Any]:
    """Return a scenario with the given electronics and perfect joints that moves away from home and back."""
    seconds = TICKS / RATE
    rest, away = 0.1 * seconds, 0.8 * seconds
    reach = SPEED * away / 2.0
    still = {"kind": "rest", "duration": quantity(rest, "s")}
    through = quantity([[reach] * len(joints), [0.0] * len(joints)], "rad")
    there = {"kind": "spline", "duration": quantity(away, "s"), "joints": joints, "through": through}
    return {
        **_head("posor_scenario"),
        "seed": content["seed"],
        "rate": quantity(RATE, "Hz"),
        "duration": quantity(seconds, "s"),
        "joints": {joint: {} for joint in joints},
        "motion": [still, there, still],
        "electronics": content["electronics"],
    }


def _read(path: Path | None) -> Any:
    return {} if path is None else yaml.safe_load(path.read_text(encoding="utf-8"))


def _write(path: Path, content: object) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
