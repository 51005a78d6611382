# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Supply, temperature, flags of the driver, and readings that no longer change."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import DesignName, design, sized_design
from posor.errors import CalibrationError, ParameterError, ShapeError
from posor.estimation.clocks import LATE_RUN
from posor.estimation.frozen import FROZEN_EVIDENCE, evidence_of_repetition
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import DIODES_ESTIMATED, HOME_BUMP, PROBES_ESTIMATED, SATURATED, Scans
from posor.sensors.gap_probes import GapProbesCalibration
from posor_lab.harness.random_poses import STACKS, turning_scans


def resting(posor: Posor, count: int, seed: int | None = 3, *, rounded: bool = False) -> Scans:
    """Scans at 1 kHz of a target at rest, counted from the first on, rounded to the stated steps if asked."""
    scans = turning_scans(posor, np.full(count, 0.02), seed, home=[0])
    scans.supply_voltages[:], scans.temperatures[:] = 15.0, 293.15
    converter = posor.calibration.converter
    if rounded and converter is not None:
        for name, step in (
            ("gap_voltages", converter.voltage.number),
            ("ring_voltages", converter.voltage.number),
            ("diode_currents", converter.current.number),
        ):
            scans = scans.with_fields({name: step * np.round(getattr(scans, name) / step)})
    return scans


INVALID = [("supply_voltage", value) for value in (0.0, 14.4, 16.0, math.inf, -math.inf)] + [
    ("temperature", value) for value in (0.0, 20.0, 313.0, math.inf, -math.inf, 1e300)
]


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize(("name", "value"), INVALID)
def test_outside_the_environment_a_scan_is_lost_and_says_so(stack: DesignName, name: str, value: float) -> None:
    posor = Posor(design(stack))
    scans = resting(posor, 3)
    assert posor.estimate(scans[0]).state is State.OK
    lost = posor.estimate(replace(scans[1], **{name: value}))  # type: ignore[arg-type]
    assert (lost.state, lost.faults) == (State.LOST, Fault.ENVIRONMENT)
    limits = "14.5 to 15.5 V" if name == "supply_voltage" else "283.15 to 303.15 K"
    assert f"{value:g}" in lost.reason
    assert limits in lost.reason
    assert posor.estimate(scans[2]).state is State.OK


def test_without_the_section_only_plausible_or_unmeasured_values_are_accepted() -> None:
    posor = Posor(design("triad_diodes").model_copy(update={"environment": None}))
    scan = resting(posor, 1)[0]
    for value in (math.nan, 10.0, 16.0):
        assert posor.estimate(replace(scan, supply_voltage=value)).state is State.OK
        posor.reset()
    for name, value, limits in (
        ("temperature", 20.0, "100 to 600 K"),
        ("temperature", math.inf, "100 to 600 K"),
        ("supply_voltage", 15000.0, "7.5 to 30 V"),
        ("supply_voltage", 0.0, "7.5 to 30 V"),
    ):
        lost = posor.estimate(replace(scan, **{name: value}))  # type: ignore[arg-type]
        assert lost.faults == Fault.ENVIRONMENT
        assert limits in lost.reason


def test_without_the_section_and_references_a_supply_is_any_finite_number() -> None:
    calibration = design("triad_diodes").model_copy(update={"environment": None})
    triad, *others = calibration.sensors
    assert isinstance(triad, GapProbesCalibration)
    bare = [probe.model_copy(update={"supply": None}) for probe in triad.probes]
    sensors = [triad.model_copy(update={"probes": bare}), *others]
    posor = Posor(calibration.model_copy(update={"sensors": sensors}))
    scan = resting(posor, 1)[0]
    assert posor.estimate(replace(scan, supply_voltage=15000.0)).state is State.OK
    lost = posor.estimate(replace(scan, supply_voltage=math.inf))
    assert lost.faults == Fault.ENVIRONMENT
    assert "finite" in lost.reason


@pytest.mark.parametrize("stack", STACKS)
def test_what_is_not_measured_widens_the_covariance_as_one_deviation_of_all_probes(stack: DesignName) -> None:
    calibration = design(stack)
    posor = Posor(calibration)
    scan = resting(posor, 1)[0]
    measured = posor.estimate(scan)
    posor.reset()
    unmeasured = posor.estimate(replace(scan, supply_voltage=math.nan, temperature=math.nan))
    assert calibration.environment is not None
    assert calibration.environment.supply is not None
    assert calibration.environment.temperature is not None
    expected = measured.covariance_systematic
    for name, value, part in (
        ("supply_voltage", 15.0, calibration.environment.supply),
        ("temperature", 293.15, calibration.environment.temperature),
    ):
        shifted = []
        for sign in (1.0, -1.0):
            posor.reset()
            shifted.append(posor.estimate(replace(scan, **{name: value + sign * 0.1})).T_R_T)  # type: ignore[arg-type]
        assert shifted[0] is not None
        assert shifted[1] is not None
        import pinocchio as pin  # noqa: PLC0415

        change = np.concatenate(
            [shifted[0].translation - shifted[1].translation, pin.log3(shifted[0].rotation @ shifted[1].rotation.T)]
        )
        effect = change / 0.2 * part.spread.number
        expected = expected + np.outer(effect, effect)
    sigmas = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        unmeasured.covariance_systematic / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-3
    )
    assert unmeasured.state is State.OK
    assert unmeasured.covariance_systematic[2, 2] > measured.covariance_systematic[2, 2]


