# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The graph that is measured: which nodes run, in which processes, at which rate.

Every process is a `compose` with its own composition file, even for a single node: layouts differ only in which nodes
share a process.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from posor.node_parameters import RECORDING
from posor_bringup.arm_programs import Layout, arm_programs, group_programs
from posor_bringup.supervisor import ProgramCommand
from posor_drivers.driver_parameters import LiveDriverParameters

from posor_lab.benchmark import stage_profile
from posor_lab.benchmark.pass_through_nodes import PassThroughChain, PassThroughPosor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.chain.arm_file import ArmFile
    from posor_bringup.supervisor import Parameter

NodeKind = Literal["graph", "pass_through"]  # the stack's own nodes, or nodes that compute nothing in their place
PageUse = Literal["absent", "at rest", "shown"]  # whether ``view`` runs, and whether a browser shows its page
KINDS: tuple[NodeKind, ...] = get_args(NodeKind)
LAYOUTS: Mapping[Layout, str] = {
    "composed": "all nodes in one process",
    "drivers_apart": "two processes: drivers; all other nodes",
    "separate": "one process for each node",
}
PROFILE = "profile.json"
SPIN_US: int = LiveDriverParameters.model_fields["spin_us"].default
FALSE_ALARM = 1e-9
"""False-alarm probability of the nodes. The noise is played again and again: a scan that fails once always fails."""


@dataclass(frozen=True)
class GraphLoad:
    """A graph to measure."""

    arm: ArmFile  # from ``generate_arm``
    kind: NodeKind  # kind of the nodes
    layout: Layout  # which nodes share a process
    rate: int  # scans per second
    spin_us: int = SPIN_US  # time before each tick in which drivers poll the clock instead of sleeping [us]
    priority: int = 0  # SCHED_FIFO priority of the processes and of the receiver; 0: none
    page: PageUse = "absent"  # the live page beside the graph
    profiled: bool = False  # whether stopwatches write ``PROFILE`` into the folder of the run

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        waiting = "" if (self.spin_us, self.priority) == (SPIN_US, 0) else f"_spin{self.spin_us}_{self.priority}"
        page = "" if self.page == "absent" else f"_page_{self.page.replace(' ', '_')}"
        return f"{self.kind}_{self.layout}_{len(self.arm.calibrations)}x{self.rate}{waiting}{page}"


def graph_programs(load: GraphLoad, folder: Path) -> list[ProgramCommand]:
    """Return the programs, subscribers first; write their composition files into ``folder``."""
    nodes = node_programs(load)
    if load.layout == "separate":
        programs = [_compose_one(node, folder / node.name.replace("/", ".")) for node in nodes]
    else:
        programs = group_programs(nodes, load.layout, folder)
    if load.priority:
        for program in programs:
            with Path(program.arguments[0]).open("a", encoding="utf-8") as file:
                file.write(f"realtime: {{priority: {load.priority}}}\n")
    if not load.profiled:
        return programs
    script, profile = str(stage_profile.__file__), str(folder / PROFILE)
    return [ProgramCommand(program.name, "", script, (*program.arguments, profile)) for program in programs]


def node_programs(load: GraphLoad, *, drivers: bool = True) -> list[ProgramCommand]:
    """Return one program for each node, subscribers first; without ``drivers`` the stamps may be of any age."""
    driver: dict[str, Parameter] = {"looped.rate": load.rate, "spin_us": load.spin_us}
    parameters = None if drivers else RECORDING
    programs = arm_programs(load.arm, drivers=drivers, driver_parameters=driver, parameters=parameters)
    return [_node_program(program, load) for program in programs]


def _compose_one(node: ProgramCommand, folder: Path) -> ProgramCommand:
    """Return a `compose` of a single node; pass-through nodes are not executables."""
    folder.mkdir()
    (program,) = group_programs([node], "composed", folder)
    return replace(program, name=node.name)


def _node_program(program: ProgramCommand, load: GraphLoad) -> ProgramCommand:
    """Return the program of a node, or of the pass-through node in its place."""
    if program.executable == "posor_node":
        if load.kind == "graph":
            return replace(program, parameters={**program.parameters, "false_alarm": FALSE_ALARM})
        frames = load.arm.calibration(program.name.partition("/")[0]).frames
        parameters: dict[str, Parameter] = {"parent": frames.parent, "child": frames.child}
        return replace(program, executable=PassThroughPosor.NAME, parameters=parameters)
    if program.executable == "chain_node" and load.kind == "pass_through":
        chain = load.arm.chain()
        parameters = {"joints": [joint.name for joint in chain.joints], "frame": chain.base_frame}
        return replace(program, executable=PassThroughChain.NAME, parameters=parameters)
    return program
