# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every message that the nodes publish: rosbags reads it and writes the same bytes, so that none comes from memory.

Messages of rcl itself (rosout, parameter events, transition events) are serialised by the middleware and left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from posor_bringup.arm_programs import LAYOUTS, Layout, arm_programs, group_programs
from posor_bringup.arms import load_checked_arm
from posor_lab.harness.graph import BEST_EFFORT, LOSSLESS, Graph
from posor_lab.harness.program import Program
from posor_lab.harness.rig_files import bag_path
from posor_ros.message_classes import message_class
from posor_ros.qos import LATCHED_QOS
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tests.composed_rig import COMPOSE, RIG, write_composition

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[1]
TABLE = f"{{path: {ROOT}/data/slocum1985/ymo_input.csv, map: {ROOT}/data/slocum1985/table_map.yaml}}"
BAG = f"source: bag, bag: {{path: {bag_path('ymo')}, other_topics: [/truth/machining_centre]}}, loop: true"
DRIVERS = {
    "bag, restamped": f"{BAG}, restamp: true",
    "bag, means": f"{BAG}, restamp: true, rate: 4.0, conditioning: {{method: mean, samples: 2, subtract_dark: true}}",
    "bag, looped": f"{BAG}, rate: 20.0",
    "table": f"source: table, table: {TABLE}, loop: true, restamp: true",
    "looped": f"source: looped, looped: {{path: {bag_path('ymo')}, rate: 20}}",
}
RIG_TOPICS = (
    "/diagnostics",
    "/rig/endpoint/pose",
    "/rig/endpoint/pose_with_covariance",
    "/rig/endpoint/state",
    "/rig/joint1/raw",
    "/rig/joint1/transform",
    "/rig/joint_states",
    "/rig/robot_description",
    "/tf",
    "/tf_static",
)
OF_RCL = ("rcl_interfaces/", "lifecycle_msgs/")
LEAST, FEWER = 8, {"tf_static": 1, "robot_description": 1}
"""Messages of each topic that are compared, and of topics with this end, which are published seldom or once."""
LATCHED = ("/tf_static", "/robot_description")


def typestore() -> Typestore:
    """Return rosbags' own types of Jazzy with those of this workspace."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted((ROOT / "ros2_ws/src/posor_msgs/msg").glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(), f"posor_msgs/msg/{path.stem}"))
    return store


def composition(driver: str) -> str:
    """Return the rig with another driver; recorded stamps are of any age."""
    recorded = "" if driver.startswith("source: looped") or "restamp" in driver else "freshness: {max_age: .inf}, "
    others, _, _ = RIG.rpartition("parameters: {")
    return f"{others}parameters: {{{driver}}}\n".replace("parameters: {", f"parameters: {{{recorded}")


class EveryTopic:
    """Subscribes to all topics of our nodes as they appear."""

    def __init__(self, graph: Graph) -> None:
        self.types: dict[str, str] = {}
        self.messages: Mapping[str, list[bytes]] = {}
        self._graph = graph

    def discover(self) -> None:
        for name, (kind, *_) in self._graph.node.get_topic_names_and_types():
            publishers = self._graph.node.get_publishers_info_by_topic(name)
            if name not in self.types and publishers and not kind.startswith(OF_RCL):
                self.types[name] = kind
                qos = LATCHED_QOS if name.endswith(LATCHED) else LOSSLESS
                qos = BEST_EFFORT if name.endswith(("/raw", "/transform")) else qos
                self.messages = {**self.messages, name: self._graph.collect(message_class(kind), name, qos, raw=True)}

    def missing(self, topics: tuple[str, ...]) -> list[str]:
        least = {name: FEWER.get(name.rpartition("/")[2], LEAST) for name in topics}
        return [name for name in topics if len(self.messages.get(name, ())) < least[name]]

    def check(self) -> None:
        store = typestore()
        for name, messages in self.messages.items():
            kind: Any = self.types[name]
            for data in messages:
                again = bytes(store.serialize_cdr(store.deserialize_cdr(data, kind), kind))
                # RTPS fills up what it sends with zeros to a multiple of 4 bytes.
                assert data in (again, again + bytes(-len(again) % 4)), name


def check_graph(graph: Graph, topics: tuple[str, ...]) -> None:
    received = EveryTopic(graph)
    try:
        graph.wait_until(lambda: not received.missing(topics), "messages of all topics", received.discover)
    except AssertionError:
        pytest.fail(f"waited in vain for messages of {', '.join(received.missing(topics))}")
    received.check()


@pytest.mark.parametrize(
    "driver", ["bag, means", *(pytest.param(name, marks=pytest.mark.long) for name in DRIVERS if name != "bag, means")]
)
def test_rosbags_rereads_every_message_of_the_rig(tmp_path: Path, driver: str) -> None:
    composed = write_composition(tmp_path, composition(DRIVERS[driver]))
    topics = RIG_TOPICS + (("/truth/machining_centre",) if driver.startswith(("bag", "table")) else ())
    with Program([*COMPOSE, str(composed)]) as program, Graph() as graph:
        check_graph(graph, topics)
        assert program.end() == 0


@pytest.mark.long
@pytest.mark.parametrize("layout", LAYOUTS)
def test_rosbags_rereads_every_message_of_a_simulated_arm(tmp_path: Path, layout: Layout) -> None:
    arm = load_checked_arm("test_rig")
    programs = group_programs(arm_programs(arm), layout, tmp_path)
    topics = [f"/test_rig/{name}" for name in ("endpoint/pose", "endpoint/state", "joint_states", "encoders")]
    topics += [f"/test_rig/joint1/{name}" for name in ("raw", "transform")]
    running = [Program(each.command()) for each in programs]
    try:
        with Graph() as graph:
            check_graph(graph, ("/diagnostics", *topics))
        assert {program.end() for program in running} == {0}
    finally:
        for program in running:
            program.__exit__(None, None, None)
