"""The calibration file of one POSOR, version 1.

Versions of the format:

1. First version: ``sensors`` by type, ``sessions``, ``tilt_angle``, ``motion``.
"""

from __future__ import annotations

import hashlib
import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

from pydantic import Field, SerializeAsAny, create_model

from posor_estimator.core.calibration.quantity import FrozenModel, Quantity, measured
from posor_estimator.core.calibration.session import Session
from posor_estimator.core.sensors.base import SensorCalibration
from posor_estimator.core.sensors.registry import sensor_types
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping

VERSION = 1


class Provenance(FrozenModel):
    """Where the numbers come from."""

    source: str
    method: str
    date: str
    notes: tuple[str, ...] = ()


class Frames(FrozenModel):
    """Names of the two frames: ``parent`` is the receiving plate R, ``child`` the target plate T."""

    parent: str
    child: str


class Motion(FrozenModel):
    """The fastest that the target moves against the receiving plate.

    A pose further from the last one than this allows is a fault, and where readings are blind in some direction the
    last pose stands in with an uncertainty that grows at this rate. ``translation`` is across and along, ``lean``
    about X and Y, ``theta`` about the target's Z.
    """

    translation: Annotated[Quantity, measured("m/s")]
    lean: Annotated[Quantity, measured("rad/s")]
    theta: Annotated[Quantity, measured("rad/s")]


class TiltAngle(StrEnum):
    """At which theta the directions fixed in the target (plane normal, rays) are turned.

    ``THIS_SCAN`` is exact. ``PREVIOUS_SCAN`` is what the program of thesis appendix 8A did: each step's tilt terms were
    evaluated at the theta of the step before. It is here to reproduce the tables printed in 1985.
    """

    THIS_SCAN = "this_scan"
    PREVIOUS_SCAN = "previous_scan"


class Calibration(FrozenModel):
    """All that is known of one POSOR."""

    format: Literal["posor_calibration"]
    version: Literal[1]
    name: str
    provenance: Provenance
    frames: Frames
    tilt_angle: TiltAngle = TiltAngle.THIS_SCAN
    motion: Motion | None = None
    sensors: list[SerializeAsAny[SensorCalibration]]
    sessions: dict[str, Session] = Field(default_factory=dict)

    @property
    def content_hash(self) -> str:
        """SHA-256 of everything the file says, whatever its layout or comments; 64 hexadecimal digits."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def for_session(self, name: str) -> Self:
        """Return the calibration with one session's replacements applied; an empty name leaves it as it is.

        Raises:
            CalibrationError: There is no such session, or it does not fit the sensors.

        """
        if not name:
            return self
        if name not in self.sessions:
            known = ", ".join(self.sessions) or "no session, the file has none"
            raise CalibrationError(f"session '{name}' is unknown", where=f"calibration '{self.name}'", expected=known)
        session = self.sessions[name]
        sensors = [sensor.for_session(session) for sensor in self.sensors]
        return self.model_copy(update={"sensors": sensors, "sessions": {name: session}})


def calibration_from(content: Mapping[str, Any]) -> Calibration:
    """Validate the content of a calibration file against all installed sensor types.

    Raises:
        pydantic.ValidationError: The content does not fit; ``load_calibration`` turns it into one sentence.

    """
    types = tuple(sensor_types().values())
    union: Any = Annotated[Union[types], Field(discriminator="type")] if len(types) > 1 else types[0]  # noqa: UP007
    model = create_model(
        "Calibration",
        __base__=Calibration,
        sensors=(Annotated[list[union], Field(min_length=1)], ...),
    )
    return model.model_validate(content)
