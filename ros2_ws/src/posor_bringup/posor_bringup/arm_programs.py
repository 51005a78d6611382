"""What runs when an arm is up: the same list of programs for ``bringup``, for the demo and for the launch file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from posor_estimator.arm_chain import chain_parameters
from posor_estimator.errors import ParameterError

from posor_bringup.supervisor import Program

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.arm import Arm

    from posor_bringup.supervisor import Parameter

_PLACEHOLDER = re.compile(r"\{(\w+)\}")


def arm_programs(
    arm: Arm,
    *,
    drivers: bool = True,
    driver_parameters: Mapping[str, Parameter] | None = None,
    chain_parameters: Mapping[str, Parameter] | None = None,
    parameters: Mapping[str, Parameter] | None = None,
) -> list[Program]:
    """Return the programs of an arm, those that listen first: chain_node, then each joint's posor_node and driver_node.

    Args:
        arm: The arm.
        drivers: Whether to start the drivers; without them the scans come from elsewhere, such as a bag.
        driver_parameters: ROS parameters for every driver, over those of the arm file.
        chain_parameters: The same for chain_node.
        parameters: ROS parameters for every node, such as ``use_sim_time``.

    Raises:
        NodeError: The arm file gives chain_node parameters that it does not take.
        ParameterError: A parameter of the arm file names something in braces that is neither arm, joint nor folder.

    """
    every = dict(parameters or {})
    programs = [_chain(arm, {**every, **(chain_parameters or {})})]
    programs += [_posor(arm, joint, every) for joint in arm.calibrations]
    if drivers:
        programs += [_driver(arm, joint, {**every, **(driver_parameters or {})}) for joint in arm.calibrations]
    return programs


def _chain(arm: Arm, overrides: Mapping[str, Parameter]) -> Program:
    parameters = {**chain_parameters(arm), **overrides}
    return Program("chain_node", "posor_estimator", "chain_node", (), f"/{arm.name}", parameters)


def _posor(arm: Arm, joint: str, every: Mapping[str, Parameter]) -> Program:
    parameters: dict[str, Parameter] = {
        "calibration": str(arm.calibrations[joint]),
        "session": arm.sessions[joint],
        **every,
    }
    return Program(f"{joint}/posor_node", "posor_estimator", "posor_node", (), f"/{arm.name}/{joint}", parameters)


def _driver(arm: Arm, joint: str, overrides: Mapping[str, Parameter]) -> Program:
    parameters: dict[str, Parameter] = {"source": arm.driver.source}
    if arm.driver.source == "simulated":
        parameters |= {"simulated.arm": str(arm.path.resolve()), "simulated.joint": joint}
    parameters |= {name: _filled(name, value, arm, joint) for name, value in arm.driver.parameters.items()}
    return Program(
        f"{joint}/driver_node",
        "posor_drivers",
        "driver_node",
        (),
        f"/{arm.name}/{joint}",
        {**parameters, **overrides},
        ends=True,
    )


def _filled(name: str, value: Parameter, arm: Arm, joint: str) -> Parameter:
    """Return a parameter of the arm file with {arm}, {joint} and {folder}, that of the arm file, replaced."""
    if isinstance(value, list):
        return [_text(name, entry, arm, joint) for entry in value]
    return _text(name, value, arm, joint) if isinstance(value, str) else value


def _text(name: str, text: str, arm: Arm, joint: str) -> str:
    known = {"arm": arm.name, "joint": joint, "folder": str(arm.path.resolve().parent)}

    def replacement(match: re.Match[str]) -> str:
        if match[1] not in known:
            raise ParameterError(
                f"'{match[0]}' stands for nothing",
                where=f"{arm.path}, key driver.parameters.{name}",
                expected="{arm}, {joint} or {folder}",
            )
        return known[match[1]]

    return _PLACEHOLDER.sub(replacement, text)
