# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes of an arm as programs, and how they share processes; used by ``bringup``, the launch file and the tests."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

import yaml
from posor.chain.arm_file import CHAIN_NODE, POSOR_NODE, conflicting_parameters, node_errors, posor_parameters
from posor.chain.arm_file import chain_parameters as chain_parameters_of
from posor.errors import ErrorCollector, ParameterError, PosorError, similar_name
from posor.node_parameters import RECORDING, ChainParameters, PosorParameters
from posor.output_files import write_files
from posor.parameter_model import check_boolean_parameters, validate_parameters
from posor.ros_names import JOINT_STATES_TOPIC, ROS_OWN_PARAMETERS, TEMPERATURE_TOPIC
from posor_drivers.driver_parameters import driver_parameters_for
from posor_drivers.sources.source import LiveSource, load_source_class
from posor_ros.parameter_files import load_parameter_file
from posor_ros.qos_overrides import PREFIX, QosOverrides

from posor_bringup.supervisor import ProgramCommand

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from pydantic import BaseModel

    from posor_bringup.supervisor import Parameter

DRIVER_NODE = "driver_node"
Layout = Literal["separate", "drivers_apart", "composed"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
"""One process for each node; one for all drivers and one for all other nodes; one for all nodes."""


def arm_programs(
    arm: ArmFile,
    *,
    drivers: bool = True,
    driver_parameters: Mapping[str, Parameter] | None = None,
    chain_parameters: Mapping[str, Parameter] | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    parameter_files: Sequence[Path] = (),
) -> list[ProgramCommand]:
    """Return one program for each node, subscribers first: chain_node, then posor_node and driver_node of each joint.

    Args:
        arm: The arm.
        drivers: Whether to start the drivers; without them the scans come from elsewhere, such as a bag.
        driver_parameters: ROS parameters of all drivers; they replace those of the arm file.
        chain_parameters: ROS parameters of chain_node; they replace those of the arm file, but not its files.
        parameters: ROS parameters of all nodes, such as ``use_sim_time``; they replace the freshness of the stamps that
            follows from the source.
        parameter_files: ROS parameter files; their values replace all others, but not the files of the arm file.

    Raises:
        NodeError: A node has an unknown parameter or an invalid value.
        ParameterError: A driver parameter of the arm file contains an unknown placeholder, or a section of a parameter
            file is for no node of the arm.
        CalibrationError: A parameter file cannot be read.
        SeveralErrors: More than one of these.

    """
    errors, given = ErrorCollector(), driver_parameters or {}
    common = {**(_freshness(arm, given) if drivers else {}), **(parameters or {})}
    chain = {**chain_parameters_of(arm, checked=False), **common, **(chain_parameters or {})}
    programs = [_arm_node(arm, "", "posor_estimator", CHAIN_NODE, chain)]
    for joint in arm.calibrations:
        with errors.collecting():
            posor = {**posor_parameters(arm, joint, checked=False), **common}
            programs.append(_arm_node(arm, joint, "posor_estimator", POSOR_NODE, posor))
    for joint in arm.calibrations if drivers else ():
        with errors.collecting():
            source = str(given.get("source", arm.driver.source))
            driver = {**_driver_parameters(arm, joint, source), **common, **given}
            programs.append(_arm_node(arm, joint, "posor_drivers", DRIVER_NODE, driver))
    names, places = [full_name(program) for program in programs], dict[tuple[str, str], str]()
    elsewhere = [] if drivers else [f"{arm.namespace}/{joint}/{DRIVER_NODE}" for joint in arm.calibrations]
    for path in parameter_files:
        with errors.collecting():
            for section in load_parameter_file(path):
                if not any(map(section.is_for, [*names, *elsewhere])):
                    what, expected = f"no node of the arm is called '{section.name}'", f"one of {', '.join(names)}"
                    expected = similar_name(section.name, names, expected)
                    errors.add(ParameterError(what, where=section.place, expected=expected))
                for n, name in enumerate(names):
                    if section.is_for(name):
                        programs[n] = replace(programs[n], parameters={**programs[n].parameters, **section.parameters})
                        places |= {(name, each): place for each, place in section.places.items()}
    options = {name: f"option -p {name}" for name in given}
    for name, program in zip(names, programs, strict=True):
        joint = program.namespace.removeprefix(arm.namespace).lstrip("/")
        own = {**arm.driver_locations, **options} if program.executable == DRIVER_NODE else arm.node_locations(joint)
        of_files = {each: place for (node, each), place in places.items() if node == name}
        if found := [*_parameter_errors(program), *_file_errors(arm, joint, program)]:
            node = DRIVER_NODE if program.executable == DRIVER_NODE else program.name  # errors of all drivers are one
            errors.add(node_errors(found, node, {**own, **of_files}, str(arm.path)))
    errors.raise_errors()
    return programs


def full_name(program: ProgramCommand) -> str:
    """Return the name of a program's node in the graph."""
    return f"{program.namespace}/{program.executable}"


def frame_prefix_of(programs: Sequence[ProgramCommand]) -> str:
    """Return the prefix of the frames that chain_node of these programs publishes."""
    return "".join(str(each.parameters.get("frame_prefix", "")) for each in programs if each.executable == CHAIN_NODE)


def endpoint_frame_of(programs: Sequence[ProgramCommand]) -> str:
    """Return the endpoint frame that chain_node of these programs publishes on ``/tf``; empty: it publishes none."""
    for each in programs:
        if each.executable == CHAIN_NODE and each.parameters.get("tf_rate", math.inf):
            return f"{frame_prefix_of(programs)}{each.parameters.get('endpoint_frame', '')}"
    return ""


def own_parameters(program: ProgramCommand) -> dict[str, Parameter]:
    """Return the parameters that a program's node declares, without those of every node of rclpy."""
    return {name: value for name, value in program.parameters.items() if not name.startswith(ROS_OWN_PARAMETERS)}


def _parameter_errors(program: ProgramCommand) -> list[PosorError]:
    """Return an error for each parameter that the node of a program will not accept."""
    errors, own, name = ErrorCollector(), own_parameters(program), program.executable
    with errors.collecting():
        QosOverrides(name, {each: value for each, value in program.parameters.items() if each.startswith(PREFIX)})
    with errors.collecting():
        check_boolean_parameters(program.parameters, node=program.name)
    model: type[BaseModel] = PosorParameters if name == POSOR_NODE else ChainParameters
    if name == DRIVER_NODE:
        with errors.collecting():
            driver_parameters_for(own)
        wrong = {error.parameter for error in errors.errors if isinstance(error, ParameterError)}
        if "source" in wrong:
            return errors.errors
        own = {each: value for each, value in own.items() if each not in wrong}
        model = driver_parameters_for(own)
    with errors.collecting():
        validate_parameters(model, own, node=name if name == DRIVER_NODE else program.name)
    return errors.errors


def _file_errors(arm: ArmFile, joint: str, program: ProgramCommand) -> list[ParameterError]:
    """Return an error for each parameter that contradicts the arm file."""
    if program.executable != DRIVER_NODE:
        return [*conflicting_parameters(arm, joint, program.parameters), *_own_angles(arm, program)]
    if program.parameters.get("restamp") is not True or len(arm.calibrations) == 1:
        return []
    # Each driver begins at a time of its own, so that no stamp of a joint would be that of another one.
    what = f"restamp: true with {len(arm.calibrations)} joints, which need common stamps"
    return [ParameterError(what, expected="false, for the recorded stamps", parameter="restamp")]


def _own_angles(arm: ArmFile, program: ProgramCommand) -> list[ParameterError]:
    """Return an error if a node takes the angles that chain_node publishes for those of encoders."""
    own = f"{arm.namespace}/{JOINT_STATES_TOPIC}"
    found = {name: str(program.parameters.get(name, "")) for name in ("encoder.topic", "encoders.topic")}
    return [
        ParameterError(f"{name}: {topic}", expected="encoders; these are the POSORs' own angles", parameter=name)
        for name, topic in found.items()
        if own in (topic, f"{program.namespace}/{topic}")
    ]


def _arm_node(
    arm: ArmFile, joint: str, package: str, executable: str, parameters: Mapping[str, Parameter]
) -> ProgramCommand:
    """Return the program of one node in the namespace of its arm (without a joint) or joint."""
    below = f"/{joint}" if joint else ""
    namespace, ends = f"{arm.namespace}{below}", executable == DRIVER_NODE
    enclave = f"{namespace}/{executable}"
    return ProgramCommand(
        f"{below}/{executable}".lstrip("/"), package, executable, (), namespace, parameters, ends, enclave
    )


def _freshness(arm: ArmFile, driver_parameters: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
    """Return the freshness that all nodes expect of the stamps: any age of a recording that keeps its stamps."""
    parameters = {"source": arm.driver.source, **arm.driver.parameters, **driver_parameters}
    with suppress(ParameterError):  # an unknown source is an error of each driver
        if not (parameters.get("restamp") or issubclass(load_source_class(str(parameters["source"])), LiveSource)):
            return RECORDING
    return {}


def _driver_parameters(arm: ArmFile, joint: str, source: str) -> dict[str, Parameter]:
    """Return the driver parameters of the arm file for a source, with their placeholders filled in."""
    parameters: dict[str, Parameter] = {"source": source}
    if source == "simulated":
        parameters |= {"simulated.arm": str(arm.path.resolve()), "simulated.joint": joint}
        if arm.outer_namespace:
            parameters["simulated.namespace"] = arm.outer_namespace
    if source == "instruments":
        parameters["instruments.temperature_topic"] = f"{arm.namespace}/{TEMPERATURE_TOPIC}"
    return parameters | arm.fill_placeholders(arm.driver.parameters, joint, arm.driver_locations)


def group_programs(programs: Sequence[ProgramCommand], layout: Layout, folder: Path) -> list[ProgramCommand]:
    """Return programs that run the same nodes in fewer processes.

    ``programs`` are of one node each, subscribers first; ``folder`` exists and receives the composition files. Raises
    OutputError: a composition file cannot be written.
    """
    if layout == "separate":
        return list(programs)
    enclave = f"{programs[0].namespace}/compose"  # subscribers first: chain_node, in the namespace of the arm
    if layout == "composed":
        return [_compose("nodes", programs, enclave, folder)]
    drivers = [program for program in programs if program.ends]
    groups = {"nodes": [program for program in programs if not program.ends], "drivers": drivers}
    return [_compose(name, group, enclave, folder) for name, group in groups.items() if group]


def _compose(name: str, programs: Sequence[ProgramCommand], enclave: str, folder: Path) -> ProgramCommand:
    """Return a program that runs the nodes of several programs in one process; write its composition file."""
    nodes = [
        {"node": program.executable, "namespace": program.namespace or "/", "parameters": dict(program.parameters)}
        for program in programs
    ]
    path = folder / f"{name}.yaml"
    content = {"format": "posor_composition", "version": 1, "nodes": nodes}
    write_files({path: yaml.safe_dump(content, sort_keys=False)})
    ends = all(program.ends for program in programs)
    return ProgramCommand(name, "posor_estimator", "compose", (str(path),), ends=ends, enclave=enclave)
