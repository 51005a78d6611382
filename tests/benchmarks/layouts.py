"""Which nodes run in which process: the layouts that are compared, for the graph itself and for its floor.

Every process is one `compose` with a file of its own, also where it holds a single node: layouts differ in nothing but
what shares a process.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from posor_bringup.arm_programs import arm_programs
from posor_bringup.layouts import Layout, laid_out
from posor_bringup.supervisor import Program, Script
from posor_drivers.driver_parameters import LiveDriverParameters

from tests.benchmarks import profiled
from tests.benchmarks.floor import FloorChain, FloorPosor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_bringup.supervisor import Parameter
    from posor_estimator.core.arm import Arm

Kind = Literal["graph", "floor"]
LAYOUTS: Mapping[Layout, str] = {
    "composed": "all nodes in one process",
    "drivers_apart": "two processes: drivers; all other nodes",
    "separate": "one process for each node",
}
PROFILE = "profile.json"
SPIN_US: int = LiveDriverParameters.model_fields["spin_us"].default
FALSE_ALARM = 1e-9
"""For the chi-square test: scans that come again and again would fail by their noise again and again, and be lost."""


@dataclass(frozen=True)
class Load:
    """What is to run.

    Attributes:
        arm: From ``made_arm``.
        kind: The graph or its floor.
        layout: What shares a process.
        rate: Scans per second.
        spin_us: For how long drivers look at the clock before each tick instead of sleeping [us].
        priority: SCHED_FIFO priority of the graph's processes; 0: none.
        profiled: Whether with stopwatches, which write ``PROFILE`` in the folder of the run.

    """

    arm: Arm
    kind: Kind
    layout: Layout
    rate: int
    spin_us: int = SPIN_US
    priority: int = 0
    profiled: bool = False

    @property
    def name(self) -> str:
        """For people and for folders."""
        waiting = "" if (self.spin_us, self.priority) == (SPIN_US, 0) else f"_spin{self.spin_us}_{self.priority}"
        return f"{self.kind}_{self.layout}_{len(self.arm.calibrations)}x{self.rate}{waiting}"


def processes(load: Load, folder: Path) -> list[Program]:
    """Return the programs, those that listen first; their files go into a folder."""
    driver: dict[str, Parameter] = {"looped.rate": load.rate, "spin_us": load.spin_us}
    nodes = [_node(program, load.arm, load.kind) for program in arm_programs(load.arm, driver_parameters=driver)]
    if load.layout == "separate":
        programs = [_alone(node, folder / node.name.replace("/", ".")) for node in nodes]
    else:
        programs = laid_out(nodes, load.layout, folder)
    if load.priority:
        for program in programs:
            with Path(program.arguments[0]).open("a", encoding="utf-8") as file:
                file.write(f"realtime: {{priority: {load.priority}}}\n")
    if not load.profiled:
        return programs
    script, out = str(profiled.__file__), str(folder / PROFILE)
    return [Script(program.name, "", script, (*program.arguments, out)) for program in programs]


def _alone(node: Program, folder: Path) -> Program:
    """Return a node in a process of its own, which yet is a composed one: the floor's nodes are no programs."""
    folder.mkdir()
    (program,) = laid_out([node], "composed", folder)
    return replace(program, name=node.name)


def _node(program: Program, arm: Arm, kind: Kind) -> Program:
    """Return what stands for a node of the arm: itself, or on the floor what does nothing in its place."""
    joint = program.name.partition("/")[0]
    if program.executable == "posor_node":
        if kind == "graph":
            return replace(program, parameters={**program.parameters, "false_alarm": FALSE_ALARM})
        frames = arm.calibration(joint).frames
        return replace(program, executable=FloorPosor.NAME, parameters={"parent": frames.parent, "child": frames.child})
    if program.executable == "chain_node" and kind == "floor":
        chain = arm.chain()
        joints = [joint.name for joint in chain.joints]
        return replace(program, executable=FloorChain.NAME, parameters={"joints": joints, "frame": chain.base_frame})
    return program
