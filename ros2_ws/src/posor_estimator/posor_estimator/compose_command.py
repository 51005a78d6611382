# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""compose: runs the nodes of a composition file in one process, with intra-process delivery between them."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import NodeError, ParameterError, PosorError
from posor.plugins import registered
from posor.reporting.program_errors import reports_errors
from posor_ros.node_program import NodeGroup, non_ros_arguments, ros_context
from posor_ros.parameter_files import check_sections, parameter_files_of
from rclpy.logging import get_logger

from posor_estimator.composition_file import NODE_ENTRY_POINTS, error_location, load_composition

if TYPE_CHECKING:
    from collections.abc import Sequence

HELP = """\
compose FILE: Runs the nodes of a composition file in one process.

  format: posor_composition
  version: 1
  realtime: {{priority: 0, cpus: [], lock_memory: false, required: false}}
  nodes:
    - node: chain_node              # one of {nodes}
      namespace: /arm               # default: /
      name: chain_node              # default: that of the node
      parameters: {{urdf: arm.urdf}}  # as --ros-args -p sets them for a process of this node alone
      remappings: {{}}

Nodes start in this order and stop in the reverse order: list subscribers before publishers. Arguments after --ros-args,
such as --params-file FILE, apply to all nodes."""


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all nodes ended as requested."""
    _compose(sys.argv if arguments is None else arguments)
    return 0


def _compose(arguments: Sequence[str]) -> None:
    with ros_context(arguments) as stop:
        own = non_ros_arguments(arguments)
        if own in (["-h"], ["--help"]):
            sys.stdout.write(HELP.format(nodes=", ".join(registered(NODE_ENTRY_POINTS))) + "\n")
            return
        if len(own) != 1:
            raise ParameterError(f"{len(own)} arguments", where="compose", expected="one, a composition file")
        composition, locations = load_composition(Path(own[0]))
        names = [entry.full_name for entry in composition.nodes]
        check_sections(parameter_files_of(arguments), names, get_logger("compose"))
        with NodeGroup(composition.realtime) as nodes:
            for number, entry in enumerate(composition.nodes):
                location = partial(error_location, locations, number, entry)
                try:
                    nodes.add(entry.create_node(), location)
                except PosorError as error:
                    raise NodeError(error, entry.full_name, location(error)) from error
            nodes.run(lambda: stop.requested)
