# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From raw readings of a scan to linearised readings and the reading rows that they belong to, sensor by sensor.

Supply voltage and temperature: a calibration states the range in which it is valid. A supply or temperature that is not
measured deviates from the reference by an unknown amount, the same for all probes. With the sensitivities s of the
readings and the spread u of the deviation this adds ``u^2 s s'`` to the systematic covariance of the readings (JCGM
100, F.1.2.3: effects common to several readings correlate them).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.ambient import check_dark_currents, is_dark, keep_light, subtract_ambient, write_ambient_effects
from posor.estimation.clocks import stamp_is_valid
from posor.estimation.time_errors import begin_exposures, write_spot_offsets, write_voltage_offset
from posor.model.diode import CODES, OUTSIDE_X, find_ratios
from posor.model.fault import Fault
from posor.model.readings import (
    DIODE_CURRENTS,
    GAP_VOLTAGES,
    PYTHON,
    VALID,
    WRONG_COUNT,
    WRONG_SOURCE,
    WRONG_SOURCES,
    fault_of_code,
)
from posor.model.scan import CONTACTS
from posor.model.spot_map import INSIDE, spot_position
from posor.model.voltage import converter_gain, gain_is_valid, linearise_voltage, voltage_code
from posor.numerics.compiled import in_place
from posor.numerics.vector import square

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray, IntArray


BAD_READING = int(Fault.BAD_READING)
INVALID_TIME = -105  # code of the estimate: offsets, span, or uncertainty or limit of the stamp are invalid
SUPPLY, TEMPERATURE = 0, 1
REFERENCE_MEASURED = 4  # of ``missing``: the known voltage of the converter


@in_place
def environment_is_valid(settings: Any, scan: Any) -> bool:
    """Return whether supply, temperature and gain are each in their range, or not measured (NaN)."""
    limits = settings.environment
    supply, temperature = scan.supply_voltage, scan.temperature
    return (
        (math.isnan(supply) or limits[SUPPLY, 0] <= supply <= limits[SUPPLY, 1])
        and (math.isnan(temperature) or limits[TEMPERATURE, 0] <= temperature <= limits[TEMPERATURE, 1])
        and gain_is_valid(settings, scan)
    )


@in_place
def unmeasured(settings: Any, scan: Any) -> int:
    """Return which deviations are not measured and have a spread: 1 the supply, 2 the temperature, or their sum."""
    supply = math.isnan(scan.supply_voltage) and settings.spreads[SUPPLY] > 0.0
    temperature = math.isnan(scan.temperature) and settings.spreads[TEMPERATURE] > 0.0
    return (1 if supply else 0) + (2 if temperature else 0)


@in_place
def missing(settings: Any, tracker: Any, scan: Any) -> int:
    """Return what is not measured although a scan before measured it, and note what is.

    The sum of 1 for the supply, 2 for the temperature, REFERENCE_MEASURED.
    """
    absent = (1 if math.isnan(scan.supply_voltage) else 0) + (2 if math.isnan(scan.temperature) else 0)
    absent += REFERENCE_MEASURED if settings.reference_voltage > 0.0 and math.isnan(scan.reference_voltage) else 0
    tracker.measured |= 7 - absent
    return int(tracker.measured & absent)


@in_place
def add_unmeasured(workspace: Any) -> None:
    """Add the covariance from an unmeasured supply or temperature to ``systematic_readings``."""
    m, by = workspace.reading_count, workspace.sensitivities
    for quantity in range(2):
        if workspace.unmeasured & 1 << quantity:
            variance = square(workspace.settings.spreads[quantity])
            for r in range(m):
                for q in range(m):
                    workspace.systematic_readings[r, q] += variance * by[r, quantity] * by[q, quantity]


@in_place
def _select_probe_rows(model: Model, sensor: Any, scan: Any) -> int:
    """Write the reading rows of gap or ring probes; return VALID or a code."""
    if (scan.gap_count if sensor.source == GAP_VOLTAGES else scan.ring_count) != sensor.count:
        return WRONG_COUNT
    for i in range(sensor.count):
        model.workspace[0].selected_rows[sensor.first_reading + i] = sensor.first_reading_row + i
    return VALID


@in_place
def _linearise_voltages(model: Model, sensor: Any, scan: Any) -> int:
    """Linearise the voltages of gap or ring probes; return VALID or a code."""
    workspace = model.workspace[0]
    is_gap = sensor.source == GAP_VOLTAGES
    code = _select_probe_rows(model, sensor, scan)
    if code != VALID:
        return code
    gain, gain_sigma = converter_gain(workspace.settings, scan)
    for i in range(sensor.count):
        r, channel = sensor.first_reading + i, model.channels[sensor.first_channel + i]
        measured = (scan.gap_voltages[i] if is_gap else scan.ring_voltages[i]) / gain
        volt = measured + channel.zero_shift
        code = voltage_code(channel, volt)
        if code != VALID:
            return code + 2 * i
        workspace.values[r], workspace.variances[r] = linearise_voltage(
            channel, volt, scan.supply_voltage, scan.temperature, model.by_channel[r]
        )
        workspace.gain_effects[r] = measured * model.by_channel[r].zero_shift * gain_sigma
        if workspace.has_offsets:
            write_voltage_offset(workspace, scan, r, i if is_gap else scan.gap_count + i)
    return VALID


