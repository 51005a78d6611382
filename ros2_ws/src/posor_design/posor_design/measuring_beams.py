# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Measuring beams on their gimbals: natural frequencies and modes, sag, and error of the sag correction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor.chain.beam_bending import PointForce, on_gimbals
from posor.errors import ParameterError

from posor_design.beam_section import make_section
from posor_design.calculators import (
    MODES,
    MOST_MODES,
    NON_NEGATIVE,
    BeamDensity,
    BeamLength,
    BoxWidth,
    GimbalPlaces,
    GimbalStiffness,
    GimbalTurningStiffness,
    Height,
    Modulus,
    PlateInertias,
    PlateMasses,
    PoissonRatio,
    Shape,
    Wall,
    calculator,
)
from posor_design.timoshenko_beam import Attachment, BeamModel, make_beam

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


@dataclass(frozen=True)
class BeamFrequencies:
    """Natural frequencies and modes of a measuring beam in one plane."""

    frequencies: Annotated[tuple[float, ...], "Hz", "Natural frequencies, lowest first."]
    angular_frequencies: Annotated[tuple[float, ...], "rad/s", "The same, times 2 pi."]
    positions: Annotated[tuple[float, ...], "m", "Distances from the start of the beam at which the modes are given."]
    shapes: Annotated[tuple[tuple[float, ...], ...], "1", "Deflection of each mode at these positions, at most 1."]


@calculator
def beam_frequencies(
    shape: Shape,
    height: Height,
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: BeamDensity,
    gimbals: GimbalPlaces,
    plate_masses: PlateMasses = (0.0, 0.0),
    plate_inertias: PlateInertias = (0.0, 0.0),
    width: BoxWidth = 0.0,
    poisson_ratio: PoissonRatio = 0.33,
    gimbal_stiffness: GimbalStiffness = (),
    gimbal_turning_stiffness: GimbalTurningStiffness = (),
    modes: Annotated[int, MODES, "Number of modes."] = 4,
) -> BeamFrequencies:
    """Natural frequencies and mode shapes of a measuring beam on two gimbals with a plate at each end.

    The beam is a Timoshenko beam: it deforms in bending and in shear, and its sections have rotary inertia.

    Source: thesis 6.2.2 and appendix 6A; shear coefficient: Cowper, J. Applied Mechanics 33 (1966), 335-340.
    """
    beam = make_beam(shape, height, wall, width, length, modulus, density, poisson_ratio)
    plates = zip((0.0, length), plate_masses, plate_inertias, strict=True)
    attachments = _attachments(length, plates, gimbals, gimbal_stiffness, gimbal_turning_stiffness)
    model = BeamModel(beam, attachments, modes)
    angular, motions = model.modes(modes)
    shapes = motions[:, : len(model.positions)]
    largest = np.take_along_axis(shapes, np.argmax(np.abs(shapes), axis=1)[:, None], axis=1)
    return BeamFrequencies(
        frequencies=tuple((angular / (2.0 * math.pi)).tolist()),
        angular_frequencies=tuple(angular.tolist()),
        positions=tuple(model.positions.tolist()),
        shapes=tuple(map(tuple, (shapes / largest).tolist())),
    )


@dataclass(frozen=True)
class BeamSag:
    """Sag of a measuring beam under a uniform specific force, counted from the line through the gimbals."""

    start_deflection: Annotated[float, "m", "Deflection of the plate at the start, along the force."]
    start_slope: Annotated[float, "rad", "Slope of the plate at the start."]
    end_deflection: Annotated[float, "m", "Deflection of the plate at the end."]
    end_slope: Annotated[float, "rad", "Slope of the plate at the end."]
    relative_deflection: Annotated[float, "m", "Deflection of the end in the start's axes: correction of position."]
    relative_slope: Annotated[float, "rad", "Slope of the end in these axes: correction of the orientation."]


@calculator
def beam_sag(
    shape: Shape,
    height: Height,
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: BeamDensity,
    gimbals: GimbalPlaces,
    plate_masses: PlateMasses = (0.0, 0.0),
    width: BoxWidth = 0.0,
    specific_force: Annotated[float, "m/s^2", "Gravity less acceleration, across the beam."] = 9.80665,
) -> BeamSag:
    """Static sag of a measuring beam on two gimbals with a plate at each end.

    The correction that the chain of POSORs applies has the same formula. It leaves shear out.

    Source: thesis 6.2.1, equations 6.1 and 6.2.
    """
    section = make_section(shape, height, width, wall)
    _check_gimbals(length, gimbals)
    plates = [PointForce(at, mass * specific_force) for at, mass in zip((0.0, length), plate_masses, strict=True)]
    load = density * section.area * specific_force
    bent = on_gimbals(length, modulus * section.second_moment, load, plates, gimbals)
    start, end = bent.deflection(0.0), bent.deflection(length)
    start_slope, end_slope = bent.slope(0.0), bent.slope(length)
    return BeamSag(start, start_slope, end, end_slope, end - start - length * start_slope, end_slope - start_slope)


