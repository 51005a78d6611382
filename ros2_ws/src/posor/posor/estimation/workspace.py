# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the compiled estimator works on: the model of one POSOR, its tracker, and memory for one scan, by name.

``WORKSPACE`` describes memory of fixed capacity, bounded by ``posor_msgs/RawScan``. ``Model`` groups it with the arrays
whose size depends on the calibration; kernels take one ``Model`` and read ``model.channels`` or ``workspace.jacobian``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.estimation.estimate import ESTIMATE
from posor.model.diode import SPOT_POSITION
from posor.model.reading_rows import POSE, ROW
from posor.model.scan import CONTACTS, MAX_DIODES, MAX_GAP_PROBES, MAX_RING_PROBES, SCAN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.estimation.fault_model import FaultModel
    from posor.numerics.array_types import FloatArray, IntArray

LONGEST_LOOP = 64  # loops of fewer scans are detected
READINGS = MAX_GAP_PROBES + MAX_RING_PROBES + 2 * MAX_DIODES + 8
"""Capacity for linearised readings: all of a raw scan, and 8 of sensors written in plain Python."""
ROWS = READINGS + 6  # capacity for rows: the readings, and one row of prior for each freedom

SETTINGS = np.dtype(  # settings of the tracker and of the tests
    [
        ("residual_limit", "f8"),  # largest chi-square of the redundant readings
        # square root of the non-centrality that the test may miss (``estimation.fault_effects``); infinite: no test
        ("noncentrality_root", "f8"),
        ("max_velocity", "f8"),  # of the target along X, Y and Z each [m/s]; infinite: not limited
        ("max_lean_rate", "f8"),  # [rad/s]
        ("max_theta_rate", "f8"),  # [rad/s]
        ("max_acceleration", "f8"),  # of the target along X, Y and Z each [m/s^2]; infinite: not stated
        ("max_lean_acceleration", "f8"),  # [rad/s^2]
        ("max_theta_acceleration", "f8"),  # [rad/s^2]
        ("travel_gap", "f8", (2,)),  # lowest and highest gap that the bearing permits [m]; infinite: not limited
        ("travel_lean", "f8"),  # largest inclination [rad]; infinite: not limited
        ("bump_angle", "f8"),  # after which the readings repeat [rad]; zero: never
        ("period", "f8"),  # after which theta is ambiguous: the bump angle, or the pitch of even light sources [rad]
        ("home_theta", "f8"),  # theta at the home mark [rad]
        ("environment", "f8", (2, 2)),  # lowest and highest supply voltage [V] and temperature [K]
        ("spreads", "f8", (2,)),  # standard uncertainty of both where they are not measured
        ("all_evidence", "f8"),  # that one repetition of all readings is a frozen device, see estimation.frozen
        ("dark_age", "f8"),  # largest age of a dark reading [s]; zero: the diodes need none (``estimation.ambient``)
        ("dark_noise", "f8"),  # standard deviation of a contact's current in a dark scan [A]
        ("dark_drift", "f8"),  # of the ambient light [A/s^.5]
        ("source_light", "f8"),  # standard uncertainty of the share of the sources' light in a dark scan
        ("reference_voltage", "f8"),  # known voltage that the probes' converter reads [V]; zero: none
        ("reference_sigma", "f8"),  # relative standard uncertainty of the gain where it is read
        ("gain_spread", "f8"),  # the same where it is not
        ("gain_limit", "f8"),  # largest deviation of the gain from one
        ("tilt_lags", "i8"),  # 1: the tilts are turned by the theta of the previous scan (program of 1985)
    ],
    align=True,
)

