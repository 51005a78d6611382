"""What the gaps of the probes were while the reference stood still, by the reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.checks import check_alive, check_axis, check_enough, check_unit
from posor_estimator.core.calibrate.gap_polynomial import LEAST_STOPS, GapData
from posor_estimator.core.calibrate.joining import StopOptions, Stops, stops_of
from posor_estimator.core.calibrate.recording import (
    POINT,
    POSE,
    PROBES_ESTIMATED,
    SATURATED,
    SCALAR,
    Recording,
    poses_of,
)
from posor_estimator.core.forward import readings_at
from posor_estimator.core.stack import Stack

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.one_probe import OneProbe
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

AXES = ("x", "y", "z")
_KIND_OF = {"scalar": SCALAR, "point": POINT, "pose": POSE}


class GapReferenceOptions(StopOptions):
    """Options of a procedure whose reference measures gaps."""

    kind: Literal["scalar", "point", "pose"] = Field(
        default="scalar",
        description="what the reference measures: the travel of the target toward or away from all probes alike "
        "(scalar), a point that travels so along one axis (point), or the target's pose in the receiving frame (pose)",
    )
    axis: Literal["x", "y", "z"] = Field(default="z", description="of a point: the axis along which the gaps change")
    direction: Literal[1, -1] = Field(
        default=1, description="of scalar and point: 1 where the reference grows with the gaps, -1 where it falls"
    )
    uncalibrated: bool = Field(
        default=False,
        description="the probes have no calibration yet: do not compare the reference's unit and sign with it",
    )


def gap_stops(recording: Recording, options: GapReferenceOptions, where: str) -> Stops:
    """Return the stops of a recording, without scans whose probe voltages were filled in or saturated.

    Raises:
        FitError: There are too few.
        TrackError: The reference does not serve.

    """
    track = recording.track(options.reference, _KIND_OF[options.kind])
    found = stops_of(recording.without(PROBES_ESTIMATED | SATURATED), track, options)
    check_enough(len(found), LEAST_STOPS, "stops of the reference with scans", where)
    return found


def gap_data(
    probe: OneProbe, stops: Stops, calibration: Calibration, options: GapReferenceOptions, source: str
) -> GapData:
    """Return the data of one probe, after checking that reference and readings belong together.

    Args:
        probe: The probe.
        stops: The stops.
        calibration: Of the POSOR: where a pose is the reference, its geometry gives the gaps.
        options: How to take the reference.
        source: What to call the recording.

    Raises:
        FitError: The channel is stuck.
        TrackError: The reference is in another unit, has the other sign, or moves along another axis.

    """
    volts = probe.volts(stops.scans)
    spreads = stops.sigmas("gap_voltages")[:, probe.index]
    volt_sigmas = np.where(np.isfinite(spreads), spreads, probe.calibration.noise.number)
    check_alive((probe.name,), volts[:, None], spreads[:, None], stops.reference, source)
    if options.kind == "point":
        check_axis(volts, stops.reference, AXES.index(options.axis), AXES, source)
    gaps, sigmas = _reference(probe, stops, calibration, options)
    usable = probe.within(stops.scans)
    if not options.uncalibrated and np.count_nonzero(usable) > 1:
        present = probe.gaps(stops.scans.chosen(usable))
        check_unit(present, gaps[usable], f"{source}, reference of {probe.name}", "metres")
    return GapData(stops.scans, gaps, sigmas, volt_sigmas)


def _reference(
    probe: OneProbe, stops: Stops, calibration: Calibration, options: GapReferenceOptions
) -> tuple[FloatArray, FloatArray]:
    """Return the probe's gaps by the reference and their standard uncertainties [m], (d,) each."""
    if options.kind == "pose":
        stack = Stack([sensor.build() for sensor in calibration.sensors])
        column = stack.reading_names.index(f"gap {probe.calibration.name}")
        gaps = readings_at(stack, *poses_of(stops.reference))[:, column]
        # Across, the plane is nearly still: a gap is as uncertain as the pose is along Z.
        return gaps, stops.reference_sigmas[:, AXES.index("z")]
    column = AXES.index(options.axis) if options.kind == "point" else 0
    return options.direction * stops.reference[:, column], stops.reference_sigmas[:, column]
