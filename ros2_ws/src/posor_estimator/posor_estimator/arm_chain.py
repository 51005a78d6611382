"""What an arm's chain_node is told, live and offline."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.chain_node import ChainNode, ChainParameters
from posor_estimator.errors import NodeError, ParameterError
from posor_estimator.ros.declaration import ROS_OWN
from posor_estimator.ros.parameters import validate

if TYPE_CHECKING:
    from posor_estimator.core.arm import Arm, ParameterValue


def chain_parameters(arm: Arm) -> dict[str, ParameterValue]:
    """Return the ROS parameters of an arm's chain_node.

    Raises:
        NodeError: The arm file gives a parameter that chain_node does not take; names the line.

    """
    parameters: dict[str, ParameterValue] = {"urdf": str(arm.urdf), "endpoint_frame": arm.endpoint_frame}
    if arm.beams is not None:
        parameters["beams"] = str(arm.beams)
    parameters |= arm.chain_parameters
    own = {name: value for name, value in parameters.items() if not name.startswith(ROS_OWN)}
    try:
        validate(ChainParameters, own, node=ChainNode.NAME)
    except ParameterError as error:
        raise NodeError(error, ChainNode.NAME, arm.chain_places.get(error.parameter, str(arm.path))) from error
    return parameters
