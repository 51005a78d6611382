"""Where the gap probes sit, from angles imposed on the target: spacings a, b and c (thesis 7.5.2).

The reference gives the angles; how high the target stands at each stop need not be known well, nor what each probe
reads at zero. What else the calibration says of the probes is taken as it is, with its uncertainty. Three probes at
(-c, 0), (0, a), (0, -b) then tell a and b by the angle about X, c by that about Y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from posor_estimator.core.calibrate.checks import (
    IMPROBABLE,
    PLAUSIBLE,
    check_alive,
    check_enough,
    misfit_sentences,
    outlier_sentences,
)
from posor_estimator.core.calibrate.fit import Loss, fit
from posor_estimator.core.calibrate.joining import StopOptions, stops_of
from posor_estimator.core.calibrate.one_probe import OneProbe
from posor_estimator.core.calibrate.parameters import changed, first_index, indices, the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Outcome, Procedure
from posor_estimator.core.calibrate.recording import POSE, PROBES_ESTIMATED, SATURATED, poses_of
from posor_estimator.core.calibrate.replacement import JointCovariance, Replacement
from posor_estimator.core.calibrate.reporting import correlation_table, parameter_table
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.forward import readings_at
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.joining import Stops
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

NAME = "probe_spacing"
AXES = ("x", "y", "z")
MICRO = 1e6
LEAST_STOPS = 5
MUCH_BETTER = 3.0
"""So many times smaller must the residuals be with the angles exchanged for the axes to be called swapped."""
HARDLY = 0.1
"""A coordinate whose standard uncertainty is this part of itself is not told."""
STEP = 1e-6
"""Of differences in pose [m, rad]."""


class ProbeSpacingOptions(StopOptions):
    """Options of the spacing of gap probes."""

    coordinates: tuple[str, ...] = Field(
        default=(),
        description="what is fitted, such as gap_1.x; none: of each probe the coordinate that is larger, x or y",
    )
    lift_sigma: float | None = Field(
        default=None, gt=0.0, description="standard uncertainty of the reference's height of the target [m]; none: free"
    )
    scale_sigma: float = Field(
        default=0.0, ge=0.0, description="relative standard uncertainty of the angles' scale, common to all stops"
    )


def run(recording: Recording, calibration: Calibration, options: ProbeSpacingOptions) -> Outcome:
    """Fit where the probes sit.

    Raises:
        FitError: Too few stops, a stuck channel, angles that do not tell the spacing, an implausible result.
        TrackError: The reference does not serve, or its axes are swapped.

    """
    track = recording.track(options.reference, POSE)
    stops = stops_of(recording.without(PROBES_ESTIMATED | SATURATED), track, options)
    check_enough(len(stops), LEAST_STOPS, "stops of the reference with scans", NAME)
    probes = OneProbe.all_of(calibration)
    volts = np.column_stack([probe.volts(stops.scans) for probe in probes])
    check_alive(
        [probe.name for probe in probes], volts, stops.sigmas("gap_voltages"), stops.reference, recording.source
    )
    problem = _Problem(calibration, probes, stops, options)
    problem.check_reference(track.source)
    outliers = problem.stops_that_do_not_fit()
    warnings = stops.warnings + outlier_sentences(outliers, [f"stop {n + 1}" for n in range(len(stops))], NAME)
    problem = problem.without(outliers)
    found = problem.fitted("linear")
    warnings += misfit_sentences(found, NAME)
    if found.probability < IMPROBABLE:
        found = problem.fitted("linear", trust_sigmas=False)
    count = len(problem.names)
    values, before = found.values[:count], problem.before
    scale = options.scale_sigma**2 * np.outer(values, values)
    covariance = found.covariance[:count, :count] + scale
    joint = problem.taken().joint(tuple(problem.entries), found)
    matrix = joint.matrix.copy()
    matrix[:count, :count] += scale
    return Outcome(
        method=f"imposed angles at {len(problem.stops)} stops, height "
        f"{'free' if options.lift_sigma is None else 'measured'}, zero of each probe free (thesis 7.5.2)",
        fits={NAME: found},
        replacements=tuple(_replacement(problem, probe, values, covariance) for probe in problem.probes_moved()),
        covariances=(JointCovariance(joint.entries, matrix),),
        tables=(
            parameter_table("where the probes sit", found, before, count),
            correlation_table(found, count),
        ),
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
    probes: list[OneProbe]
    stops: Stops
    options: ProbeSpacingOptions

    @property
    def names(self) -> list[str]:
        """Return the coordinates to be fitted, such as ``gap_1.x``."""
        if self.options.coordinates:
            return list(self.options.coordinates)
        return [
            f"{p.calibration.name}.{AXES[int(np.argmax(np.abs(p.calibration.tip.array[:2])))]}" for p in self.probes
        ]

    def _places(self) -> list[tuple[int, int]]:
        """Return probe and axis of each coordinate."""
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
        """Return the coordinates as calibrated [m]."""
        return np.array([self.probes[probe].calibration.tip.array[axis] for probe, axis in self._places()])

    @property
    def entries(self) -> list[str]:
        """Return where the coordinates stand in the file."""
        return [f"{self.probes[probe].key}.tip[{axis}]" for probe, axis in self._places()]

    def probes_moved(self) -> list[int]:
        """Return the probes of which a coordinate is fitted."""
        return sorted({probe for probe, _ in self._places()})

    def column(self, probe: int, axis: int) -> int | None:
        """Return which of the fitted coordinates this is."""
        places = self._places()
        return places.index((probe, axis)) if (probe, axis) in places else None

    def without(self, outliers: BoolArray) -> _Problem:
        return replace(self, stops=self.stops.chosen(~outliers))

    def swapped(self) -> _Problem:
        """Return the problem with X and Y of the reference exchanged."""
        order = [1, 0, 2, 4, 3, 5, 6]
        reference, sigmas = self.stops.reference[:, order], self.stops.reference_sigmas[:, order]
        return replace(self, stops=replace(self.stops, reference=reference, reference_sigmas=sigmas))

    def check_reference(self, source: str) -> None:
        """Refuse angles that tell too little, of another size or sign, or with X and Y exchanged."""
        found = self.fitted("linear")
        if found.probability < IMPROBABLE and self.swapped().fitted("linear").spread * MUCH_BETTER < found.spread:
            raise TrackError(
                "the readings fit the angles with X and Y exchanged; the axes look swapped",
                where=source,
                expected="the target's orientation in the receiving frame",
            )
        for name, before, sigma in zip(self.names, self.before, found.sigmas, strict=False):
            if sigma > HARDLY * abs(before):
                raise FitError(
                    f"the angles hardly tell {name}, its standard uncertainty would be {sigma:.2g} m",
                    where=NAME,
                    expected="angles about both X and Y, or fewer coordinates",
                )
        ratio = float(np.median(found.values[: len(self.names)] / self.before))
        if not PLAUSIBLE[0] <= ratio <= PLAUSIBLE[1]:
            raise FitError(
                f"the spacing comes out {ratio:.3g} times as large as it is calibrated",
                where=f"{NAME}, {source}",
                expected="angles of the target in the receiving frame, of the right size and sign",
            )

    def stops_that_do_not_fit(self) -> BoolArray:
        """Return which stops have a reading that does not fit the others, (d,)."""
        outliers = self.fitted("cauchy", self.fitted("soft_l1").values).outliers()
        return np.asarray(outliers.reshape(len(self.stops), -1).any(axis=1))

    def fitted(self, loss: Loss, start: FloatArray | None = None, *, trust_sigmas: bool = True) -> Fit:
        """Fit the coordinates, and what each probe but the first reads too much [m]."""
        where = self._where()
        stack = Stack([sensor.build() for sensor in self.calibration.sensors])
        rows = [stack.reading_names.index(f"gap {probe.calibration.name}") for probe in self.probes]
        rotations, translations = poses_of(self.stops.reference)
        measured = np.column_stack([probe.gaps(self.stops.scans) for probe in self.probes])
        whiten = self._whitening(stack, rows, rotations, translations)
        count = len(where)

        def residuals(values: FloatArray) -> FloatArray:
            tried = stack.with_parameter_values(changed(stack.parameter_values, where, values[:count]))
            predicted = readings_at(tried, rotations, translations)[:, rows]
            predicted[:, 1:] += values[count:]
            return np.asarray(np.einsum("nij,nj->ni", whiten, measured - predicted).ravel())

        offsets = [f"zero of {probe.calibration.name}" for probe in self.probes[1:]]
        names = [*self.names, *offsets]
        scales = np.concatenate([np.full(count, 1e-3), np.full(len(offsets), 1e-4)])
        before = np.concatenate([self.before, np.zeros(len(offsets))])
        return fit(
            residuals,
            before if start is None else start,
            names,
            ["m"] * len(names),
            scales,
            taken=self.taken().effects(self._derivatives(stack, whiten, rotations, translations)),
            loss=loss,
            trust_sigmas=trust_sigmas,
            what=NAME,
        )

    def taken(self) -> Taken:
        """Return what is taken for known: all but the coordinates to be fitted."""
        return Taken(self.calibration, self._where())

    def _where(self) -> IntArray:
        """Return where the coordinates stand in the stack's parameter vector, (k,)."""
        sensor, _ = the_sensor(self.calibration, GapProbesCalibration, NAME)
        return indices(self.calibration, sensor, [f"tips[{probe},{axis}]" for probe, axis in self._places()])

    def _derivatives(
        self, stack: Stack, whiten: FloatArray, rotations: FloatArray, translations: FloatArray
    ) -> FloatArray:
        """Return d(residual)/d(parameter of the stack), (n, p); only the gap probes have a part in it."""
        at, _ = the_sensor(self.calibration, GapProbesCalibration, NAME)
        sensor, first = stack.sensors[at], first_index(self.calibration, at)
        out = np.zeros((*whiten.shape[:2], stack.parameters))
        for n, whitening in enumerate(whiten):
            block = sensor.residual_jacobian(self.stops.scans[n], rotations[n], translations[n])
            out[n, :, first : first + block.shape[1]] = whitening @ block
        return out.reshape(-1, stack.parameters)

    def _whitening(self, stack: Stack, rows: list[int], rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return what makes independent residuals of variance 1 of each stop's c readings, (d, c or c - 1, c).

        What the angles are off at a stop moves all its readings together, and so does the height. A free height takes
        one residual of each stop: what is left are the combinations of the readings that it does not move.
        """
        slopes = np.column_stack([probe.slopes(self.stops.scans) for probe in self.probes])
        spreads = self.stops.sigmas("gap_voltages")
        noises = np.array([probe.calibration.noise.number for probe in self.probes])
        noise = slopes * np.where(spreads > 0.0, spreads, noises / np.sqrt(self.stops.counts)[:, None])
        # A quaternion's vector part is half the angle.
        angles = 2.0 * self.stops.reference_sigmas[:, 3:5]
        moves = []
        for axis in range(2):
            turn = Rotation.from_rotvec(STEP * np.eye(3)[axis]).as_matrix()
            ahead = readings_at(stack, turn @ rotations, translations)[:, rows]
            back = readings_at(stack, turn.T @ rotations, translations)[:, rows]
            moves.append((ahead - back) / (2.0 * STEP) * angles[:, [axis]])
        up = readings_at(stack, rotations, translations + np.array([0.0, 0.0, STEP]))[:, rows]
        down = readings_at(stack, rotations, translations - np.array([0.0, 0.0, STEP]))[:, rows]
        lift = (up - down) / (2.0 * STEP)
        if self.options.lift_sigma is not None:
            moves.append(lift * self.options.lift_sigma)
        shared = np.stack(moves, axis=2)
        covariances = shared @ shared.transpose(0, 2, 1) + noise[:, :, None] ** 2 * np.eye(len(self.probes))
        whiten = np.linalg.inv(np.linalg.cholesky(covariances))
        if self.options.lift_sigma is not None:
            return np.asarray(whiten)
        without = np.linalg.svd(np.einsum("nij,nj->ni", whiten, lift)[:, :, None])[0][:, :, 1:]
        return np.asarray(without.transpose(0, 2, 1) @ whiten)


def _replacement(problem: _Problem, probe: int, values: FloatArray, covariance: FloatArray) -> Replacement:
    one = problem.probes[probe]
    tip, sigmas = one.calibration.tip.array.copy(), one.calibration.tip.sigmas.copy()
    for axis in range(2):
        column = problem.column(probe, axis)
        if column is not None:
            tip[axis], sigmas[axis] = values[column], np.sqrt(covariance[column, column])
    return Replacement(f"{one.key}.tip", tip.tolist(), sigmas.tolist())


PROCEDURE = Procedure(
    name=NAME,
    summary="where the gap probes sit (a, b, c), from angles imposed on the target",
    options=ProbeSpacingOptions,
    run=run,
)
