# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Topics of a running arm: usual subscribers receive all of them, and views for other tools name only existing ones."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
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


PLOTJUGGLER_SWITCHES = (
    "use_header_stamp",
    "discard_large_arrays",
    "boolean_strings_to_number",
    "remove_suffix_from_strings",
)


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
    panels = set(layout["configById"])
    assert set(texts_of(layout["layout"])) & panels == panels
    paths = [text for text in texts_of(layout) if text.startswith("/")]
    assert len(paths) >= 8
    for path in paths:
        value_of(topics, path.partition(".@")[0])
    plots = [each for name, each in layout["configById"].items() if name.startswith("Plot!")]
    for plot in plots:
        assert len({path["color"] for path in plot["paths"]}) == len(plot["paths"])
        assert all("@mul(" in path["value"] for path in plot["paths"]) == ("[u" in plot["title"])
    root = ET.fromstring(plotjuggler)  # noqa: S314  written by this program
    plugin = root.find("./Plugins/plugin")
    assert plugin is not None
    keys = {each.tag: each.attrib["value"] for each in plugin}  # a missing key is read as false, or as 0
    assert keys.pop("max_array_size") == "100"
    topics_of_curves = keys.pop("selected_topics").split(";")
    assert keys == dict.fromkeys(PLOTJUGGLER_SWITCHES, "true")
    formulas = {each.attrib["name"]: each for each in root.iter("snippet")}
    for formula in formulas.values():
        sources = [each.text or "" for each in formula.iter() if each.tag == "linked_source" or each.tag[:1] == "v"]
        assert all(number_of_series(topics, topics_of_curves, source) for source in sources)
        text = formula.findtext("function") or ""
        assert {f"v{number}" for number in range(1, len(sources))} <= set(re.findall(r"v\d", text))
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(curves) == len(set(curves))
    assert set(formulas) <= set(curves)
    assert sum("2 sigma" in name for name in curves) == 2 * 6
    assert all(name in formulas or number_of_series(topics, topics_of_curves, name) for name in curves)
    for plot in root.iter("plot"):
        assert len({curve.attrib["color"] for curve in plot}) == len(plot)


def number_of_series(topics: dict[str, str], selected: list[str], series: str) -> bool:
    """Return whether a time series of PlotJuggler is a number of a message of a selected topic."""
    (topic,) = (name for name in selected if series.startswith(f"{name}/"))
    return isinstance(value_of(topics, topic + series[len(topic) :].replace("/", ".")), float | int)


def texts_of(content: Any) -> Iterator[str]:
    """Yield all texts in nested dictionaries and lists, keys too."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, dict):
        yield from (text for pair in content.items() for part in pair for text in texts_of(part))
    elif isinstance(content, list):
        yield from (text for part in content for text in texts_of(part))


def value_of(topics: dict[str, str], path: str) -> Any:
    """Return the default of ``/topic.field.field[0]`` in the type that the topic has in the running graph."""
    topic, *fields = path.split(".")
    value = message_class(topics[topic])()
    for field in fields:
        name, _, index = field.partition("[")
        value = getattr(value, name)
        if index:
            value = float(value[int(index.rstrip("]"))])
    return value