CLOCKS = np.dtype(  # the line between scan numbers and stamps (``estimation.clocks``)
    [
        ("fitted", "i8"),  # scans in the fit of the line; zero: no scan yet
        ("number", "u8"),  # of the last scan in order
        ("stamp", "f8"),  # its stamp since the epoch [s]
        ("line", "f8"),  # the line at its number [s]
        ("period", "f8"),  # slope of the line [s]
        ("variance", "f8"),  # of the stamps about the line [s^2]
        ("deviation", "f8"),  # of the present stamp from the line [s]
        ("step", "f8"),  # sum of the steps of the stamps that were accepted: they were or are wrong by as much [s]
        ("age", "f8"),  # of the present scan when it arrived [s]; NaN, or the same for all: unknown, as in a recording
        ("last_age", "f8"),  # of the last scan in order [s]
        ("least_age", "f8"),  # of the last scans in order [s]
        ("run_age", "f8"),  # of the scans in a row that are late or contradict the line and agree with one another [s]
        ("former_age", "f8"),  # ``least_age`` before a restart or a gap, to be compared with; NaN: nothing is
        ("compared", "i8"),  # scans since the ages are compared with ``former_age``
        ("only_older", "i8"),  # whether younger scans than ``former_age`` are no step, because it is of few scans
        ("age_tolerance", "f8"),  # change of the ages that the drift of the clocks explains since then [s]
        ("content", "f8"),  # sum of the raw readings of the last scan in order
        ("age_step", "f8"),  # part of ``step`` that the ages show [s]; later ones may correct it
        ("off_line", "f8"),  # share of the last scans whose stamps contradict the line and each other
        ("held", "i8"),  # 1: a line has held for FITTED_SCANS
        ("failed", "i8"),  # lines in a row that did not
        ("first_number", "u8"),  # of the scan that left the first of them
        ("first_stamp", "f8"),
        ("refused", "i8"),  # scans in a row that contradict the line or are late
        ("agreeing", "i8"),  # the last of them that agree with one another
        ("run_number", "u8"),  # of the first of these
        ("run_stamp", "f8"),
        ("late", "i8"),  # scans in a row whose number is not after the last
        ("set_back", "f8"),  # by which both clocks were set back, as scans that repeat the last numbers show [s]
        ("refused_number", "u8"),  # of the last scan that was refused or late
        ("refused_stamp", "f8"),
    ],
    align=True,
)

TIME_OFFSET = np.dtype(  # between the scans and an encoder (``estimation.time_offset``)
    [
        ("known", "i8"),  # 1 where there was a difference
        ("seconds", "f8"),  # the offset, positive where the scans are older than their stamps [s]
        ("variance", "f8"),  # of the offset [s^2]
        ("bias", "f8"),  # of the encoder minus theta [rad]
        ("bias_variance", "f8"),  # [rad^2]
        ("covariance", "f8"),  # of both [rad s]
        ("theta", "f8"),  # at the last difference [rad]
        ("direction", "f8"),  # of the last motion: -1, 1; zero: there was none
        ("disagreeing", "f8"),  # offset that is a fault [s]; zero: none
    ],
    align=True,
)

AMBIENT = np.dtype(  # ambient light (``estimation.ambient``)
    [
        ("known", "i8"),  # 1 after a dark scan
        ("stamp_ns", "i8"),  # of the last one [ns]
        ("variance", "f8"),  # of the currents then [A^2]
        ("currents", "f8", (CONTACTS * MAX_DIODES,)),  # of the contacts [A]
        ("light", "f8", (CONTACTS * MAX_DIODES,)),  # currents of the last valid lit scan without ambient light [A]
        ("dark_light", "f8", (CONTACTS * MAX_DIODES,)),  # those before the dark scans, averaged as ``currents`` [A]
        ("light_left", "i8"),  # 1: dark scans hold light of the sources
    ],
    align=True,
)

