# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The storm of faults through real posor_nodes: the program plays their drivers, without loss, in stretches.

After each stretch it waits for all transforms; between two of them an operator acknowledges, which the node refuses
where its last scan is not plausible. There is no encoder here: after an acknowledgement a bumpy ring is UNCOUNTED until
it passes its home mark. The transforms must equal those of the estimator alone with the same acknowledgements.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from posor.messages.message_definitions import MessageTypes
from posor.model.fault import State
from posor.node_parameters import RECORDING
from posor.ros_names import RAW_SCAN, RAW_TOPIC, TRANSFORM_TOPIC
from posor.uncertainty.protection_level import joint_protection_levels
from posor_bringup.supervisor import ProgramCommand
from posor_drivers.message_builder import raw_scan, scan_fields
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message

from posor_lab.faults.pose_judge import pose_array
from posor_lab.faults.storm import count_storm, estimate_storm, run_storm
from posor_lab.reports.graph_receiver import NodePlayer, running_graph

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import IntArray

    from posor_lab.faults.storm import Storm, StormCount, StormMaker
    from posor_lab.reports.graph_receiver import GraphWatch

NAMESPACE = "/storm"
PLAYER_ARGUMENTS = f"{NAMESPACE}/posor_node", [(RawScan, RAW_TOPIC)], (JointTransform, TRANSFORM_TOPIC)
"""Name of the node, its inputs, its answers, for ``NodePlayer``."""


def run_node_storm(
    calibration: Calibration, injected: int, seed: int, folder: Path, on_block: Callable[[int], None]
) -> StormCount:
    """Return the figures of a storm of one stack through posor_node; see ``run_storm``.

    Raises ProcessError: the node failed, or transforms do not come.
    """
    program = posor_program(calibration, folder)

    def count_block(maker: StormMaker, storm: Storm, _seed: int) -> StormCount:
        # A new node for each block: the true sensors are others.
        player = NodePlayer(*PLAYER_ARGUMENTS)
        with running_graph([program], player, folder, "storm") as watch:
            granted = play_storm(storm, player, watch)
            found = [deserialize_message(data, JointTransform) for data in player.answers]
        poses = pose_array([each.pose for each in found])
        states, faults = np.array([(each.state, each.faults) for each in found], dtype=np.int64).T
        covariances = np.reshape([each.covariance_random + each.covariance_systematic for each in found], (-1, 6, 6))
        expected = estimate_storm(maker.posor, replace(storm, acknowledgements=granted))
        effects = np.reshape([each.effects for each in found], np.shape(expected.fault_effects))
        same = (states == expected.states) & (faults == expected.faults)
        same &= np.all((poses.translations == expected.translations) | (states == State.LOST)[:, None], axis=1)
        same &= np.array(
            [np.array_equal(*each, equal_nan=True) for each in zip(effects, expected.fault_effects, strict=True)]
        )
        levels = joint_protection_levels(maker.posor, expected).levels  # of the published effects, as they are the same
        block = count_storm(storm, states, faults, poses, covariances, levels)
        return replace(block, different=int(np.count_nonzero(~same)))

    return run_storm(calibration, injected, seed, on_block, count_block)


def posor_program(calibration: Calibration, folder: Path) -> ProgramCommand:
    """Return the program of the posor_node, whose calibration file is written to a folder."""
    path = folder / f"{calibration.name}.yaml"
    path.write_text(yaml.safe_dump(calibration.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
    parameters: dict[str, Any] = {"calibration": str(path), "lossless": True, "acknowledge_interval": 0.0}
    parameters |= RECORDING
    return ProgramCommand("posor_node", "posor_estimator", "posor_node", (), NAMESPACE, parameters)


def play_storm(storm: Storm, player: NodePlayer, watch: GraphWatch) -> IntArray:
    """Publish all scans of a storm, and acknowledge where an operator does; return where the node granted it."""
    types, records, granted = MessageTypes(), storm.scans, list[int]()
    watch.wait(player.is_ready, lambda: "posor_node, or one of its connections")
    begin = 0
    for end in [*storm.acknowledgements.tolist(), len(records)]:
        for n in range(begin, end):
            scan = records[n]
            message = raw_scan(types, scan.stamp_ns, "receiving", status=scan.status, **scan_fields(scan))
            player.inputs[0].publish(types.serialize(message, RAW_SCAN))
        watch.wait(
            lambda end=end: len(player.answers) >= end,  # type: ignore[misc]
            lambda end=end: f"{end - len(player.answers)} of {end} transforms",  # type: ignore[misc]
        )
        if end < len(records) and player.acknowledge(watch):
            granted.append(end)
        begin = end
    return np.array(granted, dtype=np.int64)
