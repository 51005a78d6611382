# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Models that give the simulator its truth: the estimator's own, or one of a package that shares no code with it.

A package registers a model with an entry point of the group ``posor_drivers.truths``, which is called with the path of
the arm file and returns a ``TrueArm``. The model reads the files of the arm itself.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Protocol, cast

from posor.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy as np
    import pinocchio as pin
    from numpy.typing import NDArray
    from posor.numerics.array_types import FloatArray

ENTRY_POINT_GROUP = "posor_drivers.truths"
SHARED = "shared"
"""The model of the estimator itself: an error of the model is in the readings too, and cancels."""


class TrueJoint(Protocol):
    """The sensors of one joint."""

    def readings(
        self,
        rotations: FloatArray,
        translations: FloatArray,
        supply_voltages: FloatArray | None = None,
        temperatures: FloatArray | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Return the raw readings and ``lit_sources``, by field of ``Scans``, at poses (n, 3, 3), (n, 3) [m].

        A reading beyond its calibrated range is NaN. ``supply_voltages`` [V], ``temperatures`` [K]: (n,), None: at the
        reference of each probe.
        """


class TrueLink(Protocol):
    """A link between two plates; the fields are those of ``arm_truth.TrueBeam``."""

    @property
    def before(self) -> pin.SE3:
        """From the first plate to the beam's start."""

    @property
    def end(self) -> pin.SE3:
        """From the beam's start to its end, without sag."""

    @property
    def after(self) -> pin.SE3:
        """From the beam's end to the next plate, or to the endpoint."""

    @property
    def start_gain(self) -> FloatArray:
        """Motion of the plate at the start per specific force, axes of the start, (6, 3)."""

    @property
    def end_gain(self) -> FloatArray:
        """The same of the plate at the end."""

    @property
    def first_frequency(self) -> float:
        """First natural frequency of the beam on its gimbals [Hz]."""

    def vibration_gains(self, frequencies: FloatArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the motions of the plates at start and end in steady vibration, (m, 6, 6) each, axes of the start.

        Columns: of a specific force of 1 m/s^2 along x, y, z, equal along the beam; then of a specific force that grows
        by 1 m/s^2 along the beam, from -0.5 m/s^2 at its start. Rows: translation [m], rotation vector [rad], from
        the gimbals. ``frequencies``: (m,) [Hz]. The beam has the damping of its ``vibration`` in the beams file.
        """

    def warm_ends(self, deviations: FloatArray, across: FloatArray, excess: float) -> tuple[FloatArray, FloatArray]:
        """Return the end without sag at n temperatures, in the start, (n, 3, 3), (n, 3) [m].

        ``deviations``: mean temperatures from that of the URDF [K], (n,); ``across``: differences between opposite
        sides in two directions across the beam [K], (2,); ``excess``: relative error of the coefficient of expansion.
        """


class TrueArm(Protocol):
    """Geometry and joints of an arm."""

    joints: tuple[str, ...]
    origins: tuple[pin.SE3, ...]  # of the joints, in their receiving plates
    gravity: FloatArray  # in the base [m/s^2], (3,)

    @property
    def links(self) -> Sequence[TrueLink]:
        """One more than joints, from the base."""

    def joint(self, name: str, errors: Mapping[str, float] | None = None) -> TrueJoint:
        """Return a joint whose parameters differ from its file by errors [SI], by names of ``Stack``."""


def load_truth(name: str, arm: Path, where: str) -> TrueArm | None:
    """Return the model of an arm file's arm; None for ``SHARED``. ``where`` is the place of the name in errors.

    Raises:
        CalibrationError: The name is unknown, the model cannot be loaded, or does not know a part of the arm.

    """
    if name == SHARED:
        return None
    entries = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if name not in entries:
        names = ", ".join(f"'{known}'" for known in (SHARED, *sorted(entries)))
        raise CalibrationError(f"truth '{name}' is unknown", where=where, expected=f"one of {names}")
    try:
        return cast("TrueArm", entries[name].load()(arm))
    except (ImportError, AttributeError, ValueError) as error:
        raise CalibrationError(f"truth '{name}': {error}", where=where) from error
