"""Parameters of posor_node."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from posor_estimator.core.calibrate.digital_zero import LEAST
from posor_estimator.ros.messages import CovarianceKind  # noqa: TC001  read by pydantic
from posor_estimator.ros.parameters import NodeParameters

HOME = ("gap", "alpha", "beta")
"""What parameter ``home_pose`` says of a place."""


class PosorParameters(NodeParameters):
    """Parameters of posor_node."""

    calibration: str = Field(description="path of the calibration file (YAML) of this joint's POSOR")
    session: str = Field(
        default="", description="session of the calibration file whose zero shifts and maps apply; empty: none"
    )
    covariance: CovarianceKind = Field(
        default="total",
        description="which uncertainty to publish: of the readings' noise, of the calibration, or of both",
    )
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=1e-3, description="probability that the chi-square test of the redundant readings rejects a sound scan"
    )
    home_pose: tuple[float, ...] = Field(
        default=(),
        description="gap [m], alpha and beta [rad] of the place that ~/zero makes home; empty: no such service",
    )
    zero_scans: Annotated[int, Field(ge=LEAST, le=100_000)] = Field(
        default=100, description="number of scans, the last ones, whose mean ~/zero takes"
    )

    @field_validator("home_pose")
    @classmethod
    def _three(cls, home: tuple[float, ...]) -> tuple[float, ...]:
        if len(home) not in (0, len(HOME)):
            message = f"{len(home)} numbers; expected 3: {', '.join(HOME)}, or none"
            raise ValueError(message)
        return home