TRACKER = np.dtype(  # what is known from the previous scans
    [
        ("initialised", "i8"),  # 1 where there is a previous pose
        ("start_given", "i8"),  # 1 where the solver starts the next scan from ``start`` instead of the previous pose
        ("counted", "i8"),  # 1 where theta is counted from the home mark, or needs no count
        ("epoch_known", "i8"),
        ("epoch_ns", "i8"),  # origin of the stamps [ns]
        ("clocks", CLOCKS),
        ("time", "f8"),  # of the present scan, which only moves forward (``estimation.clocks``) [s]
        ("stamp", "f8"),  # ``time`` of the previous pose [s]
        ("theta", "f8"),  # its theta, turns counted [rad]
        ("theta_rate", "f8"),  # [rad/s]
        ("velocity", "f8", (3,)),  # of the translation [m/s]
        ("rates", "i8"),  # how many rates were found without a break
        ("rate_sigmas", "f8", (4,)),  # standard uncertainties of velocity and rate, from their changes [m/s], [rad/s]
        ("interval", "f8"),  # time over which rate and velocity were found [s]; zero: unknown
        ("pose", POSE),
        ("start", POSE),
        ("measured", "i8"),  # what a scan has measured, see ``linearise.missing``
        ("latch", "i8"),  # faults that keep the joint out
        ("latch_about_theta", "i8"),  # 1 where all of them are about theta only, which a reference can confirm
        ("acknowledged", "i8"),  # 1 where an operator released a latch and no reference has confirmed theta since
        ("latch_interval", "f8"),  # one scan interval at the time of the latch [s]
        ("rejected_known", "i8"),  # 1 where a pose was rejected since the latch
        ("rejected_stamp", "f8"),
        ("rejected", POSE),  # the last one
        ("marks", "i8"),  # consecutive home marks: positive if they agree with the count, negative if they disagree
        ("marks_off", "f8"),  # periods by which the last one was off
        ("mark_bump", "f8"),  # periods from home at which the last scan saw the home mark; NaN: it did not
        ("mark_sticks", "i8"),  # 1 where the home mark has been seen at several bumps without a pause
        ("contradictions", "i8"),  # failed residual tests in a row; while latched, passes that are still needed
        ("residual_run", "i8"),  # failed residual tests in a row, without an upper limit
        ("largest_residual", "f8"),  # largest chi-square of the run that latched the joint, and of later runs as long
        ("residual_theta", "f8"),  # theta of that scan [rad]; NaN: the latch is released at any theta
        ("tested_theta", "f8"),  # theta of the last residual test [rad]
        ("beyond_gap", "f8"),  # gap of the last pose beyond the travel [m]
        ("beyond_lean", "f8"),  # its inclination [rad]
        ("same_ambient", "i8"),  # 1: a dark scan since the first contradiction has shown the same ambient light
        ("reference_theta", "f8"),  # theta from an encoder for the next scan [rad]
        ("reference_sigma", "f8"),  # its standard uncertainty [rad]; zero: there is none
        ("reference_stamp_ns", "i8"),  # its time [ns]; zero: that of the next scan
        ("offset", TIME_OFFSET),
        ("ambient", AMBIENT),
        ("last_raw", "f8", (READINGS, 2)),  # raw readings of the scan before, two of each diode axis [V], [A]
        ("repeats", "i8", (READINGS,)),  # how often each has repeated without a break
        ("signatures", "f8", (LONGEST_LOOP,)),  # of all raw readings of the last scans, by number modulo LONGEST_LOOP
        ("signature_count", "i8"),
        ("loop_repeats", "i8", (LONGEST_LOOP,)),  # scans in a row that equal the one 1, 2, ... scans before
    ],
    align=True,
)

CHECKS = np.dtype(  # what the checks of one scan have found (``estimation.scan_checks``)
    [
        ("elapsed", "f8"),  # since the previous pose [s]
        ("allowance", "f8"),  # by which the motion may have lasted longer, because stamps scatter [s]
        ("faults", "i8"),  # found so far
        ("contradictory", "i8"),  # 1: the redundant readings fail the residual test
        ("accepted", "i8"),  # 1: the pose is where the target can have moved
        ("beyond_travel", "i8"),  # 1: the pose is beyond the travel of the bearing
        ("counted", "i8"),  # 1: theta was counted before this scan
        ("recounted", "i8"),  # 1: this scan counts theta anew
        ("reference_theta", "f8"),  # reference of theta at the stamp of this scan [rad]
        ("reference_variance", "f8"),  # [rad^2]; zero: there is none
        ("reference_tolerance", "f8"),  # by which it may be off, because the stamp may be wrong [rad]
        ("confirmed", "i8"),  # 1: home marks or a reference confirm theta
        ("marks", "i8"),  # as in the tracker, with this scan
        ("marks_off", "f8"),
    ],
    align=True,
)

