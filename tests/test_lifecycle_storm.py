# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random lifecycle transitions of composed nodes while scans flow: the process survives and gives poses afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_lab.harness.rig_files import bag_path
from posor_ros.ros_arguments import ros_arguments

from tests.composed_rig import COMPOSE, NODES, RIG, write_composition

pytestmark = pytest.mark.usefixtures("ros_domain")

NEXT = {  # the state after each transition that a state has
    "unconfigured": {Transition.TRANSITION_CONFIGURE: "inactive"},
    "inactive": {Transition.TRANSITION_ACTIVATE: "active", Transition.TRANSITION_CLEANUP: "unconfigured"},
    "active": {Transition.TRANSITION_DEACTIVATE: "inactive"},
}
*RESULT_NODES, DRIVER = NODES
WITHOUT_DRIVER, DRIVER_ENTRY, _ = RIG.partition("  - node: driver_node")
DRIVER_PROGRAM = [
    *installed("posor_drivers", "driver_node"),
    *ros_arguments({"source": "bag", "bag.path": str(bag_path("ymo")), "loop": True, "restamp": True}, "/rig/joint1"),
]


class Node:
    """A lifecycle node of a program: its state and the client that changes it."""

    def __init__(self, graph: Graph, program: Program, name: str) -> None:
        self.graph, self.program, self.name, self.state = graph, program, name, "active"
        self.client: Any = graph.node.create_client(ChangeState, f"{name}/change_state")
        graph.wait_until(self.client.service_is_ready, f"the service of {name}")

    def change(self, transition: int) -> None:
        request = ChangeState.Request()
        request.transition.id = transition
        answer = self.client.call_async(request)
        self.graph.wait_until(lambda: answer.done() or self.program.ended, f"transition {transition} of {self.name}")
        assert not self.program.ended, "\n".join(self.program.stderr)
        assert answer.result().success
        self.state = NEXT[self.state][transition]

    def change_at_random(self, rng: np.random.Generator) -> None:
        self.change(int(rng.choice(list(NEXT[self.state]))))

    def activate(self) -> None:
        if self.state == "unconfigured":
            self.change(Transition.TRANSITION_CONFIGURE)
        if self.state == "inactive":
            self.change(Transition.TRANSITION_ACTIVATE)


@pytest.mark.parametrize("driver_apart", [False, True])
@pytest.mark.parametrize(
    ("seed", "transitions"), [(1, 25), *(pytest.param(seed, 50, marks=pytest.mark.long) for seed in range(10))]
)
def test_a_composition_survives_transitions_of_every_node(
    tmp_path: Path, seed: int, transitions: int, *, driver_apart: bool
) -> None:
    """The driver is in the same process, or always active in another one."""
    rng = np.random.default_rng(seed)
    command = [*COMPOSE, str(write_composition(tmp_path, WITHOUT_DRIVER if driver_apart else RIG))]
    with (
        Program(command) as composed,
        Program(DRIVER_PROGRAM if driver_apart else ["true"]) as driver,
        Graph() as graph,
    ):
        poses = graph.collect(PoseStamped, "/rig/endpoint/pose")
        graph.wait_until(lambda: len(poses) > 3, "poses")
        nodes = [Node(graph, composed, name) for name in (RESULT_NODES if driver_apart else NODES)]
        order = [node for node in nodes for _ in range(transitions)]
        rng.shuffle(order)
        for node in order:
            node.change_at_random(rng)
            assert not composed.ended
        for node in nodes:
            node.activate()
        graph.receive()
        poses.clear()
        graph.wait_until(lambda: len(poses) > 10, "poses after all transitions")
        assert composed.end() == 0
        assert composed.errors == []
        if driver_apart:
            assert driver.end() == 0
