"""The nodes of an arm as programs, and how they share processes; used by ``bringup``, the launch file and the tests."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal, get_args

import yaml
from posor.chain.arm_file import chain_parameters as chain_parameters_of
from posor.chain.arm_file import posor_parameters
from posor.errors import ParameterError
from posor.node_parameters import RECORDING
from posor_drivers.sources.source import LiveSource, load_source_class

from posor_bringup.supervisor import ProgramCommand

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile

    from posor_bringup.supervisor import Parameter

Layout = Literal["separate", "drivers_apart", "composed"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
"""One process for each node; one for all drivers and one for all other nodes; one for all nodes."""

_PLACEHOLDER = re.compile(r"\{(\w+)\}")


def arm_programs(
    arm: ArmFile,
    *,
    drivers: bool = True,
    driver_parameters: Mapping[str, Parameter] | None = None,
    chain_parameters: Mapping[str, Parameter] | None = None,
    parameters: Mapping[str, Parameter] | None = None,
) -> list[ProgramCommand]:
    """Return one program for each node, subscribers first: chain_node, then posor_node and driver_node of each joint.

    Args:
        arm: The arm.
        drivers: Whether to start the drivers; without them the scans come from elsewhere, such as a bag.
        driver_parameters: ROS parameters of all drivers; they replace those of the arm file.
        chain_parameters: ROS parameters of chain_node; they replace those of the arm file.
        parameters: ROS parameters of all nodes, such as ``use_sim_time``; they replace the freshness of the stamps that
            follows from the source.

    Raises:
        NodeError: The arm file has an unknown parameter of chain_node or of a posor_node.
        ParameterError: A driver parameter of the arm file contains an unknown placeholder.

    """
    common = {**(_freshness(arm, driver_parameters or {}) if drivers else {}), **(parameters or {})}
    chain = {**chain_parameters_of(arm), **common, **(chain_parameters or {})}
    programs = [_arm_node("posor_estimator", "chain_node", f"/{arm.name}", chain)]
    for joint in arm.calibrations:
        posor = {**posor_parameters(arm, joint), **common}
        programs.append(_arm_node("posor_estimator", "posor_node", f"/{arm.name}/{joint}", posor))
    for joint in arm.calibrations if drivers else ():
        driver = {**_driver_parameters(arm, joint), **common, **(driver_parameters or {})}
        programs.append(_arm_node("posor_drivers", "driver_node", f"/{arm.name}/{joint}", driver))
    return programs


def _arm_node(package: str, executable: str, namespace: str, parameters: Mapping[str, Parameter]) -> ProgramCommand:
    """Return the program of one node in the namespace of its arm or joint."""
    joint = "".join(f"{name}/" for name in namespace.split("/")[2:])
    ends = executable == "driver_node"
    enclave = f"{namespace}/{executable}"
    return ProgramCommand(f"{joint}{executable}", package, executable, (), namespace, parameters, ends, enclave)


def _freshness(arm: ArmFile, driver_parameters: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
    """Return the freshness that all nodes expect of the stamps: any age of a recording that keeps its stamps."""
    parameters = {"source": arm.driver.source, **arm.driver.parameters, **driver_parameters}
    is_live = issubclass(load_source_class(str(parameters["source"])), LiveSource)
    return {} if is_live or parameters.get("restamp") else RECORDING


def _driver_parameters(arm: ArmFile, joint: str) -> dict[str, Parameter]:
    """Return the driver parameters of the arm file with their placeholders filled in."""
    parameters: dict[str, Parameter] = {"source": arm.driver.source}
    if arm.driver.source == "simulated":
        parameters |= {"simulated.arm": str(arm.path.resolve()), "simulated.joint": joint}
    known = {"arm": arm.name, "joint": joint, "folder": str(arm.path.resolve().parent)}
    for name, value in arm.driver.parameters.items():
        where = f"{arm.path}, key driver.parameters.{name}"
        if isinstance(value, list):
            parameters[name] = [_fill_placeholders(entry, known, where) for entry in value]
        else:
            parameters[name] = _fill_placeholders(value, known, where) if isinstance(value, str) else value
    return parameters


def _fill_placeholders(text: str, known: Mapping[str, str], where: str) -> str:
    def replacement(match: re.Match[str]) -> str:
        if match[1] not in known:
            raise ParameterError(
                f"'{match[0]}' is an unknown placeholder", where=where, expected="{arm}, {joint} or {folder}"
            )
        return known[match[1]]

    return _PLACEHOLDER.sub(replacement, text)


def group_programs(programs: Sequence[ProgramCommand], layout: Layout, folder: Path) -> list[ProgramCommand]:
    """Return programs that run the same nodes in fewer processes.

    ``programs`` are of one node each, subscribers first; ``folder`` exists and receives the composition files.
    """
    if layout == "separate":
        return list(programs)
    if layout == "composed":
        return [_compose("nodes", programs, folder)]
    drivers = [program for program in programs if program.ends]
    groups = {"nodes": [program for program in programs if not program.ends], "drivers": drivers}
    return [_compose(name, group, folder) for name, group in groups.items() if group]


def _compose(name: str, programs: Sequence[ProgramCommand], folder: Path) -> ProgramCommand:
    """Return a program that runs the nodes of several programs in one process; write its composition file."""
    nodes = [
        {"node": program.executable, "namespace": program.namespace or "/", "parameters": dict(program.parameters)}
        for program in programs
    ]
    path = folder / f"{name}.yaml"
    content = {"format": "posor_composition", "version": 1, "nodes": nodes}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    ends = all(program.ends for program in programs)
    enclave = "/".join(["", *programs[0].namespace.split("/")[1:2], "compose"])
    return ProgramCommand(name, "posor_estimator", "compose", (str(path),), ends=ends, enclave=enclave)
