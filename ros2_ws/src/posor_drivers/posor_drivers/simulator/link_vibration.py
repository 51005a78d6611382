# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Vibration of a simulated arm: links that oscillate, measuring beams that follow, and their accelerometers.

A link oscillates in its first bending mode, as a cantilever with a mass at its end: the end of the link moves across by
the amplitude and turns by 3/2 of the amplitude over the length. The gimbals of the beam on the link move along. The
beam follows their acceleration as it does in steady vibration at each frequency of its Fourier series, so the motion
repeats with the cycle; the gains of each frequency are those of the model of the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.errors import CalibrationError

from posor_drivers.simulator.imperfections import RandomStream
from posor_drivers.simulator.mechanics import LinkBend

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.pose_array import PoseArray
    from posor_drivers.simulator.scenario import LinkVibration
    from posor_drivers.simulator.truth_model import TrueLink

SLOPE = 1.5  # turn of the end of a cantilever with a force at its end, over its deflection and times its length
SMALLEST = 1e-9  # part of a direction across the link below which there is no direction


def vibrating_links(
    bends: Sequence[LinkBend], spans: Sequence[FloatArray], vibrations: Sequence[LinkVibration | None], rate: int
) -> list[LinkBend]:
    """Return the bends of the links at n ticks of a rate [Hz] with their vibration.

    ``spans``: ends of the links in their starts [m]. Raises CalibrationError: a link has no length, or vibrates along.
    """
    found = []
    for bend, span, vibration in zip(bends, spans, vibrations, strict=True):
        if vibration is None:
            found.append(bend)
            continue
        length = float(np.linalg.norm(span))
        along = span / length if length else np.zeros(3)
        across = vibration.direction.array - along * (along @ vibration.direction.array)
        if not length or np.linalg.norm(across) < SMALLEST:
            raise CalibrationError(
                "a link without length, or a direction along the link",
                where="key vibrations of the scenario",
                expected="a link that can bend, and a direction across",
            )
        across /= np.linalg.norm(across)
        moved = vibration.displacements(np.arange(len(bend.translations)) / rate)[:, None]
        turn = SLOPE / length * np.cross(along, across)
        found.append(LinkBend(bend.translations + moved * across, bend.rotations + moved * turn))
    return found


@dataclass(frozen=True)
class DrivenBeam:
    """What vibration does to one beam at n ticks, axes of its start."""

    start_motion: FloatArray  # of the plate at the start beside the sag at rest: translation [m], turn [rad], (n, 6)
    end_motion: FloatArray  # of the plate at the end
    accelerations: FloatArray  # of both gimbals by the vibration [m/s^2], (n, 2, 3)


def drive_beam(
    beam: MeasuringBeam, link: SharedBeam | TrueLink, starts: PoseArray, still: PoseArray, rate: int, pace: float
) -> DrivenBeam:
    """Return what vibration does to a beam with ``vibration`` and ``sag``.

    ``link``: model of the truth with ``vibration_gains``; ``starts``, ``still``: start of the beam with and without
    vibration, both in the base, at n ticks of a rate [Hz]; ``pace``: its natural frequency over that of ``link``.
    """
    sag, span = beam.entry.sag, beam.T_start_end.translation
    length, count = float(np.linalg.norm(span)), len(starts)
    near, far = np.zeros(2) if sag is None else sag.gimbals.array
    frequencies = np.arange(count // 2 + 1) * rate / count  # of the real Fourier series
    spectra = []
    for at in (near, far):
        place = pin.SE3(np.eye(3), at / length * span)
        moved = (starts @ place).translations - (still @ place).translations
        spectrum = -((2.0 * np.pi * frequencies[:, None]) ** 2) * np.fft.rfft(moved, axis=0)
        spectra.append(still.rotate_back(np.fft.irfft(spectrum, count, axis=0)))
    share = (0.5 * length - near) / (far - near)
    mean = (1.0 - share) * spectra[0] + share * spectra[1]
    difference = (spectra[1] - spectra[0]) * length / (far - near)
    field = np.fft.rfft(np.hstack([-mean, -difference]), axis=0)
    gains = link.vibration_gains(frequencies / pace)
    start, end = (np.fft.irfft(np.einsum("fij,fj->fi", gain, field), count, axis=0) for gain in gains)
    return DrivenBeam(start, end, np.stack(spectra, axis=1))


class SharedBeam:
    """A beam as the estimator's own model describes it."""

    def __init__(self, beam: MeasuringBeam) -> None:
        """Take a beam with ``vibration``."""
        self._beam = beam

    @property
    def first_frequency(self) -> float:
        """First natural frequency [Hz]."""
        entry = self._beam.entry.vibration
        return math.inf if entry is None else entry.frequency.number

    def vibration_gains(self, frequencies: FloatArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the motions of the plates in steady vibration, as ``TrueLink.vibration_gains``."""
        beam, entry = self._beam, self._beam.entry.vibration
        ratio = frequencies / self.first_frequency
        damping = 0.0 if entry is None else entry.damping.number
        response = np.asarray(1.0 / (1.0 - ratio**2 + 2j * damping * ratio), dtype=np.complex128)
        start = response[:, None, None] * np.hstack([beam.start_gain, beam.start_tilt_gain])
        return start, response[:, None, None] * np.hstack([beam.end_gain, beam.end_tilt_gain])


class BeamAccelerometers:
    """The accelerometers of the beams of an arm, with errors drawn once, and noise."""

    def __init__(self, beams: Sequence[MeasuringBeam], specific_forces: Mapping[str, FloatArray], seed: int) -> None:
        """``specific_forces``: of both gimbals of each beam at the ticks of a cycle, (n, 2, 3) [m/s^2]."""
        self._forces = specific_forces
        self._entries = {
            beam.name: beam.entry.vibration.accelerometers for beam in beams if beam.entry.vibration is not None
        }
        names = [name for entry in self._entries.values() for name in entry.names]
        self._biases = {name: RandomStream(seed, "accelerometer", name).generator().normal(size=3) for name in names}
        self._noise = {name: RandomStream(seed, "accelerometer noise", name) for name in names}

    def readings(self, tick: int) -> dict[str, FloatArray]:
        """Return what each accelerometer reads at a tick, by name, (3,) [m/s^2]: half its variance is noise."""
        found = {}
        for beam, entry in self._entries.items():
            forces, sigma = self._forces[beam], entry.uncertainty.number / 2.0**0.5
            for i, name in enumerate(entry.names):
                noise = self._noise[name].generator(tick).normal(size=3)
                found[name] = -forces[tick % len(forces), i] + sigma * (self._biases[name] + noise)
        return found
