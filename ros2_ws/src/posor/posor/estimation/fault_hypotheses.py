# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The causes of faults of a calibration as hypotheses for the kernels (``estimation.fault_model``)."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.calibration.causes import AMBIENT_CAUSES, GAIN_CAUSES, MAX_CAUSES, Pattern, Readings, all_causes
from posor.errors import CalibrationError
from posor.estimation.fault_model import (
    ALWAYS,
    AMBIENT,
    CONTACT_X,
    CONTACT_Y,
    LENGTH,
    MAX_EFFECTS,
    SECOND,
    SHARED,
    FaultModel,
    JointCauses,
)
from posor.model.readings import DIODE_CURRENTS, GAP_VOLTAGES, RING_VOLTAGES
from posor.sensors.base import RowSensor
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.causes import Cause
    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import FloatArray

LIMIT_SIGMAS = 3.0  # standard uncertainties of a known voltage that bound the gain
_BY = {name: number for number, name in enumerate(("length", "voltage", "gain", "supply", "temperature"))}


class Hypotheses(NamedTuple):
    """The hypotheses of a calibration: for each column its cause, its name and its parameter."""

    causes: tuple[Cause, ...]
    of_columns: tuple[int, ...]  # cause of each column
    names: tuple[str, ...]  # of each column: the cause, and which readings of several
    model: FaultModel

    @staticmethod
    def of(calibration: Calibration, stack: Stack) -> Hypotheses:
        """Return the hypotheses of a calibration. Raises CalibrationError: too many causes or columns."""
        causes: list[Cause] = []
        of_columns, names, columns = [], [], []
        for cause in all_causes(calibration.causes, _reduced_bounds(calibration)):
            found = [] if cause.bound == 0.0 else list(_hypotheses(cause, calibration, stack))
            if found:
                causes.append(cause)
            for part, parameters in found:
                kind = (ALWAYS if cause.kind == "always" else 0) | (SHARED if cause.shared_by == "arm" else 0)
                for number, parameter in enumerate(parameters):
                    of_columns.append(len(causes) - 1)
                    names.append(f"{cause.name}: {part}" if part else cause.name)
                    columns.append((parameter, cause.limit, kind | (SECOND if number else 0)))
        where = f"calibration '{calibration.name}'"
        if len(columns) > MAX_EFFECTS:
            what = f"causes with {len(columns)} parameters"
            raise CalibrationError(what, where=where, expected=f"at most {MAX_EFFECTS}; 'some probes' has the most")
        if len(causes) > MAX_CAUSES:
            raise CalibrationError(f"{len(causes)} causes", where=where, expected=f"at most {MAX_CAUSES}")
        return Hypotheses(tuple(causes), tuple(of_columns), tuple(names), FaultModel.of(columns, stack.readings))

    def joint_causes(self) -> JointCauses:
        """Return the causes as the messages of the joint state them."""
        kinds = tuple(self.model.columns["kind"].tolist())
        return JointCauses(tuple(cause.name for cause in self.causes), self.of_columns, kinds)


def _reduced_bounds(calibration: Calibration) -> dict[str, tuple[float, str]]:
    """Return the bounds of default causes that dark scans and a known voltage leave; see ``all_causes``."""
    bounds: dict[str, tuple[float, str]] = {}
    for sensor in calibration.sensors:
        if isinstance(sensor, DiodesCalibration) and sensor.ambient is not None:
            bounds |= dict.fromkeys(AMBIENT_CAUSES, (sensor.ambient.remaining.number, "remaining of ambient"))
        elif isinstance(sensor, GapProbesCalibration) and sensor.reference is not None:
            voltage = sensor.reference.voltage
            bound = LIMIT_SIGMAS * float(voltage.sigmas) / voltage.number
            bounds |= dict.fromkeys(GAIN_CAUSES, (bound, "assumed: 3 standard uncertainties of the known voltage"))
    return bounds


