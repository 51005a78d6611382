# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Electronics of the simulated arm: contamination, converter, supply, lost and late scans."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.scan import DARK_SUBTRACTED
from posor.numerics.stamps import NS
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.electronics import convert_to_digital
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.simulated_scans import SimulatedScans
from posor_msgs.msg import RawScan

from ..three_joint_arm import FAR, TICKS, N, perfect, refused, scenario, simulation, write_arm


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> ArmSimulation:
    return simulation(tmp_path_factory.mktemp("clean"), Imperfections.only())


def test_contamination_is_on_its_channel_and_at_its_time(tmp_path: Path, clean: ArmSimulation) -> None:
    dirty = simulation(tmp_path, Imperfections.only("contamination"))
    shift = dirty.scans("elbow", TICKS).scans.gap_voltages - clean.scans("elbow", TICKS).scans.gap_voltages
    expected = np.zeros((N, 3))
    expected[100:120, 0] = 0.05
    assert np.allclose(shift, expected, rtol=0.0, atol=1e-12)
    ratio = dirty.scans("shoulder", TICKS).scans.diode_currents / clean.scans("shoulder", TICKS).scans.diode_currents
    expected = np.ones((N, 2, 4))
    expected[600:610, 1, 0] = 0.95
    assert np.allclose(ratio, expected, rtol=0.0, atol=1e-12)


def test_contamination_of_redundant_readings_is_detected_by_the_estimator(tmp_path: Path) -> None:
    dirty = simulation(tmp_path, Imperfections.only("contamination", "noise"))
    found = Posor(dirty.calibrations["shoulder"]).estimate_all(dirty.scans("shoulder", TICKS).scans)
    assert np.all(found.states[600:610] == State.LOST)
    assert np.mean(found.states[:600] == State.OK) > 0.98


@pytest.mark.parametrize("first", [0, 700])
def test_dark_scans_show_the_ambient_light_and_the_estimator_removes_it(first: int) -> None:
    arm = load_checked_arm("six_axis")
    arms = [ArmSimulation(arm, Imperfections.only("noise", *names)) for names in ((), ("ambient_light",))]
    ticks, posor = np.arange(first, first + 2500), Posor(arms[1].calibrations["elbow"])
    arms[1].start_at("elbow", first)
    without, lit = (each.scans("elbow", ticks).scans for each in arms)
    dark = np.flatnonzero((ticks == first) | (ticks % 2000 == 0))  # once in ten seconds
    assert np.flatnonzero(lit.dark).tolist() == dark.tolist()
    np.testing.assert_allclose(lit.diode_currents[dark], 2e-7, atol=6e-9)
    currents = lit.diode_currents - 2e-7
    np.testing.assert_allclose(currents[~lit.dark], without.diode_currents[~lit.dark], rtol=0.0, atol=1e-18)
    assert not np.any(lit.statuses & DARK_SUBTRACTED)
    assert np.all(without.statuses & DARK_SUBTRACTED)
    found = posor.estimate_all(lit)
    assert found.states[0] == State.LOST
    assert np.mean(found.states[1:][~lit.dark[1:]] == State.OK) > 0.998
    assert np.all(found.states[dark[1:]] == State.DEGRADED)


@pytest.mark.parametrize("statement", ["stated", "unstated", "unknown"])
def test_multiplexed_channels_are_read_at_their_own_times(tmp_path: Path, statement: str) -> None:
    interval_s = 1e-3
    content = perfect(scenario())
    content["electronics"]["multiplexer"] = {"interval": {"value": interval_s, "unit": "s"}, "offsets": statement}
    slow = simulation(tmp_path, Imperfections.only(), content)
    del content["electronics"]["multiplexer"]
    (folder := tmp_path / "fast").mkdir()
    fast = ArmSimulation(load_arm_file(write_arm(folder, content)), Imperfections.only(), 1000)
    scans, offsets = slow.scans("shoulder", TICKS[20:-20]).scans, np.arange(-5, 6)
    names = ("gap_voltages", "diode_currents")
    found = np.hstack([getattr(scans, name).reshape(len(scans), -1) for name in names])
    for channel, offset in enumerate(offsets.tolist()):
        truth = fast.scans("shoulder", 10 * TICKS[20:-20] + offset).scans
        expected = np.hstack([getattr(truth, name).reshape(len(truth), -1) for name in names])[:, channel]
        same = (truth.lit_sources == scans.lit_sources).all(axis=1)
        step = np.ptp(expected)
        np.testing.assert_allclose(found[same, channel], expected[same], atol=2e-4 * step)
    states = {"stated": interval_s * offsets, "unknown": np.full(11, np.nan), "unstated": np.empty(0)}[statement]
    np.testing.assert_allclose(scans.exposure_offsets[7], states, atol=1e-12)
    assert scans.exposure_spans[7] == pytest.approx(0.0 if statement == "unstated" else 10.0 * interval_s)
    assert 0.0 < scans.stamp_uncertainties[7] < scans.stamp_limits[7] < 1e-9


