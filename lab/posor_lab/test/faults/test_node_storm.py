# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The storm through a posor_node: every scan is answered, whatever the node was doing before the first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from posor_bringup.supervisor import Supervisor
from posor_lab.faults.node_storm import PLAYER_ARGUMENTS, play_storm, posor_program
from posor_lab.faults.storm import StormMaker, estimate_storm, storm_calibrations
from posor_lab.harness.graph import Graph
from posor_lab.reports.graph_receiver import GraphWatch, NodePlayer
from posor_msgs.msg import JointTransform
from posor_ros.lifecycle_node import LISTENERS_STATUS
from posor_ros.node_program import ros_context
from rclpy.serialization import deserialize_message

SCANS = 2000


@pytest.mark.usefixtures("ros_domain")
def test_a_storm_waits_for_an_active_node_and_equals_the_estimator(tmp_path: Path) -> None:
    name, _, (_, answer) = PLAYER_ARGUMENTS
    maker = StormMaker(storm_calibrations()["diodes"])
    storm = maker.draw(5, SCANS)
    program = posor_program(maker.calibration, tmp_path)
    program = replace(program, parameters={**program.parameters, "autostart": False})
    with (
        ros_context(["test"]),
        Graph() as graph,
        Supervisor(tmp_path) as supervisor,
        NodePlayer(*PLAYER_ARGUMENTS) as player,
    ):
        watch = GraphWatch(supervisor, player, "storm")
        supervisor.start(program)
        assert graph.change_state(name, Transition.TRANSITION_CONFIGURE)

        def is_connected_and_inactive() -> bool:
            found = [
                player.status_value(f"{name}: {status}", key)
                for status, key in ((LISTENERS_STATUS, answer), ("lifecycle", "message"))
            ]
            return found == ["1", "inactive"] and player.inputs[0].get_subscription_count() > 0

        watch.wait(is_connected_and_inactive, lambda: "the inactive node")
        assert not player.is_ready()  # it would answer nothing
        assert graph.change_state(name, Transition.TRANSITION_ACTIVATE)
        play_storm(storm, player, watch)
        found = [deserialize_message(data, JointTransform) for data in player.answers]
    maker.posor.reset()
    expected = estimate_storm(maker.posor, storm)
    assert len(storm.acknowledgements) > 0
    np.testing.assert_array_equal([each.scan for each in found], storm.scans.numbers)
    np.testing.assert_array_equal([each.state for each in found], expected.states)
    np.testing.assert_array_equal([each.faults for each in found], expected.faults)