@dataclass(frozen=True)
class SagCorrection:
    """Static sag correction of a beam that vibrates, and its error; amplitudes."""

    deflection: Annotated[float, "m", "Correction of the position of the end, in the axes of the plate at the start."]
    deflection_error: Annotated[float, "m", "Error of this correction."]
    slope: Annotated[float, "rad", "Correction of the orientation of the end, in these axes."]
    slope_error: Annotated[float, "rad", "Error of this correction."]
    first_frequency: Annotated[float, "Hz", "Lowest natural frequency."]


@calculator
def sag_correction(
    shape: Shape,
    height: Height,
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: BeamDensity,
    gimbals: GimbalPlaces,
    acceleration: Annotated[float, "m/s^2", "Amplitude of the acceleration across the beam."],
    frequency: Annotated[float, "Hz", NON_NEGATIVE, "Frequency of the acceleration."],
    plate_masses: PlateMasses = (0.0, 0.0),
    plate_inertias: PlateInertias = (0.0, 0.0),
    width: BoxWidth = 0.0,
    poisson_ratio: PoissonRatio = 0.33,
    gimbal_stiffness: GimbalStiffness = (),
    gimbal_turning_stiffness: GimbalTurningStiffness = (),
    loss_factor: Annotated[float, "1", NON_NEGATIVE, "Structural damping: imaginary over real stiffness."] = 0.0,
) -> SagCorrection:
    """Error of the static sag correction of a measuring beam whose gimbals vibrate.

    Both gimbals move across the beam with one harmonic acceleration. The correction is the static sag under the
    acceleration of the moment; the beam follows as a Timoshenko beam. Well below the lowest natural frequency the
    relative error is the square of the ratio of the frequencies, plus the share of shear, which the correction leaves
    out. Without damping the error has no bound at a natural frequency. With a loss factor it has one, but the beam lags
    behind the force at every frequency, which adds an error of about this share of the sag.

    Source: thesis 6.2.1 and 6.2.2; structural damping: Meirovitch, Elements of Vibration Analysis (1975).
    """
    sag = beam_sag(shape, height, wall, length, modulus, density, gimbals, plate_masses, width, acceleration)
    beam = make_beam(shape, height, wall, width, length, modulus, density, poisson_ratio)
    plates = zip((0.0, length), plate_masses, plate_inertias, strict=True)
    attachments = _attachments(length, plates, gimbals, gimbal_stiffness, gimbal_turning_stiffness)
    angular = 2.0 * math.pi * frequency
    wave_number = math.sqrt(angular * math.sqrt(beam.mass / beam.bending_stiffness))
    half_waves = math.ceil(wave_number * length / math.pi)
    if half_waves > MOST_MODES:
        limit = (MOST_MODES * math.pi / length) ** 2 * math.sqrt(beam.bending_stiffness / beam.mass) / (2.0 * math.pi)
        raise ParameterError(f"{frequency:g} Hz", where="frequency", expected=f"at most {limit:.4g} Hz for this beam")
    model = BeamModel(beam, attachments, max(half_waves, 1))
    motion = acceleration * model.response(angular, loss_factor)
    deflections, slopes = np.split(motion, 2)
    start, end = model.node(0.0), model.node(length)
    slope = slopes[end] - slopes[start]
    deflection = deflections[end] - deflections[start] - length * slopes[start]
    return SagCorrection(
        deflection=abs(sag.relative_deflection),
        deflection_error=float(abs(deflection - sag.relative_deflection)),
        slope=abs(sag.relative_slope),
        slope_error=float(abs(slope - sag.relative_slope)),
        first_frequency=float(model.modes(1)[0][0]) / (2.0 * math.pi),
    )


def _check_gimbals(length: float, gimbals: tuple[float, float]) -> None:
    near, far = gimbals
    if not near < far <= length:
        expected = f"two increasing distances from 0 to {length:g} m"
        raise ParameterError(f"{near:g} m and {far:g} m", where="gimbals", expected=expected)


def _attachments(
    length: float,
    plates: Iterable[tuple[float, float, float]],
    gimbals: tuple[float, float],
    stiffness: Sequence[float],
    turning_stiffness: Sequence[float],
) -> list[Attachment]:
    """Return plates, each with place, mass and inertia, and gimbals."""
    _check_gimbals(length, gimbals)
    supports = zip(gimbals, stiffness or (math.inf, math.inf), turning_stiffness or (0.0, 0.0), strict=True)
    return [
        *(Attachment(at, mass=mass, inertia=inertia) for at, mass, inertia in plates),
        *(Attachment(at, stiffness=held, turning_stiffness=turn) for at, held, turn in supports),
    ]