@pytest.mark.parametrize("bits", [12, 16])
def test_converter_rounds_to_its_steps(tmp_path: Path, clean: ArmSimulation, bits: int) -> None:
    arm = simulation(tmp_path, Imperfections.only("quantisation"), scenario({"electronics.converter.bits": bits}))
    step = 20.0 / 2**bits
    volts = arm.scans("base", TICKS).scans.gap_voltages
    codes = (volts + 10.0) / step
    assert np.allclose(codes, np.round(codes), rtol=0.0, atol=1e-9)
    off = np.max(np.abs(volts - clean.scans("base", TICKS).scans.gap_voltages))
    assert 0.4 * step < off <= 0.5 * step + 1e-12


@pytest.mark.parametrize("names", [(), ("quantisation",)])
def test_end_of_the_converter_is_flagged(tmp_path: Path, clean: ArmSimulation, names: tuple[str, ...]) -> None:
    volts = clean.scans("base", TICKS).scans.ring_voltages
    high = float(np.quantile(volts, 0.7))
    content = scenario({"electronics.converter.probes.value": [-10.0, high]})
    scans = simulation(tmp_path, Imperfections.only(*names), content).scans("base", TICKS)
    flagged = scans.statuses & RawScan.STATUS_SATURATED > 0
    step = (high + 10.0) / 2**16
    clear = np.any(volts > high, axis=1)
    near = np.any(np.abs(volts - high) < 2.0 * step, axis=1)
    assert clear.any()
    assert not clear.all()
    assert np.array_equal(flagged[~near], clear[~near])
    assert scans.scans.ring_voltages.max() <= high


def test_target_out_of_range_saturates_probes_and_darkens_diodes(tmp_path: Path) -> None:
    content = scenario()
    content["joints"]["shoulder"]["bearing"].update(
        orders=[8], radial={"value": [8e-3], "unit": "m"}, axial={"value": [3e-3], "unit": "m"}
    )
    scans = simulation(tmp_path, Imperfections.only(), content).scans("shoulder", TICKS)
    driven = np.any(scans.scans.gap_voltages > 9.99, axis=1)
    dark = np.any(np.all(scans.scans.diode_currents == 0.0, axis=2), axis=1)
    assert driven.any()
    assert dark.any()
    assert np.all(scans.statuses[driven | dark] & RawScan.STATUS_SATURATED)
    assert np.all(np.isfinite(scans.scans.gap_voltages))


def test_dropouts_and_latencies_follow_the_scenario(tmp_path: Path) -> None:
    everything = simulation(tmp_path)
    scans: SimulatedScans = everything.scans("base", np.arange(5000))
    assert 0.01 < 1.0 - scans.sent.mean() < 0.03
    seconds = scans.latencies_ns / NS
    assert seconds.min() >= 0.0008
    assert seconds.max() <= 0.0012
    assert seconds.std() == pytest.approx(2e-4 / np.sqrt(3.0), rel=0.05)


def test_unmeasured_supply_shifts_voltages_too(tmp_path: Path, clean: ArmSimulation) -> None:
    content = scenario({"electronics.supply.measured": False})
    scans = simulation(tmp_path, Imperfections.only("supply_drift"), content).scans("base", FAR + TICKS).scans
    assert np.all(np.isnan(scans.supply_voltages))
    moved = scans.gap_voltages != clean.scans("base", FAR + TICKS).scans.gap_voltages
    assert np.mean(moved) > 0.99  # the supply passes its mean at times


RINGS = "ring_1, ring_2, ring_3, ring_4"


@pytest.mark.parametrize(
    ("index", "channel", "what", "expected"),
    [
        (0, "gap_9", "joint 'elbow' has no probe 'gap_9'", f"one of gap_1, gap_2, gap_3, {RINGS}"),
        (1, "gap_1", "joint 'shoulder' has no diode 'gap_1'", "one of diode_1, diode_2"),
    ],
)
def test_contamination_of_an_unknown_channel_is_refused(
    tmp_path: Path, index: int, channel: str, what: str, expected: str
) -> None:
    error = refused(tmp_path, scenario({f"electronics.contamination.{index}.channel": channel}))
    assert error.where == f"{tmp_path / 'scenario.yaml'}, key electronics.contamination[{index}]"
    assert (error.what, error.expected) == (what, expected)


RANGE = np.array([-8.0, 8.0])
STEP = 16.0 / 4096
LAST = 8.0 - STEP


@pytest.mark.parametrize(
    ("value", "code_value", "ended"),
    [
        (0.0, 0.0, False),
        (0.4 * STEP, 0.0, False),
        (0.6 * STEP, STEP, False),
        (-8.0 + STEP, -8.0 + STEP, False),
        (-8.0, -8.0, True),
        (-9.0, -8.0, True),
        (LAST - STEP, LAST - STEP, False),
        (LAST, LAST, True),
        (7.99999, LAST, True),
        (100.0, LAST, True),
    ],
)
def test_value_becomes_the_nearest_code_and_an_end_code_is_flagged(
    value: float, code_value: float, *, ended: bool
) -> None:
    values, ends = convert_to_digital(np.array([[value, 1.0], [1.0, 1.0]]), RANGE, 12, steps=True)
    assert values[0, 0] == code_value
    assert ends.tolist() == [ended, False]


def test_without_steps_only_the_range_is_limited() -> None:
    values, ends = convert_to_digital(np.array([[0.4 * STEP], [20.0]]), RANGE, 12, steps=False)
    assert values[:, 0] == pytest.approx([0.4 * STEP, LAST], abs=1e-12)
    assert ends.tolist() == [False, True]
