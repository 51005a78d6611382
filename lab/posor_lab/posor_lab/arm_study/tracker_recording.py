# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of a calibration of a whole arm, as a user has them: arm file, bag of raw scans, table of a tracker, its map.

The arm moves from dwell to dwell. Its POSORs, beams and reflectors differ from the files; the tracker is simulated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import yaml
from posor.bags.bag_writer import replace_bag
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import read_text
from posor.chain.arm_file import load_arm_file
from posor.messages.message_definitions import MessageTypes
from posor.output_files import write_files
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_ros.qos import SENSOR_QOS

from posor_lab.arm_study.calibration_truth import (
    PER_METRE,
    REFLECTORS,
    T_TRACKER_BASE,
    TOOL_SIGMA,
    TRACKER,
    write_assembled_arm,
)
from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

RATE = 200  # scans in a second
MOVE_S, REST_S = 2.4, 0.4
START_S = 1_767_225_600  # 2026-01-01 00:00:00 UTC
REACH = 0.6  # joint angles are drawn within this of zero [rad]: no ring moves by half a bump from scan to scan
SWITCHES = ("noise", "calibration_errors", "beam_errors", "sag")


def write_calibration_recording(arm: ArmFile, folder: Path, poses: int, seed: int) -> Path:
    """Write the files into a folder; return the path of the arm file. Raises PosorError: a file of the arm is invalid.

    The table has a row for each dwell, with the three reflectors beside each other.
    """
    random = np.random.default_rng(seed)
    path = write_assembled_arm(arm, folder)
    assert arm.scenario is not None  # noqa: S101  of a simulated arm
    joints = list(arm.calibrations)
    angles = np.round(random.uniform(-REACH, REACH, (poses, len(joints))), 3)
    motion: list[dict[str, object]] = [{"kind": "rest", "duration": quantity(REST_S, "s")}]
    for row in [*angles, np.zeros(len(joints))]:
        through = quantity([row.tolist()], "rad")
        motion.append({"kind": "spline", "duration": quantity(MOVE_S, "s"), "joints": joints, "through": through})
        motion.append({"kind": "rest", "duration": quantity(REST_S, "s")})
    duration = REST_S + (MOVE_S + REST_S) * (poses + 1)
    changes = {
        "motion": motion,
        "duration": quantity(round(duration, 6), "s"),
        "rate": quantity(RATE, "Hz"),
        "seed": seed,
    }
    scenario = edit_document(read_text(arm.scenario, "scenario"), str(arm.scenario), changes)
    text = edit_document(read_text(path, "arm file"), str(path), {"scenario": "scenario.yaml"})
    write_files({folder / "scenario.yaml": scenario, folder / "arm.yaml": text})
    simulation = ArmSimulation(load_arm_file(path), Imperfections.only(*SWITCHES))
    cycle = round(duration * RATE)
    first = -(-START_S * RATE // cycle) * cycle  # of the cycle that begins next
    ticks = np.arange(first, first + cycle)
    _write_bag(simulation, ticks, folder / "bag")
    dwells = np.round((REST_S + MOVE_S + 0.5 * REST_S + (MOVE_S + REST_S) * np.arange(poses)) * RATE).astype(np.int64)
    endpoints = simulation.truth(first + dwells).endpoint
    reflectors = {name: np.array(place) + TOOL_SIGMA * random.normal(size=3) for name, place in REFLECTORS.items()}
    lines = [";".join(["Time", *(f"{name} {axis} [mm]" for name in reflectors for axis in "XYZ")])]
    for n, dwell in enumerate(dwells.tolist()):
        row = [f"{(first + dwell) / RATE - START_S:.3f}"]
        for place in reflectors.values():
            point = T_TRACKER_BASE.act(endpoints[n].act(place))
            sigma = TRACKER + PER_METRE * float(np.linalg.norm(point))
            row += [f"{1e3 * x:.4f}" for x in point + sigma * random.normal(size=3)]
        lines.append(";".join(row))
    table_map = yaml.safe_dump(_map(), sort_keys=False)
    write_files({folder / "tracker.csv": "\n".join(lines) + "\n", folder / "map.yaml": table_map})
    return path


def _map() -> dict[str, object]:
    return {
        "format": "posor_table_map",
        "version": 1,
        "name": "tracker",
        "file": {"separator": ";"},
        "time": {"column": "Time", "unit": "s", "start": "2026-01-01T00:00:00Z"},
        "references": {
            name: {
                "frame_id": "tracker",
                "position": [{"column": f"{name} {axis} [mm]", "unit": "mm"} for axis in "XYZ"],
                "missing": "allowed",
            }
            for name in REFLECTORS
        },
    }


def _write_bag(simulation: ArmSimulation, ticks: np.ndarray, bag: Path) -> None:
    types = MessageTypes()
    make, name = SimulatedMessages(types, simulation), simulation.arm.name
    scans = {f"/{name}/{joint}/{RAW_TOPIC}": (joint, simulation.scans(joint, ticks)) for joint in simulation.joints}
    with replace_bag(bag) as writer:
        for topic in scans:
            writer.add_topic(topic, RAW_SCAN, types.definition(RAW_SCAN), [SENSOR_QOS])
        for n in range(len(ticks)):
            for topic, (joint, own) in scans.items():
                message = make.raw_scan(joint, own, n)
                writer.write(topic, message.time_ns, message.data)
