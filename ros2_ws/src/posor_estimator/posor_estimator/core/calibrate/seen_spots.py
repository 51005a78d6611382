"""Spots that diodes see while a stage carries the light or the diodes about: means over its stops, diode by diode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.channels import check_channels
from posor_estimator.core.calibrate.checks import check_axis, check_enough, check_unit
from posor_estimator.core.calibrate.joining import Stops, stops
from posor_estimator.core.calibrate.one_diode import OneDiode, diodes_that_see
from posor_estimator.core.calibrate.parameters import first_index
from posor_estimator.core.calibrate.procedure import Options
from posor_estimator.core.calibrate.recording import DIODES_ESTIMATED, SATURATED
from posor_estimator.core.calibrate.track import dwells

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.sensors.diodes import DiodesCalibration
    from posor_estimator.core.types import FloatArray

AXES = ("x", "y", "z")
LEAST_STOPS = 4


class StopOptions(Options):
    """Options of procedures that need a stage to stand still."""

    still: float = Field(default=5e-6, gt=0.0, description="the reference stands still within this [m, or rad / 2]")
    least_dwell: float = Field(default=0.2, ge=0.0, description="shorter stops are none [s]")
    settle: float = Field(default=0.0, ge=0.0, description="left out at the beginning of each stop [s]")


@dataclass(frozen=True)
class SeenSpots:
    """What each diode saw at the stops of a stage.

    Attributes:
        stops: Means over the stops, (d,).
        diodes: Those that saw a source at some stop.

    """

    stops: Stops
    diodes: list[OneDiode]

    def sigmas(self, diode: OneDiode) -> FloatArray:
        """Return the standard uncertainty of a diode's spots, its noise and the reference's together [m], (m, 2)."""
        counts = self.stops.counts[diode.seen]
        noise = diode.variances / counts[:, None]
        return np.asarray(np.sqrt(noise + np.square(self.stops.reference_sigmas[diode.seen, :2])))

    def residuals(
        self,
        predicted: Callable[[OneDiode], FloatArray],
    ) -> FloatArray:
        """Return the spots less those predicted, over their standard uncertainty, one diode after the other, (n,)."""
        return np.concatenate(
            [((diode.spots - predicted(diode)) / self.sigmas(diode)).ravel() for diode in self.diodes]
        )

    def derivatives(
        self, at: Callable[[OneDiode], tuple[FloatArray, FloatArray]], calibration: Calibration, sensor: int
    ) -> FloatArray:
        """Return d(residual)/d(parameter of the stack), (n, p).

        Args:
            at: Rotations (m, 3, 3) and translations [m] (m, 3) of T in R at the stops that a diode sees a source at.
            calibration: Of the POSOR.
            sensor: Which of its sensors the diodes are.

        """
        first = first_index(calibration, sensor)
        total = first_index(calibration, len(calibration.sensors))
        parts = []
        for diode in self.diodes:
            block = diode.derivatives(*at(diode)) / self.sigmas(diode)[:, :, None]
            part = np.zeros((block.shape[0] * 2, total))
            part[:, first : first + block.shape[2]] = block.reshape(-1, block.shape[2])
            parts.append(part)
        return np.concatenate(parts)

    def names(self) -> list[str]:
        """Return what to call each residual."""
        return [
            f"spot {axis} of {diode.name} at stop {stop + 1}"
            for diode in self.diodes
            for stop in np.flatnonzero(diode.seen)
            for axis in "xy"
        ]


def seen_spots(
    recording: Recording, part: DiodesCalibration, options: StopOptions, topic: str, columns: int, what: str
) -> SeenSpots:
    """Return the spots at the stops of a reference.

    Raises:
        TrackError: The reference does not serve.
        FitError: There are too few stops, or no diode sees anything.

    """
    recording = recording.without(DIODES_ESTIMATED | SATURATED)
    track = recording.track(topic, columns)
    found = dwells(track, options.still, round(options.least_dwell * 1e9), settle_ns=round(options.settle * 1e9))
    check_enough(len(found), LEAST_STOPS, "stops of the reference", f"{what}, {track.source}")
    check_channels(recording.scans, ("diode_currents",), recording.source)
    at_stops = stops(recording.scans, track, found, what=recording.source, judged=("diode_currents",))
    return SeenSpots(at_stops, diodes_that_see(part, at_stops.scans, what))


def check_motion(diode: OneDiode, moved: FloatArray, source: str) -> None:
    """Refuse a reference whose x and y move unlike the spots of a diode whose axes are those of the reference.

    Args:
        diode: The diode.
        moved: How the spots should have moved, by the reference, along the diode's axes and across [m], (m, 3).
        source: What to call the reference.

    Raises:
        TrackError: Its axes are swapped, or its unit is another.

    """
    for axis in range(2):
        if np.ptp(diode.spots[:, axis]) > 10.0 * float(np.sqrt(diode.variances[:, axis].max())):
            check_axis(diode.spots[:, axis], moved, axis, AXES, source)
            check_unit(diode.spots[:, axis], moved[:, axis], source, "m")


def turned_axis(axis: FloatArray, normal: FloatArray, angle: float) -> FloatArray:
    """Return a unit vector turned by an angle [rad] about a unit normal that is square to it, (3,)."""
    return np.asarray(np.cos(angle) * axis + np.sin(angle) * np.cross(normal, axis))


def components(name: str, vector: Sequence[float] | FloatArray) -> Mapping[str, float]:
    """Return a vector as parameters of a one-diode sensor: ``name[0,0]``, ``name[0,1]``, ..."""
    head, _, row = name.partition("#")
    return {f"{head}[{row or 0},{i}]": float(component) for i, component in enumerate(vector)}
