"""Arms of any number of POSORs for the benchmark, and a bag of their scans: the six-axis arm, cut or repeated.

Joint 7 is a base turn mounted on the endpoint of the first six, and so on. A joint's scans do not depend on how many
there are, so that all arms play one bag: the simulator's, from the home marks and back to them, and none left out.
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
from posor_bringup.arms import checked_arm
from posor_drivers.bag_writer import BagWriter
from posor_drivers.offered_qos import kept_in_bag
from posor_drivers.simulated_messages import SimulatedMessages
from posor_drivers.simulator.arm import ArmSimulation
from posor_drivers.simulator.switches import Switches
from posor_estimator.core.arm import Arm, load_arm
from posor_estimator.ros.cdr_scan import RAW_SCAN as RAW_SCAN_SCHEMA
from posor_estimator.ros.message_types import RAW_SCAN, MessageTypes
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import RAW_TOPIC, sensor_qos

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = "six_axis"
NAME = "bench"
RATE = 2000
"""Of the bag [Hz]."""
TICKS = 1000
"""Scans of each joint in the bag; the source plays them forth and back."""
SPEED = 0.4
"""Mean speed of every joint while it moves [rad/s]."""
SIMULATED = Switches(dropouts=False, calibration_errors=False, beam_errors=False, inertia=False)
"""Without what makes scans useless: an arm of sixteen joints is longer than its POSORs could bear."""
PROVENANCE = {"source": "assumed", "method": f"made of the parts of {PARTS} by the benchmark", "date": "none"}


def made_arm(folder: Path, joints: int, scans: Path) -> Arm:
    """Write the files of an arm.

    Args:
        folder: Where to; is made.
        joints: How many POSORs.
        scans: The bag that its drivers play, see ``record``.

    """
    folder.mkdir(parents=True)
    parts = checked_arm(PARTS)
    chain = _Chain(parts, joints)
    (folder / "bench.urdf").write_text(ET.tostring(chain.robot, encoding="unicode"), encoding="utf-8")
    _write(folder / "beams.yaml", {**_read(parts.beams), "name": NAME, "provenance": PROVENANCE, "beams": chain.beams})
    for joint, calibration in chain.calibrations.items():
        _write(folder / f"{joint}.yaml", calibration)
    _write(folder / "scenario.yaml", _scenario(_read(parts.scenario), list(chain.calibrations)))
    content = {
        "format": "posor_arm",
        "version": 1,
        "name": NAME,
        "provenance": PROVENANCE,
        "urdf": "bench.urdf",
        "endpoint_frame": chain.endpoint,
        "beams": "beams.yaml",
        "joints": {joint: {"calibration": f"{joint}.yaml"} for joint in chain.calibrations},
        "chain": {"parameters": dict(parts.chain_parameters)},
        "driver": {
            "source": "looped",
            "parameters": {
                "looped.path": str(scans),
                "looped.topic": f"/{{arm}}/{{joint}}/{RAW_TOPIC}",
            },
        },
        "scenario": "scenario.yaml",
    }
    _write(folder / "arm.yaml", content)
    return load_arm(folder / "arm.yaml")


def record(arm: Arm, path: Path, bad_every: int = 0) -> None:
    """Write the scans of one cycle of an arm's scenario into a new bag.

    Args:
        arm: The arm.
        path: Of the bag.
        bad_every: Of so many scans of the first joint one lacks a reading; 0: none.

    """
    simulation, types = ArmSimulation(arm, SIMULATED), MessageTypes()
    make, ticks = SimulatedMessages(types, simulation), np.arange(1, TICKS + 1)
    qos = [kept_in_bag(sensor_qos(NodeParameters()))]
    with BagWriter(path) as bag:
        for number, joint in enumerate(simulation.joints):
            topic = f"/{arm.name}/{joint}/{RAW_TOPIC}"
            bag.add_topic(topic, RAW_SCAN, types.definition(RAW_SCAN), qos)
            scans = simulation.scans(joint, ticks)
            for n in range(TICKS):
                message = make.raw(joint, scans, n)
                bad = number == 0 and bad_every > 0 and n % bad_every == bad_every // 2
                bag.write(topic, message.time_ns, _without_a_reading(message.data) if bad else message.data)


def _without_a_reading(data: bytes) -> bytes:
    """Return a raw scan with a gap voltage that is none."""
    spoiled = bytearray(data)
    struct.pack_into("<d", spoiled, RAW_SCAN_SCHEMA.layout(data)["gap_voltages"].offset, math.nan)
    return bytes(spoiled)


class _Chain:
    """The first joints of an endless arm of the same six."""

    def __init__(self, parts: Arm, joints: int) -> None:
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
        """Yield name in the parts, renamed element and suffix of joint after joint; append each, and its child link."""
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


def _scenario(content: Any, joints: list[str]) -> dict[str, Any]:
    """Return a scenario of the given electronics and joints of perfect mechanics: away from home and back."""
    seconds = TICKS / RATE
    rest, away = 0.1 * seconds, 0.8 * seconds
    reach = SPEED * away / 2.0
    still = {"kind": "rest", "duration": {"value": rest, "unit": "s"}}
    there = {
        "kind": "spline",
        "duration": {"value": away, "unit": "s"},
        "joints": joints,
        "through": {"value": [[reach] * len(joints), [0.0] * len(joints)], "unit": "rad"},
    }
    return {
        "format": "posor_scenario",
        "version": 1,
        "name": NAME,
        "provenance": PROVENANCE,
        "seed": content["seed"],
        "rate": {"value": RATE, "unit": "Hz"},
        "duration": {"value": seconds, "unit": "s"},
        "joints": {joint: {} for joint in joints},
        "motion": [still, there, still],
        "electronics": content["electronics"],
    }


def _read(path: Path | None) -> Any:
    return {} if path is None else yaml.safe_load(path.read_text(encoding="utf-8"))


def _write(path: Path, content: object) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