@pytest.mark.parametrize("name", ["supply_voltage", "temperature"])
def test_what_is_no_longer_measured_degrades(name: str) -> None:
    posor = Posor(design("triad_light_ring"))
    scans = resting(posor, 3)
    assert posor.estimate(scans[0]).state is State.OK
    missing = posor.estimate(replace(scans[1], **{name: math.nan}))  # type: ignore[arg-type]
    assert (missing.state, missing.faults) == (State.DEGRADED, Fault.ENVIRONMENT)
    assert "is no longer measured" in missing.reason
    assert posor.estimate(scans[2]).state is State.OK


@pytest.mark.parametrize("status", [PROBES_ESTIMATED, DIODES_ESTIMATED, SATURATED, SATURATED | 64])
def test_flags_of_the_driver_degrade(status: int) -> None:
    posor = Posor(design("triad_diodes"))
    scans = resting(posor, 2)
    assert posor.estimate(replace(scans[0], status=64)).state is State.OK
    flagged = posor.estimate(replace(scans[1], status=status))
    assert (flagged.state, flagged.faults) == (State.DEGRADED, Fault.FLAGGED)
    assert "saturated" in flagged.reason


@pytest.mark.parametrize("stack", STACKS)
def test_sound_rounded_readings_are_not_frozen(stack: DesignName) -> None:
    posor = Posor(design(stack, motion=True, converter=True))
    found = posor.estimate_all(resting(posor, 20_000, rounded=True))
    assert np.count_nonzero(found.faults & Fault.FROZEN) <= 2
    assert np.mean(found.states == State.OK) > 0.998


@pytest.mark.parametrize("stack", STACKS)
def test_frozen_readings_are_lost_at_once_and_a_frozen_channel_soon(stack: DesignName) -> None:
    posor = Posor(design(stack, motion=True, converter=True))
    scans = resting(posor, 300, rounded=True)
    for name in ("gap_voltages", "ring_voltages", "diode_currents"):
        getattr(scans, name)[100:] = getattr(scans, name)[100]
    found = posor.estimate_all(scans)
    assert (found.states[:100] == State.OK).mean() > 0.97
    assert (found.states[102:] == State.LOST).all()
    assert found.faults[102] & Fault.FROZEN
    alone = Posor(posor.calibration)
    scans = resting(alone, 300, rounded=True)
    scans.gap_voltages[100:, 1] = scans.gap_voltages[100, 1]
    found = alone.estimate_all(scans)
    first = int(np.flatnonzero(found.faults & Fault.FROZEN)[0])
    assert 104 < first <= 112
    assert "gap_2 repeats" in found.reason(first)


def test_frozen_diodes_of_a_light_ring_are_lost_at_once() -> None:
    """Gap probes do not show whether the joint turns meanwhile."""
    posor = Posor(sized_design("quad_light_ring", 0.15, frames=("receiving", "target"), title="ring"))
    scans = resting(posor, 300, rounded=True)
    scans.diode_currents[100:] = scans.diode_currents[99]
    found = posor.estimate_all(scans)
    assert (found.states[:100] == State.OK).mean() > 0.97
    assert (found.states[100:] == State.LOST).all()
    assert found.faults[100] & Fault.FROZEN
    assert "repeats" in found.reason(100)


def test_readings_filled_in_by_the_driver_may_repeat() -> None:
    posor = Posor(design("triad_diodes", motion=True, converter=True))
    scans = resting(posor, 100, rounded=True)
    scans.gap_voltages[50:] = scans.gap_voltages[50]
    scans.statuses[51:] = PROBES_ESTIMATED
    found = posor.estimate_all(scans)
    assert not (found.faults & Fault.FROZEN).any()
    assert (found.states[51:] != State.OK).all()


def test_without_a_converter_readings_may_repeat() -> None:
    posor = Posor(design("triad_diodes", motion=True))
    assert (posor.estimate_all(resting(posor, 50, None)).states == State.OK).all()


