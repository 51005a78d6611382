"""The parameters of driver_node, as its model declares them; they depend on the source."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from posor_estimator.errors import ParameterError
from posor_estimator.ros.parameters import NodeParameters
from pydantic import Field, create_model

from posor_drivers.conditioned_scans import ConditioningParameters
from posor_drivers.sources.base import LiveSource
from posor_drivers.sources.registry import source_class
from posor_drivers.timeline import ReplayParameters

if TYPE_CHECKING:
    from collections.abc import Mapping


class DriverParameters(NodeParameters):
    """What every driver has."""

    source: str = Field(description="where the scans come from: the name of a source, such as 'table' or 'bag'")
    wait_for_subscribers: Annotated[int, Field(ge=0)] = Field(
        default=1, description="begin when this many subscriptions to the scans are there; 0: at once"
    )
    wait_for_other_subscribers: Annotated[int, Field(ge=0)] = Field(
        default=0, description="begin when this many subscriptions to each other topic are there"
    )
    on_end: Literal["exit", "stay"] = Field(
        default="exit", description="after the last message: end the program, or stay in the graph"
    )
    conditioning: ConditioningParameters = ConditioningParameters()


class LiveDriverParameters(DriverParameters):
    """What a driver has whose source is live."""

    spin_us: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=50, description="look at the clock instead of sleeping for this long before each tick [us]; 0: never"
    )


class ReplayDriverParameters(DriverParameters, ReplayParameters):
    """What a driver has whose source is recorded: the pace of the replay. A live source has its own."""


def parameters_for(overrides: Mapping[str, object]) -> type[DriverParameters]:
    """Return the parameters of a driver with the source that the user chose, the source's own as a group.

    Raises:
        ParameterError: There is no such source, or it is live and the user would replay it.

    """
    name = overrides.get("source")
    if not isinstance(name, str):
        return ReplayDriverParameters
    kind = source_class(name)
    group: Any = (kind.Parameters, ...)
    if not issubclass(kind, LiveSource):
        return create_model("DriverParameters", __base__=ReplayDriverParameters, **{name: group})
    for pace in sorted(ReplayParameters.model_fields.keys() - NodeParameters.model_fields.keys()):
        if pace in overrides:
            raise ParameterError(
                f"source '{name}' is live, its scans happen when they happen",
                where=f"parameter '{pace}'",
                expected="a recorded source, or none of the parameters of a replay",
            )
    return create_model("DriverParameters", __base__=LiveDriverParameters, **{name: group})
