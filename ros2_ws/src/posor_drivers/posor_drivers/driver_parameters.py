# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of ``driver_node``; the user's choice of the source adds the parameters of that source."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

from posor.errors import ParameterError, sum_up
from posor.node_parameters import NodeParameters
from posor.parameter_model import FixedAtStart, ParameterGroup
from pydantic import ConfigDict, Field, create_model, model_validator

from posor_drivers.sample_average import MIN_SAMPLES
from posor_drivers.sources.source import LiveSource, load_source_class

if TYPE_CHECKING:
    from collections.abc import Mapping


class ConditioningParameters(ParameterGroup):
    """Averaging of several scans of the source to one published scan."""

    method: Literal["none", "mean", "trimmed"] = Field(
        default="none",
        description="how several scans become one; trimmed: the mean without outliers, one in five at most",
    )
    samples: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1, description="consecutive scans of the source that become one published scan"
    )
    significance: Annotated[float, Field(gt=0.0, le=0.2)] = Field(
        default=0.01, description="method trimmed: probability that a probe or diode without outliers loses a sample"
    )
    subtract_dark: bool = Field(
        default=False, description="subtract the mean of the neighbouring scans without light from the diode currents"
    )

    @model_validator(mode="after")
    def _check_samples(self) -> ConditioningParameters:
        least = {"none": 1, "mean": 2, "trimmed": MIN_SAMPLES}[self.method]
        if self.samples < least:
            text = f"{self.samples} is too few for 'conditioning.method' '{self.method}'; expected at least {least}"
            raise ValueError(f"'conditioning.samples' {text}")
        if self.method == "none" and self.samples > 1:
            text = "but 'conditioning.method' is 'none'; expected method 'mean' or 'trimmed', or 1 sample"
            raise ValueError(f"'conditioning.samples' is {self.samples} {text}")
        return self

    @property
    def passes_scans_unchanged(self) -> bool:
        """Whether scans are published as the source provides them."""
        return self.method == "none" and not self.subtract_dark


class TimeParameters(ParameterGroup):
    """Fields of the scans on their times, in place of what the source states; a default leaves the source's."""

    model_config = ConfigDict(allow_inf_nan=True)

    stamp_uncertainty: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=0.0, description="standard uncertainty of the stamps [s]; 0: as the source states"
    )
    stamp_limit: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=0.0, description="largest error of the stamps [s]; 0: as the source states"
    )
    exposure_offsets: tuple[float, ...] = Field(
        default=(),
        description="middle of each channel's exposure minus the stamp [s], in the order gap probes, ring probes, "
        "contact currents; .nan: unknown; empty: as the source states",
    )
    exposure_span: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        default=0.0, description="time within which exposures that are unknown lie [s]; 0: as the source states"
    )


class DriverParameters(NodeParameters):
    """Parameters of every driver."""

    source: Annotated[str, FixedAtStart()] = Field(
        description="where the scans come from: the name of a source, such as 'table' or 'bag'"
    )
    wait_for_subscribers: Annotated[int, Field(ge=0)] = Field(
        default=1, description="start once the scans have this many subscriptions; 0: at once"
    )
    wait_for_other_subscribers: Annotated[int, Field(ge=0)] = Field(
        default=0, description="start once each other topic has this many subscriptions"
    )
    on_end: Literal["exit", "stay"] = Field(
        default="exit", description="after the last message: end the program, or stay in the graph"
    )
    conditioning: ConditioningParameters = ConditioningParameters()
    time: TimeParameters = TimeParameters()


class LiveDriverParameters(DriverParameters):
    """Parameters of a driver with a live source."""

    spin_us: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=50, description="poll the clock instead of sleeping for this long before each tick [us]; 0: never"
    )


class ReplayParameters(NodeParameters):
    """Pace, part and stamps of a replay."""

    rate: Annotated[float, Field(ge=0.0, le=10_000.0)] = Field(
        default=1.0, description="speed of the replay, 1 is real time; 0: as fast as possible"
    )
    loop: bool = Field(
        default=False, description="start over at the end; stamps and scan numbers continue as if the record went on"
    )
    restamp: bool = Field(
        default=False, description="move the stamps so that the replay starts now; false: keep the recorded stamps"
    )
    start_offset: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="skip this much of the record's beginning [s]"
    )
    stop_offset: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(
        default=math.inf, description="stop before this time after the record's beginning [s]; .inf: at its end"
    )

    @model_validator(mode="after")
    def _check_offsets(self) -> ReplayParameters:
        if not self.stop_offset > self.start_offset:
            text = f"'stop_offset' {self.stop_offset} is not greater than 'start_offset' {self.start_offset}"
            raise ValueError(text)
        return self


class ReplayDriverParameters(DriverParameters, ReplayParameters):
    """Parameters of a driver with a recorded source."""


def driver_parameters_for(overrides: Mapping[str, object]) -> type[DriverParameters]:
    """Return the parameters of a driver with the source that the user chose; the source's own are a group.

    Raises:
        ParameterError: The source is unknown, or it is live and a parameter of a replay is set.

    """
    name = overrides.get("source")
    if not isinstance(name, str):
        return ReplayDriverParameters
    source = load_source_class(name)
    group: Any = (source.Parameters, ...)
    if not issubclass(source, LiveSource):
        return create_model("DriverParameters", __base__=ReplayDriverParameters, **{name: group})
    replay = sorted(ReplayParameters.model_fields.keys() - NodeParameters.model_fields.keys())
    what, expected = (
        f"source '{name}' is live and cannot be replayed",
        "a recorded source, or no parameters of a replay",
    )
    errors = [
        ParameterError(what, where=f"parameter '{each}'", expected=expected, parameter=each)
        for each in replay
        if each in overrides
    ]
    if errors:
        raise sum_up(errors)
    return create_model("DriverParameters", __base__=LiveDriverParameters, **{name: group})
