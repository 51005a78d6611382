# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write docs/reference/parameters.md from the declarations of the node parameters: ``make docs``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from environment import THIS
from posor.node_parameters import ChainParameters, NodeParameters, PosorParameters
from posor.parameter_model import ParameterSpec, parameter_specs
from posor_drivers.driver_parameters import LiveDriverParameters, ReplayDriverParameters
from posor_estimator.correction_node import CorrectionParameters

if TYPE_CHECKING:
    from collections.abc import Iterable

PAGE = THIS.root / "docs" / "reference" / "parameters.md"
INTRODUCTION = """# Parameters of the nodes

`make docs` writes this page from the declarations in `posor/node_parameters.py`,
`posor_drivers/driver_parameters.py` and `posor_estimator/correction_node.py`. The same declarations produce `--help`,
`ros2 param describe` and the error messages. An invalid value or an unknown name ends the start of a node with exit
code 2 and one sentence.
A parameter may be set while its node is unconfigured, or when its description says so.

"""
COMMON_SECTION = "All nodes"
SECTIONS: dict[str, type[NodeParameters]] = {
    COMMON_SECTION: NodeParameters,
    "posor_node": PosorParameters,
    "chain_node": ChainParameters,
    "correction_node": CorrectionParameters,
    "driver_node with a live source": LiveDriverParameters,
    "driver_node with a recorded source": ReplayDriverParameters,
}


def format_table(specs: Iterable[ParameterSpec]) -> str:
    """Return a Markdown table of parameters."""
    rows = ["| parameter | value | default | description |", "|---|---|---|---|"]
    for spec in specs:
        when = f" (may be set {spec.when})" if spec.when else ""
        rows.append(f"| `{spec.name}` | {spec.constraint} | {spec.default_text} | {spec.field.description}{when} |")
    return "\n".join(rows) + "\n"


def render_page() -> str:
    """Return the page as Markdown."""
    common = {spec.name for spec in parameter_specs(NodeParameters)}
    sections = []
    for title, model in SECTIONS.items():
        specs = [spec for spec in parameter_specs(model) if title == COMMON_SECTION or spec.name not in common]
        sections.append(f"## {title}\n\n{format_table(specs)}")
    return INTRODUCTION + "\n".join(sections)


if __name__ == "__main__":
    PAGE.write_text(render_page(), encoding="utf-8")