def _hypotheses(
    cause: Cause, calibration: Calibration, stack: Stack
) -> Iterator[tuple[str, list[tuple[int, FloatArray]]]]:
    """Yield which readings each hypothesis of a cause moves, and its columns: sensitivity and coefficients (m,)."""
    readings, pattern, by = cause.move.readings, cause.move.pattern, cause.move.units[cause.unit]
    rows, places = _readings(readings, calibration, stack)
    one, name = np.eye(stack.readings), stack.reading_names
    if readings is Readings.DIODES:
        pairs = [(rows[i], rows[i + 1]) for i in range(0, len(rows), 2)]
        yield from _of_diodes(pattern, by, one, [(name[x].removeprefix("spot x "), x, y) for x, y in pairs])
    elif pattern is Pattern.EACH:
        yield from ((name[r], [(_BY[by], one[r])]) for r in rows)
    elif pattern is Pattern.COMMON and rows:
        yield "", [(_BY[by], one[rows].sum(axis=0))]
    elif pattern is Pattern.SUBSETS:
        for count in range(2, len(rows) + 1):
            for chosen in combinations(rows, count):
                yield ", ".join(name[r] for r in chosen), [(_BY[by], one[list(chosen)].sum(axis=0))]
    elif pattern is Pattern.GRADIENT and len(rows) > 1 and np.ptp(places, axis=0).any():
        offsets = places - places.mean(axis=0)
        offsets /= np.linalg.norm(offsets, axis=1).max()
        apart = np.flatnonzero(np.ptp(places, axis=0))  # not both where the probes are on a line along X or Y
        yield "", [(LENGTH, one[rows].T @ offsets[:, k]) for k in apart]


def _of_diodes(
    pattern: Pattern, by: str, one: FloatArray, diodes: Sequence[tuple[str, int, int]]
) -> Iterator[tuple[str, list[tuple[int, FloatArray]]]]:
    """Yield the hypotheses of diodes: name, reading of x and of y."""
    of_both = [one[x] + one[y] for _, x, y in diodes]
    if by == "length":
        of_axes = [[(LENGTH, one[x]), (LENGTH, one[y])] for _, x, y in diodes]
    elif by == "contact":
        of_axes = [[(CONTACT_X, both), (CONTACT_Y, both)] for both in of_both]
    else:
        of_axes = [[(AMBIENT, both)] for both in of_both]
    if pattern in {Pattern.PLANE_EACH, Pattern.DIODE_EACH}:
        yield from ((diode[0], columns) for diode, columns in zip(diodes, of_axes, strict=True))
    elif pattern is Pattern.EACH:
        for (name, _, _), columns in zip(diodes, of_axes, strict=True):
            yield from ((f"{axis} of {name}", [column]) for axis, column in zip("xy", columns, strict=True))
    elif diodes:
        parameters = zip(*of_axes, strict=True)
        yield "", [(own[0][0], np.sum([entries for _, entries in own], axis=0)) for own in parameters]


def _readings(readings: Readings, calibration: Calibration, stack: Stack) -> tuple[list[int], FloatArray]:
    """Return the readings that a cause may move, and the places of their probes along X and Y of R, (n, 2) [m]."""
    if readings is Readings.ALL:
        return list(range(stack.readings)), np.zeros((stack.readings, 2))
    wanted = {
        Readings.GAPS: {GAP_VOLTAGES},
        Readings.RING: {RING_VOLTAGES},
        Readings.PROBES: {GAP_VOLTAGES, RING_VOLTAGES},
        Readings.DIODES: {DIODE_CURRENTS},
    }[readings]
    rows: list[int] = []
    places = []
    for sensor, own, first in zip(stack.sensors, calibration.sensors, stack.first_readings, strict=True):
        if isinstance(sensor, RowSensor) and sensor.reading_source.source in wanted:
            rows += range(first, first + len(sensor.reading_names))
            places += [probe.tip.array[:2] for probe in getattr(own, "probes", ())]
    return rows, np.reshape(places, (-1, 2))
