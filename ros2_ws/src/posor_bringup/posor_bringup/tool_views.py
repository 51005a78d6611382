"""Views of an arm for RViz, Foxglove and PlotJuggler, written for its names of topics and frames."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import yaml
from posor.bags.result_folder import writing
from posor.ros_names import (
    DIAGNOSTICS_TOPIC,
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_STATE_TOPIC,
    ENDPOINT_TOPIC,
    ROBOT_DESCRIPTION_TOPIC,
    TRANSFORM_TOPIC,
)

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

VIEWS = {"rviz": "arm.rviz", "foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
"""Name of the file for each tool."""
AXES = "xyz"
COLOURS = ("#d62728", "#2ca02c", "#1f77b4")
"""Of X, Y and Z."""


def write_views(arm: ArmFile, folder: Path) -> dict[str, Path]:
    """Write the view of each tool into an existing folder; return the files by tool.

    Raises OutputError: a file cannot be written.
    """
    texts = {"rviz": rviz_view(arm), "foxglove": foxglove_view(arm), "plotjuggler": plotjuggler_view(arm)}
    files = {tool: folder / name for tool, name in VIEWS.items()}
    with writing(folder):
        for tool, path in files.items():
            path.write_text(texts[tool], encoding="utf-8")
    return files


def curves(arm: ArmFile) -> dict[str, dict[str, str]]:
    """Return the curves to plot: by title and name, topic and field as ``/topic.field``; NaN, a gap, without a pose."""
    state = f"/{arm.name}/{ENDPOINT_STATE_TOPIC}"
    return {
        "Position of the endpoint [m]": {axis: f"{state}.pose.position.{axis}" for axis in AXES},
        "Chi-square of the redundant readings": {
            joint: f"/{arm.name}/{joint}/{TRANSFORM_TOPIC}.residual" for joint in arm.calibrations
        },
        "Age of the scan when published [s]": {"age": f"{state}.age"},
        "State of the endpoint (0: OK)": {"state": f"{state}.state"},
    }


def rviz_view(arm: ArmFile) -> str:
    """Return the configuration of RViz: the measured arm, its frames, and the endpoint with its covariance."""

    def display(kind: str, name: str, **properties: Any) -> dict[str, Any]:
        return {"Class": f"rviz_default_plugins/{kind}", "Name": name, "Enabled": True, "Value": True, **properties}

    def topic(name: str, *, latched: bool = False) -> dict[str, Any]:
        durability, reliability = ("Transient Local", "Reliable") if latched else ("Volatile", "Best Effort")
        return {
            "Value": f"/{arm.name}/{name}",
            "Depth": 1 if latched else 5,
            "History Policy": "Keep Last",
            "Reliability Policy": reliability,
            "Durability Policy": durability,
        }

    displays = [
        display("Grid", "Grid", **{"Cell Size": 0.1, "Plane Cell Count": 20}),
        display(
            "RobotModel",
            "Measured arm",
            **{
                "Description Source": "Topic",
                "Description Topic": topic(ROBOT_DESCRIPTION_TOPIC, latched=True),
                "Visual Enabled": True,
            },
        ),
        display("TF", "Frames", **{"Marker Scale": 0.2, "Show Names": True, "Show Axes": True, "Show Arrows": False}),
        display("Pose", "Endpoint", Topic=topic(ENDPOINT_TOPIC), Shape="Axes", **{"Axes Length": 0.1}),
        display(
            "PoseWithCovariance",
            "Endpoint with covariance",
            Topic=topic(ENDPOINT_COVARIANCE_TOPIC),
            Shape="Axes",
            Covariance={"Value": True, "Position": {"Value": True, "Scale": 1000}, "Orientation": {"Value": False}},
            **{"Axes Length": 0.1},
        ),
    ]
    view = {"Class": "rviz_default_plugins/Orbit", "Name": "Current View", "Distance": 3, "Pitch": 0.5, "Yaw": 0.8}
    manager = {
        "Class": "",
        "Displays": displays,
        "Global Options": {"Fixed Frame": arm.chain().base_frame, "Frame Rate": 30, "Background Color": "48; 48; 48"},
        "Tools": [{"Class": f"rviz_default_plugins/{tool}"} for tool in ("Interact", "MoveCamera", "Measure")],
        "Views": {"Current": view},
    }
    panels = [{"Class": f"rviz_common/{name}", "Name": name} for name in ("Displays", "Views", "Time")]
    return yaml.safe_dump({"Panels": panels, "Visualization Manager": manager}, sort_keys=False)


def foxglove_view(arm: ArmFile) -> str:
    """Return the layout of Foxglove: the arm, the state of the endpoint, the curves, the diagnostics."""
    plots = {
        f"Plot!{number}": _foxglove_plot(title, paths) for number, (title, paths) in enumerate(curves(arm).items())
    }
    panels = {
        **plots,
        "3D!arm": {
            "followTf": arm.chain().base_frame,
            "topics": {f"/{arm.name}/{ENDPOINT_TOPIC}": {"visible": True}},
            "layers": {
                "urdf": {
                    "layerId": "foxglove.Urdf",
                    "sourceType": "topic",
                    "topic": f"/{arm.name}/{ROBOT_DESCRIPTION_TOPIC}",
                    "visible": True,
                }
            },
        },
        "RawMessages!state": {"topicPath": f"/{arm.name}/{ENDPOINT_STATE_TOPIC}"},
        "DiagnosticSummary!all": {"topicToRender": DIAGNOSTICS_TOPIC, "minLevel": 0},
    }

    def split(direction: str, panels: list[Any]) -> Any:
        """Return panels of equal size beside or below each other."""
        if len(panels) == 1:
            return panels[0]
        rest = split(direction, panels[1:])
        return {"direction": direction, "first": panels[0], "second": rest, "splitPercentage": 100 / len(panels)}

    left = split("column", ["3D!arm", "RawMessages!state", "DiagnosticSummary!all"])
    layout = split("row", [left, split("column", list(plots))])
    content = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(content, indent=2) + "\n"


def plotjuggler_view(arm: ArmFile) -> str:
    """Return the layout of PlotJuggler: the curves."""
    plots = {title: [path.replace(".", "/") for path in paths.values()] for title, paths in curves(arm).items()}
    root = ET.Element("root")
    widget = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    container = ET.SubElement(ET.SubElement(widget, "Tab", tab_name=arm.name, containers="1"), "Container")
    shares = ";".join([f"{1 / len(plots):g}"] * len(plots))
    splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=shares)
    for title, names in plots.items():
        area = ET.SubElement(splitter, "DockArea", name=title)
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
        for number, name in enumerate(names):
            ET.SubElement(plot, "curve", name=name, color=COLOURS[number % len(COLOURS)])
    streamer = "ROS2 Topic Subscriber"
    ET.SubElement(root, "previouslyLoaded_Streamer", name=streamer)
    plugin = ET.SubElement(ET.SubElement(root, "Plugins"), "plugin", ID=streamer)
    topics = {path.split(".")[0]: None for paths in curves(arm).values() for path in paths.values()}
    ET.SubElement(plugin, "selected_topics", value=";".join(topics))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _foxglove_plot(title: str, paths: dict[str, str]) -> dict[str, Any]:
    series = [
        {"label": label, "value": path, "enabled": True, "timestampMethod": "headerStamp"}
        for label, path in paths.items()
    ]
    return {"title": title, "paths": series, "showLegend": True, "isSynced": True, "followingViewWidth": 30}
