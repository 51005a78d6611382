# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Views of an arm for RViz, Foxglove and PlotJuggler, from the templates in ``views``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined
from posor.output_files import write_files

from posor_bringup.view_charts import distinct_colours

if TYPE_CHECKING:
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

VIEWS = {"rviz": "arm.rviz", "foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
"""Name of the file for each tool."""


def write_views(arm: ArmFile, folder: Path, frame_prefix: str = "") -> dict[str, Path]:
    """Write the view of each tool into an existing folder; return the files by tool.

    ``frame_prefix``: of the arm's chain_node.

    Raises OutputError: a file cannot be written.
    """
    templates = Environment(
        loader=PackageLoader("posor_bringup", "views"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701  names of ROS need no escapes
    )
    names = {
        "colours": distinct_colours,
        "arm": arm.namespace.lstrip("/"),
        "base": frame_prefix + arm.chain().base_frame,
        "frame_prefix": frame_prefix,
        "joints": list(arm.calibrations),
    }
    files = {tool: folder / name for tool, name in VIEWS.items()}
    write_files({path: templates.get_template(f"{path.name}.j2").render(names) for path in files.values()})
    return files