@in_place
def _select_spot_rows(model: Model, sensor: Any, scan: Any) -> int:
    """Write the reading rows of the light sources lit; return VALID or a code."""
    workspace = model.workspace[0]
    if scan.current_count != CONTACTS * sensor.count:
        return WRONG_COUNT
    if scan.lit_count != sensor.count:
        return WRONG_SOURCES
    for i in range(sensor.count):
        lit = 0 if workspace.is_dark else scan.lit_sources[i]
        if lit < 0 or lit >= sensor.light_sources:
            return WRONG_SOURCE - i
        for axis in range(2):
            row = sensor.first_reading_row + 2 * (i * sensor.light_sources + lit) + axis
            workspace.selected_rows[sensor.first_reading + 2 * i + axis] = row
    return VALID


@in_place
def _linearise_spots(model: Model, sensor: Any, scan: Any) -> int:
    """Linearise the contact currents of diodes; return VALID or a code."""
    code = _select_spot_rows(model, sensor, scan)
    if code != VALID:
        return code
    workspace = model.workspace[0]
    if workspace.is_dark:
        return _linearise_dark(model, sensor, scan)
    spot, ambient_sigma = workspace.spot, subtract_ambient(workspace, scan)
    for i in range(sensor.count):
        d, r = sensor.first_channel + i, sensor.first_reading + 2 * i
        diode = model.diodes[d]
        code = find_ratios(workspace.lit_currents, i, diode, spot)
        if code != VALID:
            return code + CODES * i
        outcome = spot_position(diode, model.map_parameters[d], spot, model.by_map, r)
        if outcome != INSIDE:
            return OUTSIDE_X + outcome - 1 + CODES * i
        for axis in range(2):
            workspace.values[r + axis] = spot.position[axis]
            by_x, by_y = spot.slope[axis, 0] * diode.noise[0], spot.slope[axis, 1] * diode.noise[1]
            workspace.variances[r + axis] = square(by_x) + square(by_y)
        if workspace.has_common_effects:
            write_ambient_effects(workspace, r, i, ambient_sigma)
        if workspace.has_offsets:
            write_spot_offsets(workspace, scan, r, i)
    keep_light(workspace, scan)
    return VALID


@in_place
def _linearise_dark(model: Model, sensor: Any, scan: Any) -> int:
    """Make the spots of a dark scan state nothing; return VALID or a code."""
    workspace = model.workspace[0]
    for i in range(2 * sensor.count):
        r = sensor.first_reading + i
        workspace.values[r], workspace.variances[r] = 0.0, math.inf
        workspace.ambient_effects[r, 0] = workspace.ambient_effects[r, 1] = workspace.light_effects[r] = 0.0
        if workspace.active_rows[r] >= 0:
            workspace.selected_rows[r] = workspace.active_rows[r]
    return int(check_dark_currents(model, sensor, scan))


@in_place
def linearise_scan(model: Model, scan: Any, estimate: Any) -> bool:
    """Linearise one scan; return whether all its readings are valid.

    Values, variances, selected rows and the derivatives by the linearisation's parameters are written. Linearisation
    stops at the first sensor with invalid readings: ``estimate`` gets the sensor's number, its code, and the fault.
    """
    estimate.sensor = -1
    estimate.code = VALID
    workspace = model.workspace[0]
    workspace.is_dark = 1 if workspace.settings.dark_age > 0.0 and is_dark(scan) else 0
    workspace.ambient_unknown = workspace.ambient_old = 0
    workspace.has_offsets = 0
    at_stamp = scan.offset_count == 0 and scan.exposure_span == 0.0
    if not (stamp_is_valid(scan) and (at_stamp or begin_exposures(workspace, scan))):
        estimate.code, estimate.faults = INVALID_TIME, BAD_READING
        return False
    for s in range(model.sensors.shape[0]):
        sensor = model.sensors[s]
        code = VALID
        if sensor.source == DIODE_CURRENTS:
            code = _linearise_spots(model, sensor, scan)
        elif sensor.source != PYTHON:
            code = _linearise_voltages(model, sensor, scan)
        if code != VALID:
            estimate.sensor = s
            estimate.code = code
            estimate.faults = fault_of_code(sensor.source, code)
            return False
    return True


@in_place
def linearise_scans(
    model: Model,
    scans: NDArray[np.void],
    values: FloatArray,
    variances: FloatArray,
    selected: IntArray,
    codes: IntArray,
) -> None:
    """Linearise many scans (n,): readings [m], variances [m^2] and reading rows (n, m), and each sensor's code (n, s).

    Pool rows are also written for scans with invalid readings; they are -1 where the lit sources are unknown.
    """
    workspace = model.workspace[0]
    estimate = workspace.estimate
    for n in range(scans.shape[0]):
        if linearise_scan(model, scans[n], estimate):
            for r in range(values.shape[1]):
                values[n, r], variances[n, r] = workspace.values[r], workspace.variances[r]
        else:
            codes[n, estimate.sensor] = estimate.code
            for r in range(values.shape[1]):
                workspace.selected_rows[r] = -1
            for s in range(model.sensors.shape[0]):
                if model.sensors[s].source == DIODE_CURRENTS:
                    _select_spot_rows(model, model.sensors[s], scans[n])
                elif model.sensors[s].source != PYTHON:
                    _select_probe_rows(model, model.sensors[s], scans[n])
        for r in range(values.shape[1]):
            selected[n, r] = workspace.selected_rows[r]
