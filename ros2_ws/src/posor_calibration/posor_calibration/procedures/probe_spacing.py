# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Positions of the gap probes, from angles imposed on the target: spacings a, b and c (thesis 7.5.2).

The reference gives the angles. The height of the target at each dwell and the zero of each probe are free; all other
numbers of the calibration stay fixed, with their uncertainty. For three probes at (-c, 0), (0, a), (0, -b) the angle
about X determines a and b, the angle about Y determines c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.recording import POSE, unpack_poses
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError, TrackError
from posor.estimation.forward import readings_at
from posor.estimation.sensor_stack import Stack
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.gap_probes import GapProbesCalibration
from pydantic import Field
from scipy.spatial.transform import Rotation

from posor_calibration.calibration_parameters import FixedParameters, first_parameter, parameter_indices, replace_values
from posor_calibration.data_checks import PLAUSIBLE_RATIO, check_channels_move, check_count
from posor_calibration.dwells import DwellMeans, DwellOptions, average_recording
from posor_calibration.fit_report import describe_enlargement, describe_rejected, enlarge_if_improbable, result_tables
from posor_calibration.gap_probe_data import AXES, SingleProbe, list_probes
from posor_calibration.least_squares import Fit, Loss, fit_parameters
from posor_calibration.procedure import ANGLES, Figure, JointCovariance, Outcome, Procedure, Replacement

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray
    from posor.sensors.base import Sensor

NAME = "probe_spacing"
MIN_DWELLS = 5
SWAP_IMPROVEMENT = 3.0  # factor by which exchanged angles must reduce the residuals for the axes to be called swapped
WEAK_SHARE = 0.1  # a coordinate is not determined if its standard uncertainty exceeds this share of the coordinate
STEP = 1e-6  # of differences in pose [m, rad]


class ProbeSpacingOptions(DwellOptions):
    """Options of ``probe_spacing``."""

    coordinates: tuple[str, ...] = Field(
        default=(), description="fitted coordinates, such as gap_1.x; none: of each probe the larger one of x and y"
    )
    lift_sigma: float | None = Field(
        default=None, gt=0.0, description="standard uncertainty of the reference's height of the target [m]; none: free"
    )
    scale_sigma: float = Field(
        default=0.0, ge=0.0, description="relative standard uncertainty of the angles' scale, common to all dwells"
    )


def find_probe_spacing(recording: Recording, calibration: Calibration, options: ProbeSpacingOptions) -> Outcome:
    """Find the positions of the probes; raises as ``Procedure.identify``."""
    track = recording.find_track(options.reference, POSE)
    means = average_recording(recording.without_status(PROBES_ESTIMATED | SATURATED), track, options)
    check_count(len(means), MIN_DWELLS, "dwells of the reference with scans", NAME)
    probes = list_probes(calibration)
    volts = np.column_stack([probe.shifted_volts(means.scans) for probe in probes])
    names = [probe.name for probe in probes]
    check_channels_move(names, volts, means.sigmas("gap_voltages"), means.reference, recording.source)
    problem = _Problem(calibration, probes, means, options)
    problem.check_reference(track.source)
    outliers = problem.find_outliers()
    warnings = means.warnings + describe_rejected(outliers, [f"dwell {n + 1}" for n in range(len(means))], NAME)
    problem = replace(problem, means=means.select(~outliers))
    found = problem.fit("linear")
    warnings += describe_enlargement(found, NAME)
    found = enlarge_if_improbable(found)
    count = len(problem.names)
    values = found.values[:count]
    scale = options.scale_sigma**2 * np.outer(values, values)
    sigmas = np.sqrt(np.diag(found.covariance[:count, :count] + scale))
    joint = problem.fixed.joint_covariance(problem.entries, found)
    matrix = joint.matrix.copy()
    matrix[:count, :count] += scale
    return Outcome(
        method=f"imposed angles at {len(problem.means)} dwells, height "
        f"{'free' if options.lift_sigma is None else 'measured'}, zero of each probe free (thesis 7.5.2)",
        fits={NAME: found},
        replacements=problem.replacements(values, sigmas),
        covariances=(JointCovariance(joint.entries, matrix),),
        tables=result_tables("positions of the probes", found, problem.before, count),
        warnings=warnings,
        figures=(
            Figure(
                "residuals of the probe spacing",
                "reading",
                "residual / standard uncertainty",
                {"readings": (np.arange(1.0, len(found.residuals) + 1.0), found.residuals)},
            ),
        ),
    )


