"""Topics of a running arm: usual subscribers receive all of them, and views for other tools name only existing ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from posor_bringup.tool_views import VIEWS
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_ros.message_classes import message_class
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

pytestmark = pytest.mark.usefixtures("ros_domain")

TOPICS = {  # topics that the arm must have at least
    "/diagnostics",
    "/tf",
    "/tf_static",
    *(
        f"/test_rig/{name}"
        for name in (
            *("joint1/raw", "joint1/transform"),
            *("endpoint/pose", "endpoint/pose_with_covariance", "endpoint/state", "joint_states", "robot_description"),
        )
    ),
}
NO_DATA = ("/parameter_events", "/rosout", "/transition_event")  # topics of rclpy that are silent while nothing happens
USUAL = (QoSProfile(depth=10), qos_profile_sensor_data)
LATCHED = (QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),)
"""The usual profile for what was published before; DDS repeats it to reliable subscriptions only."""


RVIZ_TYPES = {  # type of the topic of each display
    "rviz_default_plugins/RobotModel": "std_msgs/msg/String",
    "rviz_default_plugins/Pose": "geometry_msgs/msg/PoseStamped",
    "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def test_usual_subscribers_receive_every_topic_and_views_name_existing_ones(tmp_path: Path) -> None:
    command = [*installed("posor_bringup", "bringup"), "test_rig", "--layout", "composed", "--output", str(tmp_path)]
    with Program(command) as program, Graph() as graph:

        def published() -> dict[str, str]:
            topics = graph.node.get_topic_names_and_types()
            names = {name: types[0] for name, types in topics if not name.endswith(NO_DATA)}
            return {name: type_ for name, type_ in names.items() if graph.node.count_publishers(name)}

        graph.wait_until(lambda: set(published()) >= TOPICS, "all topics")
        topics = published()
        received: dict[tuple[str, str], list[Any]] = {}
        for name, type_ in topics.items():
            for qos in LATCHED if name in {"/tf_static", "/test_rig/robot_description"} else USUAL:
                received[name, qos.reliability.name] = graph.collect(message_class(type_), name, qos, raw=True)
        poses = graph.collect(message_class(topics["/test_rig/endpoint/pose"]), "/test_rig/endpoint/pose")
        graph.wait_until(lambda: bool(poses) and all(received.values()), "a message on every topic for each subscriber")
        check_views(tmp_path / "test_rig", topics, poses[0].header.frame_id)
        assert program.end() == 0


def check_views(folder: Path, topics: dict[str, str], base_frame: str) -> None:
    """Compare topics, types, fields and frames of the views with those of the running graph."""
    rviz, foxglove, plotjuggler = ((folder / name).read_text(encoding="utf-8") for name in VIEWS.values())
    manager = yaml.safe_load(rviz)["Visualization Manager"]
    shown = {
        display["Class"]: display.get("Topic") or display.get("Description Topic") for display in manager["Displays"]
    }
    assert {kind: topics[topic["Value"]] for kind, topic in shown.items() if topic} == RVIZ_TYPES
    assert manager["Global Options"]["Fixed Frame"] == base_frame
    layout = json.loads(foxglove)
    assert layout["configById"]["3D!arm"]["followTf"] == base_frame
    paths = [text for text in texts_of(layout) if text.startswith("/")]
    assert len(paths) >= 8
    for path in paths:
        value_of(topics, path)
    root = ET.fromstring(plotjuggler)  # noqa: S314  written by this program
    (selected,) = root.iter("selected_topics")
    for curve in root.iter("curve"):
        (topic,) = (name for name in selected.attrib["value"].split(";") if curve.attrib["name"].startswith(f"{name}/"))
        assert isinstance(value_of(topics, topic + curve.attrib["name"][len(topic) :].replace("/", ".")), float | int)


def texts_of(content: Any) -> Iterator[str]:
    """Yield all texts in nested dictionaries and lists, keys too."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, dict):
        yield from (text for pair in content.items() for part in pair for text in texts_of(part))
    elif isinstance(content, list):
        yield from (text for part in content for text in texts_of(part))


def value_of(topics: dict[str, str], path: str) -> Any:
    """Return the default of ``/topic.field.field`` in the type that the topic has in the running graph."""
    topic, *fields = path.split(".")
    return reduce(getattr, fields, message_class(topics[topic])())