WORKSPACE = np.dtype(  # memory of fixed capacity for one POSOR
    [
        ("settings", SETTINGS),
        ("tracker", TRACKER),
        ("checks", CHECKS),
        ("scan", SCAN),  # the scan of a stream
        ("estimate", ESTIMATE),  # its estimate
        ("reading_count", "i8"),
        ("redundant_count", "i8"),
        ("is_retry", "i8"),  # 1: the scan is estimated once more, from a start
        ("unmeasured", "i8"),  # see estimation.linearise
        ("is_dark", "i8"),  # 1: no light source is lit, and the calibration has dark scans
        ("ambient_unknown", "i8"),  # 1: no dark scan before the lit one, or it holds light of the sources
        ("ambient_old", "i8"),  # 1: the last dark scan was too long ago
        ("has_common_effects", "i8"),  # 1: the calibration has dark scans or a reference voltage
        ("lit_currents", "f8", (CONTACTS * MAX_DIODES,)),  # diode currents without the ambient light [A]
        ("ambient_effects", "f8", (READINGS, 2)),  # of its uncertainty, along both axes of a diode [m]
        ("light_effects", "f8", (READINGS,)),  # of light of the sources in the last dark scan [m]
        ("spot_partners", "i8", (READINGS,)),  # the other coordinate of the same spot, else the reading itself
        ("gain_effects", "f8", (READINGS,)),  # of the uncertainty of the converter's gain [m]
        # Exposure of each reading (``estimation.time_errors``)
        ("has_offsets", "i8"),  # 1: not all channels were read at the stamp
        ("offsets", "f8", (READINGS,)),  # [s]
        ("cross_offsets", "f8", (READINGS,)),  # by the rate of the partner, the other coordinate of a spot [s]
        ("partners", "i8", (READINGS,)),
        ("offset_variances", "f8", (READINGS,)),  # variance of an unknown offset [s^2]
        ("twist", "f8", (6,)),  # of the target, ROS order [m/s], [rad/s]
        ("twist_sigmas", "f8", (6,)),
        ("moved_pose", POSE),  # after half of the longest offset
        ("moved_rates", "f8", (READINGS,)),  # of the readings there [m/s]
        ("sensitivities", "f8", (READINGS, 2)),  # of each reading to supply and temperature [m/V], [m/K]
        ("evidence", "f8", (READINGS,)),  # of one repetition of each reading, see estimation.frozen
        # Linearised readings; the entries behind the readings belong to the prior.
        ("values", "f8", (ROWS,)),  # [m]; unit of the sensor for plain sensors
        ("variances", "f8", (ROWS,)),  # of the noise [m^2]
        ("weights", "f8", (ROWS,)),
        ("residuals", "f8", (ROWS,)),
        ("selected_rows", "i8", (READINGS,)),  # reading row of each reading of this scan
        ("active_rows", "i8", (READINGS,)),  # those of the last scan that was solved; -1: none
        ("rows_active", "i8"),  # whether ``rows`` hold the ``active_rows``
        ("row_changes", "i8"),  # how often ``active_rows`` have changed
        ("rows", ROW, (ROWS,)),
        ("spot", SPOT_POSITION),
        # Solver.
        ("pose", POSE),  # start and solution
        ("start_pose", POSE),
        ("jacobian", "f8", (ROWS, 6)),
        ("step_sum", "f8", (6,)),
        ("factors", "f8", (7, 3)),  # of the normal matrix, see numerics.matrix
        # Covariance.
        ("gain", "f8", (READINGS, 6)),  # change of the pose for a unit of each reading
        ("systematic_readings", "f8", (READINGS, READINGS)),  # systematic covariance of the readings [m^2]
        ("first_correlated", "i8", (READINGS,)),  # readings that each reading is correlated with: first, behind last
        ("end_correlated", "i8", (READINGS,)),
        ("alone_count", "i8"),  # see estimation.covariance
        ("contribution_count", "i8"),
        ("block_count", "i8"),
        # Residual test.
        ("residual_space", "f8", (READINGS, READINGS)),
        ("residual_components", "f8", (READINGS,)),
        ("residual_covariance", "f8", (READINGS, READINGS)),
    ],
    align=True,
)

