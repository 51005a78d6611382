"""Measuring beams on their gimbals: natural frequencies and modes, sag, and error of the sag correction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from posor.chain.beam_bending import PointForce, on_gimbals
from posor.errors import ParameterError

from posor_design.beam_arguments import (
    MOST_MODES,
    check_modes,
    check_plates_and_gimbals,
    make_attachments,
    make_beam,
)
from posor_design.beam_section import make_section
from posor_design.beam_vibration import BeamModel
from posor_design.checks import require_finite, require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
        Hertz,
        Kilogram,
        KilogramPerCubicMetre,
        KilogramSquareMetre,
        Metre,
        MetrePerSecondSquared,
        NewtonMetrePerRadian,
        NewtonPerMetre,
        Number,
        Pascal,
        Radian,
        RadianPerSecond,
    )


@dataclass(frozen=True)
class BeamFrequencies:
    """Natural frequencies and modes of a measuring beam in one plane.

    Attributes:
        frequencies: Natural frequencies, lowest first.
        angular_frequencies: The same, times 2 pi.
        positions: Distances from the start of the beam at which the modes are given.
        shapes: Deflection of each mode at these positions; the largest is 1.

    """

    frequencies: tuple[Hertz, ...]
    angular_frequencies: tuple[RadianPerSecond, ...]
    positions: tuple[Metre, ...]
    shapes: tuple[tuple[Number, ...], ...]


def beam_frequencies(
    shape: Literal["tube", "box"],
    height: Metre,
    wall: Metre,
    length: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    gimbals: tuple[Metre, Metre],
    plate_masses: tuple[Kilogram, Kilogram] = (0.0, 0.0),
    plate_inertias: tuple[KilogramSquareMetre, KilogramSquareMetre] = (0.0, 0.0),
    width: Metre = 0.0,
    poisson_ratio: Number = 0.33,
    gimbal_stiffness: tuple[NewtonPerMetre, ...] = (),
    gimbal_turning_stiffness: tuple[NewtonMetrePerRadian, ...] = (),
    modes: int = 4,
) -> BeamFrequencies:
    """Natural frequencies and mode shapes of a measuring beam on two gimbals with a plate at each end.

    The beam is a Timoshenko beam: it deforms in bending and in shear, and its sections have rotary inertia.

    Args:
        shape: Section of the beam.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        wall: Thickness of the walls.
        length: Length of the beam.
        modulus: Young's modulus.
        density: Density of the beam.
        gimbals: Distances of the two gimbals from the start of the beam, the nearer first.
        plate_masses: Masses at start and end of the beam.
        plate_inertias: Moments of inertia of these masses about the axis across the plane of bending.
        width: Outer width of a box.
        poisson_ratio: Poisson's ratio.
        gimbal_stiffness: Stiffness of each gimbal against deflection; left out: rigid.
        gimbal_turning_stiffness: Stiffness of each gimbal against turning; left out: the gimbals turn freely.
        modes: Number of modes.

    Raises:
        ParameterError: An argument is not finite or out of its range, a gimbal is beyond the ends of the beam, or a
            stiffness is stated for one gimbal only.

    Source: thesis 6.2.2 and appendix 6A; shear coefficient: Cowper, J. Applied Mechanics 33 (1966), 335-340.

    Example:
        posor design beam-frequencies --shape tube --height '2 in' --wall '.125 in' --length '30 in'
        --modulus '10.6e6 psi' --density '.1 lb/in^3' --gimbals '6, 24 in' --plate-masses '3.927, 3.927 lb'
        --plate-inertias '.00724, .00724 kg m^2'

    """
    check_modes(modes)
    beam = make_beam(shape, height, wall, width, length, modulus, density, poisson_ratio)
    attachments = make_attachments(
        length, gimbals, plate_masses, plate_inertias, gimbal_stiffness, gimbal_turning_stiffness
    )
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
    """Sag of a measuring beam under a uniform specific force, counted from the line through the gimbals.

    Attributes:
        start_deflection: Deflection of the plate at the start, along the force.
        start_slope: Slope of the plate at the start.
        end_deflection: Deflection of the plate at the end.
        end_slope: Slope of the plate at the end.
        relative_deflection: Deflection of the end in the axes of the plate at the start: correction of the position.
        relative_slope: Slope of the end in these axes: correction of the orientation.

    """

    start_deflection: Metre
    start_slope: Radian
    end_deflection: Metre
    end_slope: Radian
    relative_deflection: Metre
    relative_slope: Radian


def beam_sag(
    shape: Literal["tube", "box"],
    height: Metre,
    wall: Metre,
    length: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    gimbals: tuple[Metre, Metre],
    plate_masses: tuple[Kilogram, Kilogram] = (0.0, 0.0),
    width: Metre = 0.0,
    specific_force: MetrePerSecondSquared = 9.80665,
) -> BeamSag:
    """Static sag of a measuring beam on two gimbals with a plate at each end.

    The correction that the chain of POSORs applies has the same formula. It leaves shear out.

    Args:
        shape: Section of the beam.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        wall: Thickness of the walls.
        length: Length of the beam.
        modulus: Young's modulus.
        density: Density of the beam.
        gimbals: Distances of the two gimbals from the start of the beam, the nearer first.
        plate_masses: Masses at start and end of the beam.
        width: Outer width of a box.
        specific_force: Gravity less acceleration, across the beam.

    Raises:
        ParameterError: An argument is not finite or out of its range, or a gimbal is beyond the ends of the beam.

    Source: thesis 6.2.1, equations 6.1 and 6.2.

    Example:
        posor design beam-sag --shape tube --height '2 in' --wall '.125 in' --length '30 in' --modulus '10.6e6 psi'
        --density '.1 lb/in^3' --gimbals '6, 24 in' --plate-masses '3.927, 3.927 lb'

    """
    require_finite(specific_force=specific_force)
    require_positive(length=length, modulus=modulus, density=density)
    section = make_section(shape, height, width, wall)
    check_plates_and_gimbals(length, gimbals, plate_masses)
    plates = [PointForce(at, mass * specific_force) for at, mass in zip((0.0, length), plate_masses, strict=True)]
    load = density * section.area * specific_force
    bent = on_gimbals(length, modulus * section.second_moment, load, plates, gimbals)
    start, end = bent.deflection(0.0), bent.deflection(length)
    start_slope, end_slope = bent.slope(0.0), bent.slope(length)
    return BeamSag(start, start_slope, end, end_slope, end - start - length * start_slope, end_slope - start_slope)


@dataclass(frozen=True)
class SagCorrection:
    """Static sag correction of a beam that vibrates, and its error; amplitudes.

    Attributes:
        deflection: Correction of the position of the end, in the axes of the plate at the start.
        deflection_error: Error of this correction.
        slope: Correction of the orientation of the end, in these axes.
        slope_error: Error of this correction.
        first_frequency: Lowest natural frequency.

    """

    deflection: Metre
    deflection_error: Metre
    slope: Radian
    slope_error: Radian
    first_frequency: Hertz


def sag_correction(
    shape: Literal["tube", "box"],
    height: Metre,
    wall: Metre,
    length: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    gimbals: tuple[Metre, Metre],
    acceleration: MetrePerSecondSquared,
    frequency: Hertz,
    plate_masses: tuple[Kilogram, Kilogram] = (0.0, 0.0),
    plate_inertias: tuple[KilogramSquareMetre, KilogramSquareMetre] = (0.0, 0.0),
    width: Metre = 0.0,
    poisson_ratio: Number = 0.33,
    gimbal_stiffness: tuple[NewtonPerMetre, ...] = (),
    gimbal_turning_stiffness: tuple[NewtonMetrePerRadian, ...] = (),
    loss_factor: Number = 0.0,
) -> SagCorrection:
    """Error of the static sag correction of a measuring beam whose gimbals vibrate.

    Both gimbals move across the beam with one harmonic acceleration. The correction is the static sag under the
    acceleration of the moment; the beam follows as a Timoshenko beam. Well below the lowest natural frequency the
    relative error is the square of the ratio of the frequencies, plus the share of shear, which the correction leaves
    out. Without damping the error has no bound at a natural frequency. With a loss factor it has one, but the beam lags
    behind the force at every frequency, which adds an error of about this share of the sag.

    Args:
        shape: Section of the beam.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        wall: Thickness of the walls.
        length: Length of the beam.
        modulus: Young's modulus.
        density: Density of the beam.
        gimbals: Distances of the two gimbals from the start of the beam, the nearer first.
        plate_masses: Masses at start and end of the beam.
        acceleration: Amplitude of the acceleration across the beam.
        frequency: Frequency of the acceleration.
        plate_inertias: Moments of inertia of the masses about the axis across the plane of bending.
        width: Outer width of a box.
        poisson_ratio: Poisson's ratio.
        gimbal_stiffness: Stiffness of each gimbal against deflection; left out: rigid.
        gimbal_turning_stiffness: Stiffness of each gimbal against turning; left out: the gimbals turn freely.
        loss_factor: Structural damping: imaginary over real part of the stiffness.

    Raises:
        ParameterError: An argument is not finite or out of its range, a gimbal is beyond the ends of the beam, or a
            stiffness is stated for one gimbal only.

    Source: thesis 6.2.1 and 6.2.2; structural damping: Meirovitch, Elements of Vibration Analysis (1975).

    Example:
        posor design sag-correction --shape tube --height '2 in' --wall '.125 in' --length '30 in'
        --modulus '10.6e6 psi' --density '.1 lb/in^3' --gimbals '6, 24 in' --plate-masses '3.927, 3.927 lb'
        --plate-inertias '.00724, .00724 kg m^2' --acceleration '1 m/s^2' --frequency '20 Hz'

    """
    require_finite(acceleration=acceleration)
    require_non_negative(frequency=frequency, loss_factor=loss_factor)
    sag = beam_sag(shape, height, wall, length, modulus, density, gimbals, plate_masses, width, acceleration)
    beam = make_beam(shape, height, wall, width, length, modulus, density, poisson_ratio)
    attachments = make_attachments(
        length, gimbals, plate_masses, plate_inertias, gimbal_stiffness, gimbal_turning_stiffness
    )
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