@dataclass(frozen=True)
class _Problem:
    """The readings of the gap probes at poses whose height is free."""

    calibration: Calibration
    probes: list[SingleProbe]
    means: DwellMeans
    options: ProbeSpacingOptions

    @cached_property
    def names(self) -> list[str]:
        """The fitted coordinates, such as ``gap_1.x``."""
        return list(self.options.coordinates) or [
            f"{p.calibration.name}.{AXES[int(np.argmax(np.abs(p.calibration.tip.array[:2])))]}" for p in self.probes
        ]

    @cached_property
    def places(self) -> list[tuple[int, int]]:
        """Probe and axis of each coordinate."""
        known = [probe.calibration.name for probe in self.probes]
        places = []
        for name in self.names:
            probe, _, axis = name.rpartition(".")
            if probe not in known or axis not in AXES[:2]:
                raise FitError(
                    f"coordinate '{name}'", where=NAME, expected=f"one of {', '.join(known)} with .x or .y after it"
                )
            places.append((known.index(probe), AXES.index(axis)))
        return places

    @property
    def before(self) -> FloatArray:
        """The coordinates as calibrated [m]."""
        return np.array([self.probes[probe].calibration.tip.array[axis] for probe, axis in self.places])

    @property
    def entries(self) -> tuple[str, ...]:
        """The coordinates in the calibration file."""
        return tuple(f"{self.probes[probe].key}.tip[{axis}]" for probe, axis in self.places)

    @cached_property
    def where(self) -> IntArray:
        """The coordinates in the stack's parameter vector, (k,)."""
        sensor, _ = find_sensor(self.calibration, GapProbesCalibration, NAME)
        return parameter_indices(self.calibration, sensor, [f"tips[{probe},{axis}]" for probe, axis in self.places])

    @cached_property
    def fixed(self) -> FixedParameters:
        """All parameters but the coordinates."""
        return FixedParameters(self.calibration, self.where)

    def replacements(self, values: FloatArray, sigmas: FloatArray) -> tuple[Replacement, ...]:
        """Return the changes to the file for fitted coordinates [m], (k,)."""
        found = []
        for index in sorted({probe for probe, _ in self.places}):
            probe = self.probes[index]
            tip, tip_sigmas = probe.calibration.tip.array.copy(), probe.calibration.tip.sigmas.copy()
            for column, (own, axis) in enumerate(self.places):
                if own == index:
                    tip[axis], tip_sigmas[axis] = values[column], sigmas[column]
            found.append(Replacement(f"{probe.key}.tip", tip.tolist(), tip_sigmas.tolist()))
        return tuple(found)

    def check_reference(self, source: str) -> None:
        """Refuse angles that determine too little, have another size or sign, or X and Y exchanged."""
        found = self.fit("linear")
        if found.is_too_large and self._fit_swapped().spread * SWAP_IMPROVEMENT < found.spread:
            raise TrackError(
                "the readings fit the angles with X and Y exchanged; the axes look swapped",
                where=source,
                expected="the target's orientation in the receiving frame",
            )
        for name, before, sigma in zip(self.names, self.before, found.sigmas, strict=False):
            if sigma > WEAK_SHARE * abs(before):
                raise FitError(
                    f"the angles hardly determine {name}, its standard uncertainty would be {sigma:.2g} m",
                    where=NAME,
                    expected="angles about both X and Y, or fewer coordinates",
                )
        ratio = float(np.median(found.values[: len(self.names)] / self.before))
        if not PLAUSIBLE_RATIO[0] <= ratio <= PLAUSIBLE_RATIO[1]:
            raise FitError(
                f"the fitted spacing is {ratio:.3g} times as large as calibrated",
                where=f"{NAME}, {source}",
                expected="angles of the target in the receiving frame, of the right size and sign",
            )

    def _fit_swapped(self) -> Fit:
        order = [1, 0, 2, 4, 3, 5, 6]
        reference, sigmas = self.means.reference[:, order], self.means.reference_sigmas[:, order]
        return replace(self, means=replace(self.means, reference=reference, reference_sigmas=sigmas)).fit("linear")

    def find_outliers(self) -> BoolArray:
        """Return which dwells have a reading that does not fit the others, (d,)."""
        outliers = self.fit("cauchy", self.fit("soft_l1").values).outliers()
        return np.asarray(outliers.reshape(len(self.means), -1).any(axis=1))

    def fit(self, loss: Loss, start: FloatArray | None = None) -> Fit:
        """Fit the coordinates, and the zeros of all probes but the first [m]."""
        at, calibration = find_sensor(self.calibration, GapProbesCalibration, NAME)
        stack = Stack([calibration.build()])
        where, count = self.where - first_parameter(self.calibration, at), len(self.where)
        rotations, translations = unpack_poses(self.means.reference)
        measured = np.column_stack([probe.gaps(self.means.scans) for probe in self.probes])
        whiten = self._whiten(stack, rotations, translations)

        def residuals(values: FloatArray) -> FloatArray:
            moved = stack.with_parameter_values(replace_values(stack.parameter_values, where, values[:count]))
            predicted = readings_at(moved, rotations, translations)
            predicted[:, 1:] += values[count:]
            return np.asarray(np.einsum("nij,nj->ni", whiten, measured - predicted).ravel())

        zeros = [f"zero of {probe.calibration.name}" for probe in self.probes[1:]]
        return fit_parameters(
            residuals,
            np.concatenate([self.before, np.zeros(len(zeros))]) if start is None else start,
            [*self.names, *zeros],
            ["m"] * (count + len(zeros)),
            np.concatenate([np.full(count, 1e-3), np.full(len(zeros), 1e-4)]),
            fixed_effects=self.fixed.effects(self._derivatives(stack.sensors[0], whiten, rotations, translations)),
            loss=loss,
            what=NAME,
        )

    def _derivatives(
        self, sensor: Sensor, whiten: FloatArray, rotations: FloatArray, translations: FloatArray
    ) -> FloatArray:
        """Return d(residual)/d(parameter of the calibration), (n, p); the columns of other sensors are zero."""
        at, _ = find_sensor(self.calibration, GapProbesCalibration, NAME)
        first, size = (first_parameter(self.calibration, number) for number in (at, len(self.calibration.sensors)))
        out = np.zeros((*whiten.shape[:2], size))
        for n, whitening in enumerate(whiten):
            block = sensor.residual_jacobian(self.means.scans[n], rotations[n], translations[n])
            out[n, :, first : first + block.shape[1]] = whitening @ block
        return out.reshape(-1, size)

    def _whiten(self, stack: Stack, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return matrices that make the c readings of a dwell independent, of variance 1, (d, c or c - 1, c).

        An error of the angles moves all readings of a dwell together, and so does the height. A free height takes one
        residual of each dwell: the combinations of the readings that the height does not move remain.
        """
        slopes = np.column_stack([probe.slopes(self.means.scans) for probe in self.probes])
        spreads = self.means.sigmas("gap_voltages")
        noises = np.array([probe.calibration.noise.number for probe in self.probes])
        noise = slopes * np.where(spreads > 0.0, spreads, noises / np.sqrt(self.means.counts)[:, None])

        def difference(turn: FloatArray, lift: float) -> FloatArray:
            shift = np.array([0.0, 0.0, lift])
            ahead = readings_at(stack, turn @ rotations, translations + shift)
            back = readings_at(stack, turn.T @ rotations, translations - shift)
            return np.asarray((ahead - back) / (2.0 * STEP))

        # The vector part of a quaternion is half the angle.
        angles = 2.0 * self.means.reference_sigmas[:, 3:5]
        shared = [
            difference(Rotation.from_rotvec(STEP * np.eye(3)[axis]).as_matrix(), 0.0) * angles[:, [axis]]
            for axis in range(2)
        ]
        by_height = difference(np.eye(3), STEP)
        if self.options.lift_sigma is not None:
            shared.append(by_height * self.options.lift_sigma)
        roots = np.stack(shared, axis=2)
        covariances = roots @ roots.transpose(0, 2, 1) + noise[:, :, None] ** 2 * np.eye(len(self.probes))
        whiten = np.linalg.inv(np.linalg.cholesky(covariances))
        if self.options.lift_sigma is not None:
            return np.asarray(whiten)
        across = np.linalg.svd(np.einsum("nij,nj->ni", whiten, by_height)[:, :, None])[0][:, :, 1:]
        return np.asarray(across.transpose(0, 2, 1) @ whiten)


PROCEDURE = Procedure(
    NAME,
    "positions of the gap probes (a, b, c), from angles imposed on the target",
    ProbeSpacingOptions,
    find_probe_spacing,
    drift_of=("z", *ANGLES[:2]),
)
