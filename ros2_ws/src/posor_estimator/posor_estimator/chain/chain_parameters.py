"""Values of chain_node's parameters for an arm file. This module imports no ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.errors import NodeError, ParameterError
from posor_estimator.node_parameters import ChainParameters
from posor_estimator.parameter_model import validate_parameters
from posor_estimator.ros_names import ROS_OWN_PARAMETERS

if TYPE_CHECKING:
    from posor_estimator.chain.arm_file import Arm, ParameterValue

CHAIN_NODE = "chain_node"


def chain_parameters(arm: Arm) -> dict[str, ParameterValue]:
    """Return the ROS parameters of an arm's chain_node.

    Raises:
        NodeError: The arm file gives chain_node an unknown parameter or an invalid value; names the line.

    """
    parameters: dict[str, ParameterValue] = {"urdf": str(arm.urdf), "endpoint_frame": arm.endpoint_frame}
    if arm.beams is not None:
        parameters["beams"] = str(arm.beams)
    parameters |= arm.chain_parameters
    own = {name: value for name, value in parameters.items() if not name.startswith(ROS_OWN_PARAMETERS)}
    try:
        validate_parameters(ChainParameters, own, node=CHAIN_NODE)
    except ParameterError as error:
        place = arm.parameter_locations.get(error.parameter, str(arm.path))
        raise NodeError(error, CHAIN_NODE, place) from error
    return parameters