SENSOR = np.dtype(  # where a sensor's readings come from and where they go
    [
        ("source", "i8"),  # see model.readings
        ("first_reading", "i8"),
        ("first_channel", "i8"),  # or first diode
        ("count", "i8"),  # of channels or diodes
        ("first_reading_row", "i8"),
        ("light_sources", "i8"),  # that each diode can see
    ],
    align=True,
)

PARAMETER_FACTORS = np.dtype([("first_factor", "i8"), ("count", "i8"), ("begin", "i8")], align=True)
"""Standard normal factors of one parameter: number of the first, how many, where their coefficients begin."""

CONTRIBUTION = np.dtype(  # one derivative times the factors of its parameter, and where the product goes
    [
        ("derivative", "i8"),  # index into ``derivatives``
        ("reading", "i8"),
        ("column", "i8"),  # of ``effects``
        ("count", "i8"),  # of factors
        ("assigns", "i8"),  # 1: the first to reach its cells of ``effects``, which it overwrites
    ],
    align=True,
)

BLOCK = np.dtype([("column", "i8"), ("count", "i8"), ("first_reading", "i8"), ("last_reading", "i8")], align=True)
"""Columns of ``effects`` that reach the same readings."""

FACTOR_USE = np.dtype([("uses", "i8"), ("column", "i8"), ("last_reading", "i8")], align=True)
"""Of a factor: how many contributions it has, its column of ``effects`` (-1: none), the last reading it reaches."""


class Model(NamedTuple):
    """One POSOR for the kernels. K reading rows, C channels, D diodes, m readings, P parameters, F factors."""

    workspace: NDArray[np.void]  # memory of fixed capacity, shape (1,), dtype WORKSPACE
    sensors: NDArray[np.void]  # shape (sensors,), dtype SENSOR
    reading_rows: NDArray[np.void]  # every row that a scan can read, shape (K,), dtype ROW
    row_parameters: IntArray  # which parameter each entry of a reading row is, negative: none, shape (K, PARAMETERS)
    channels: NDArray[np.void]  # shape (C,), dtype CHANNEL
    diodes: NDArray[np.void]  # shape (D,), dtype DIODE
    map_parameters: FloatArray  # of each diode's map, shape (D, longest)
    # Which parameter each derivative of a reading's linearisation belongs to, (m, L)
    linearisation_parameters: IntArray
    # Derivatives of prediction minus reading by all parameters: ``by_row``, then ``by_map``, whose first columns are
    # ``by_channel``
    derivatives: FloatArray
    by_row: NDArray[np.void]  # the same memory by the parameters of the rows, shape (m,), dtype ROW_DERIVATIVES
    # The same memory by the parameters of the channels, shape (m,), dtype CHANNEL_DERIVATIVES
    by_channel: NDArray[np.void]
    by_map: FloatArray  # the same memory by the parameters of the maps, shape (m, longest)
    parameter_factors: NDArray[np.void]  # shape (P,), dtype PARAMETER_FACTORS
    coefficients: FloatArray  # coefficients of all parameters' factors (``calibration.parameter_covariance``)
    effects: FloatArray  # what each shared factor does to each reading, shape (m, shared factors)
    contributions: NDArray[np.void]  # dtype CONTRIBUTION; first those that reach one reading only
    contribution_coefficients: FloatArray  # the coefficients in the order of the contributions
    blocks: NDArray[np.void]  # dtype BLOCK
    factor_uses: NDArray[np.void]  # shape (F,), dtype FACTOR_USE
    # Change of each parameter by one standard uncertainty of each of T shared terms, shape (P, T); shape (0, T) with
    # sensors in plain Python
    shared_coefficients: FloatArray
    shared_readings: FloatArray  # the same of the readings minus predictions, shape (m, T)
    faults: FaultModel  # hypotheses of the causes of faults