def test_evidence_is_the_probability_of_a_repetition() -> None:
    random = np.random.default_rng(5)
    for step in (0.3, 1.0, 3.0):
        readings = np.round(random.normal(size=(2, 400_000)) / step)
        equal = np.mean(readings[0] == readings[1])
        assert evidence_of_repetition(step, 1.0) == pytest.approx(-math.log10(equal), abs=0.02)
    assert evidence_of_repetition(0.0, 1.0) == FROZEN_EVIDENCE
    assert evidence_of_repetition(1e-5, 1.0) == pytest.approx(-math.log10(1e-5 / (2.0 * math.sqrt(math.pi))))


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("environment", ("supply", "range"), {"value": [15.5, 14.5], "unit": "V"}, r"range \[15.5, 14.5\]"),
        ("environment", ("supply", "range"), {"value": [14.5, 15.5], "unit": "K"}, "unit 'K'"),
        ("environment", ("temperature", "spread"), {"value": -1.0, "unit": "K"}, "spread -1.0"),
        ("converter", ("voltage",), {"value": -1e-3, "unit": "V"}, "voltage -0.001"),
    ],
)
def test_mistakes_in_the_sections_are_refused(section: str, key: tuple[str, ...], value: object, message: str) -> None:
    content = design("triad_diodes", converter=True).model_dump(mode="json")
    part = content[section]
    for name in key[:-1]:
        part = part[name]
    part[key[-1]] = value
    with pytest.raises(ValueError, match=message):
        calibration_from(content)


def test_two_sensors_of_one_source_are_refused() -> None:
    calibration = design("triad_diodes")
    twice = calibration.model_copy(update={"sensors": [calibration.sensors[0], *calibration.sensors]})
    with pytest.raises(CalibrationError, match="two sensors read the gap voltages"):
        Posor(twice)


def test_parameter_vectors_of_another_length_or_without_a_number_are_refused() -> None:
    posor = Posor(design("triad_diodes"))
    values = posor.stack.parameter_values
    with pytest.raises(ShapeError, match="values"):
        posor.with_parameter_values(values[:-1])
    values[3] = math.nan
    with pytest.raises(ParameterError, match="finite"):
        posor.with_parameter_values(values)


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("length", [2, 3, 8, 40])
def test_readings_that_repeat_in_a_loop_are_frozen(stack: DesignName, length: int) -> None:
    """As from a buffer of several scans that nobody fills any more."""
    posor = Posor(design(stack, motion=True, converter=True))
    scans = resting(posor, 300, rounded=True)
    loop = 100 - length + np.arange(200) % length
    for name in ("gap_voltages", "ring_voltages", "diode_currents"):
        getattr(scans, name)[100:] = getattr(scans, name)[loop]
    found = posor.estimate_all(scans)
    assert (found.states[:100] == State.OK).mean() > 0.97
    assert (found.states[105:] == State.LOST).all()
    assert found.faults[105] & Fault.FROZEN


def test_a_recording_that_is_played_back_and_forth_is_no_loop() -> None:
    """At each end, one scan repeats the one before the last."""
    posor = Posor(sized_design("quad_light_ring", 0.15, frames=("receiving", "target"), title="ring"))
    scans = resting(posor, 300, rounded=True)
    place = np.abs((np.arange(300) + 50) % 198 - 99)
    for name in ("gap_voltages", "diode_currents"):
        getattr(scans, name)[:] = getattr(scans, name)[place]
    assert not (posor.estimate_all(scans).faults & Fault.FROZEN).any()


def test_a_short_recording_that_starts_over_is_no_loop() -> None:
    """Its scans come again with numbers and stamps, as of ``ros2 bag play --loop`` or of a simulated clock set back."""
    posor = Posor(design("triad_light_ring", motion=True, converter=True))
    found = posor.estimate_all(resting(posor, 50, rounded=True).select(np.tile(np.arange(50), 4)))
    assert not (found.faults & Fault.FROZEN).any()
    assert np.count_nonzero(found.faults & Fault.BAD_READING) == 3 * (LATE_RUN - 1)
    assert found.states[-1] == State.OK


def looping() -> tuple[Posor, Scans]:
    """Return a POSOR and 300 scans, of which from the 100th on 8 readings repeat in a loop."""
    posor = Posor(design("triad_light_ring", motion=True, converter=True))
    scans = resting(posor, 300, rounded=True)
    for name in ("gap_voltages", "diode_currents"):
        getattr(scans, name)[100:] = getattr(scans, name)[92 + np.arange(200) % 8]
    return posor, scans


def test_a_loop_is_seen_whatever_the_home_mark_says() -> None:
    posor, scans = looping()
    scans.statuses[::3] = HOME_BUMP
    assert (posor.estimate_all(scans).states[106:] == State.LOST).all()


def test_readings_filled_in_by_the_driver_may_repeat_in_a_loop() -> None:
    posor, scans = looping()
    scans.statuses[100:] = PROBES_ESTIMATED | DIODES_ESTIMATED
    assert not (posor.estimate_all(scans).faults & Fault.FROZEN).any()
