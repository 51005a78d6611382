"""compose: runs several nodes in one process, as a composition file says; what they tell each other stays within it."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.errors import NodeError, ParameterError, PosorError
from posor_estimator.ros.composition import load_composition, place_of
from posor_estimator.ros.main import Nodes, exit_code_of, own_arguments, ros
from posor_estimator.ros.registry import node_entries

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
      parameters: {{urdf: arm.urdf}}  # as --ros-args -p gives them to a process of this node alone
      remappings: {{}}

Nodes start in this order and end in the reverse one: list those that listen first. What follows --ros-args, such as
--params-file FILE, is for all of them."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all nodes ended as they were asked to."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of(lambda: _compose(argv))


def _compose(arguments: Sequence[str]) -> None:
    with ros(arguments) as stop:
        own = own_arguments(arguments)
        if own in (["-h"], ["--help"]):
            sys.stdout.write(HELP.format(nodes=", ".join(node_entries())) + "\n")
            return
        if len(own) != 1:
            raise ParameterError(f"{len(own)} arguments", where="compose", expected="one, a composition file")
        composition, places = load_composition(Path(own[0]))
        with Nodes(composition.realtime) as nodes:
            for number, entry in enumerate(composition.nodes):
                place = partial(place_of, places, number, entry)
                try:
                    nodes.add(entry.create(), place)
                except PosorError as error:
                    raise NodeError(error, entry.full_name, place(error)) from error
            nodes.run(lambda: stop.requested)
