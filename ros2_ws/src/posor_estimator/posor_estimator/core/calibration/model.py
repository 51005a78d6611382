"""The calibration file of one POSOR, version 2.

Versions of the format:

1. First version: ``sensors`` by type, ``sessions``, ``tilt_angle``, ``motion``. Still read.
2. ``fits``: from which recording, how and how well the values were fitted, and their covariances.
"""

from __future__ import annotations

import hashlib
import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

from pydantic import Field, PrivateAttr, SerializeAsAny, create_model, field_validator, model_validator

from posor_estimator.core.calibration.choice import chosen_by
from posor_estimator.core.calibration.entry import EntryError
from posor_estimator.core.calibration.fit_record import FitRecord
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import Quantity, measured
from posor_estimator.core.calibration.session import Session
from posor_estimator.core.sensors.base import SensorCalibration
from posor_estimator.core.sensors.registry import sensor_types
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping

VERSION = 2
FORMER_VERSIONS = (1,)


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

    @model_validator(mode="after")
    def _two(self) -> Self:
        for name, frame in (("parent", self.parent), ("child", self.child)):
            if not frame.strip():
                raise EntryError(f"{name} is empty", key=(name,), expected="the name of a frame")
        if self.child == self.parent:
            raise EntryError(f"child '{self.child}' is the parent too", key=("child",), expected="two frames")
        return self


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
    version: Literal[1, 2]
    name: str
    provenance: Provenance
    frames: Frames
    tilt_angle: TiltAngle = TiltAngle.THIS_SCAN
    motion: Motion | None = None
    sensors: list[SerializeAsAny[SensorCalibration]]
    sessions: dict[str, Session] = Field(default_factory=dict)
    fits: list[FitRecord] = Field(default_factory=list)
    _session: str = PrivateAttr(default="")

    @field_validator("sessions")
    @classmethod
    def _named(cls, sessions: dict[str, Session]) -> dict[str, Session]:
        if "" in sessions:
            raise EntryError("a session has no name", expected="a name, by which it can be chosen")
        return sessions

    @model_validator(mode="after")
    def _of_its_version(self) -> Self:
        if self.fits and self.version == 1:
            raise EntryError("fits in a file of version 1", key=("fits",), expected="version 2")
        return self

    @property
    def content_hash(self) -> str:
        """SHA-256 of everything the file says, whatever its layout or comments; 64 hexadecimal digits.

        A file of version 1 has kept the hash that it had when that was the only version.
        """
        later = set() if self.fits else {"fits"}
        text = json.dumps(self.model_dump(mode="json", exclude=later), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def session(self) -> str:
        """Name of the session that has been applied; empty: none."""
        return self._session

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
        applied = self.model_copy(update={"sensors": sensors, "sessions": {name: session}})
        applied._session = name  # noqa: SLF001  a copy of the same class
        return applied


def calibration_from(content: Mapping[str, Any]) -> Calibration:
    """Validate the content of a calibration file against all installed sensor types.

    Raises:
        pydantic.ValidationError: The content does not fit; ``load_calibration`` turns it into one sentence.

    """
    types = sensor_types()
    union: Any = Annotated[Union[tuple(types.values())], chosen_by("type", types)]  # noqa: UP007
    model = create_model(
        "Calibration",
        __base__=Calibration,
        sensors=(Annotated[list[union], Field(min_length=1)], ...),
    )
    return model.model_validate(content)
