"""Values of the parameters of an arm's nodes, from its arm file. This module imports no ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.errors import NodeError, ParameterError
from posor.node_parameters import ChainParameters, PosorParameters
from posor.parameter_model import validate_parameters
from posor.ros_names import ROS_OWN_PARAMETERS

if TYPE_CHECKING:
    from posor.chain.arm_file import ArmFile, ParameterValue
    from posor.parameter_model import ParameterGroup

CHAIN_NODE, POSOR_NODE = "chain_node", "posor_node"


def chain_parameters(arm: ArmFile) -> dict[str, ParameterValue]:
    """Return the ROS parameters of an arm's chain_node.

    Raises NodeError: the arm file gives chain_node an unknown parameter or an invalid value; names the line.
    """
    parameters: dict[str, ParameterValue] = {"urdf": str(arm.urdf), "endpoint_frame": arm.endpoint_frame}
    if arm.beams is not None:
        parameters["beams"] = str(arm.beams)
    return _checked(arm, "", ChainParameters, {**parameters, **arm.chain_parameters})


def posor_parameters(arm: ArmFile, joint: str) -> dict[str, ParameterValue]:
    """Return the ROS parameters of a joint's posor_node.

    Raises NodeError: the arm file gives posor_node an unknown parameter or an invalid value; names the line.
    """
    parameters = {"calibration": str(arm.calibrations[joint]), "session": arm.sessions[joint]}
    return _checked(arm, joint, PosorParameters, {**parameters, **arm.posor_parameters[joint]})


def _checked(
    arm: ArmFile, joint: str, model: type[ParameterGroup], parameters: dict[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the parameters if the node (of a joint; '': chain_node) accepts them."""
    own = {name: value for name, value in parameters.items() if not name.startswith(ROS_OWN_PARAMETERS)}
    node = f"{joint}/{POSOR_NODE}" if joint else CHAIN_NODE
    try:
        validate_parameters(model, own, node=node)
    except ParameterError as error:
        place = arm.parameter_locations.get((joint, error.parameter), str(arm.path))
        raise NodeError(error, node, place) from error
    return parameters
