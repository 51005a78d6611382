# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of a scenario: what each kind changes, and nothing else; wrong entries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.model.scan import HOME_BUMP
from posor.numerics.stamps import NS
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.faults import KINDS, SimulatedFault
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.simulated_scans import PROBE_FIELDS, SimulatedScans
from posor_lab.harness.beams import quantity
from pydantic import ValidationError

from ..three_joint_arm import TICKS, N, refused, scenario, simulation

FIRST, END = 100, 130  # ticks with the fault, at 100 Hz; the lit light source changes meanwhile
CONTENT = (
    *PROBE_FIELDS,
    "reference_voltages",
    "diode_currents",
    "lit_sources",
    "supply_voltages",
    "temperatures",
    "at_home",
)
TIMES = ("exposure_offsets", "exposure_spans", "stamp_uncertainties", "stamp_limits")
FIELDS = (*CONTENT, "numbers", "stamps_ns", *TIMES)  # of the scans
PUBLISHED = ("statuses", "sent", "latencies_ns")  # beside them


def fault(kind: str, **entries: Any) -> dict[str, Any]:
    """Return an entry of ``faults`` for the shoulder, which has gap probes and a light ring."""
    times = {"from": quantity(FIRST / 100, "s"), "until": quantity(END / 100, "s")}
    return {"joint": "shoulder", "kind": kind, **times, **entries}


def channels(arm: ArmSimulation) -> tuple[str, str]:
    gap, diodes = arm.calibrations["shoulder"].sensors
    assert isinstance(gap, GapProbesCalibration)
    assert isinstance(diodes, DiodesCalibration)
    return gap.probes[0].name, diodes.diodes[0].name


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[ArmSimulation, SimulatedScans]:
    arm = simulation(tmp_path_factory.mktemp("sound"), Imperfections.only("noise"))
    return arm, arm.scans("shoulder", TICKS)


def changed_fields(scans: SimulatedScans, sound: SimulatedScans) -> set[str]:
    """Return the fields that differ during the fault; check that nothing differs outside of it."""
    during = np.zeros(N, dtype=bool)
    during[FIRST:END] = True
    out = set()
    pairs = [(name, getattr(scans.scans, name), getattr(sound.scans, name)) for name in FIELDS]
    pairs += [(name, getattr(scans, name), getattr(sound, name)) for name in PUBLISHED]
    for name, found, plain in pairs:
        expected = np.broadcast_to(plain, found.shape) if plain.size else np.zeros(found.shape)
        assert np.array_equal(found[~during], expected[~during], equal_nan=True)
        if not np.array_equal(found[during], expected[during], equal_nan=True):
            out.add(name)
    return out


MOVED = {"gap_voltages", "diode_currents", "lit_sources"}
CASES: list[tuple[str, dict[str, Any], set[str]]] = [
    ("off", {}, {"sent"}),
    ("late", {"size": quantity(0.5, "s")}, {"latencies_ns"}),
    ("stuck", {"channel": "gap"}, {"gap_voltages"}),
    ("frozen", {}, {"gap_voltages", "diode_currents", "lit_sources"}),
    ("frozen_diodes", {}, {"diode_currents", "lit_sources"}),
    ("garbage", {"channel": "gap", "size": quantity(5.0, "V")}, {"gap_voltages"}),
    ("nan", {"channel": "diode", "contact": "B"}, {"diode_currents"}),
    ("offset", {"channel": "gap", "size": quantity(0.1, "V")}, {"gap_voltages"}),
    ("value", {"channel": "gap", "size": quantity(0.0, "V")}, {"gap_voltages"}),
    ("dark", {"channel": "diode"}, {"diode_currents"}),
    ("slip", {"size": quantity(1, "1")}, {"lit_sources"}),
    ("supply", {"size": quantity(16.0, "V")}, {"supply_voltages"}),
    ("temperature", {"size": quantity(313.0, "K")}, {"temperatures"}),
    ("ambient", {"size": quantity(4e-7, "A")}, {"diode_currents"}),
    ("gain", {"size": quantity(0.05, "1")}, {"gap_voltages"}),
    ("status", {"size": quantity(1, "1")}, {"statuses"}),
    ("home", {}, {"statuses", "at_home"}),
    ("clock", {"size": quantity(3600.0, "s")}, {"stamps_ns"}),
    ("number", {"size": quantity(-7, "1")}, {"numbers"}),
    ("arrival", {"size": quantity(2e-3, "s")}, {"stamps_ns", "stamp_uncertainties", "stamp_limits"}),
    ("burst", {"size": quantity(4, "1")}, {"stamps_ns", "stamp_uncertainties", "stamp_limits"}),
    ("late_scan", {"size": quantity(2, "1")}, {*MOVED, "numbers", "stamps_ns"} - {"lit_sources"}),
    ("restart", {"size": quantity(-0.02, "s")}, {"numbers", "stamps_ns"}),
    ("aged", {"size": quantity(0.04, "s")}, MOVED),
    (
        "multiplexed",
        {"size": quantity(1e-4, "s")},
        {"gap_voltages", "diode_currents", "exposure_spans", "exposure_offsets"},
    ),
    (
        "multiplexed_unknown",
        {"size": quantity(1e-4, "s")},
        {*MOVED, "exposure_spans", "exposure_offsets"} - {"lit_sources"},
    ),
    ("multiplexed_unstated", {"size": quantity(1e-4, "s")}, {"gap_voltages", "diode_currents"}),
    ("repeat", {}, {*MOVED, "numbers", "stamps_ns"}),
]


def test_a_fault_of_a_whole_cycle_restarts_in_each_cycle(sound: tuple[ArmSimulation, SimulatedScans]) -> None:
    arm, _ = sound
    cycle = arm.scenario.cycle_ticks
    always = {"from": quantity(0.0, "s"), "until": quantity(cycle / 100, "s")}
    faulty = arm.with_faults([SimulatedFault.model_validate(fault("frozen") | always)])
    ticks = np.arange(cycle - 3, cycle + 3)
    together = faulty.scans("shoulder", ticks).scans.gap_voltages
    alone = [faulty.scans("shoulder", ticks[n : n + 1]).scans.gap_voltages[0] for n in range(6)]
    assert np.array_equal(together, alone)
    assert not np.array_equal(together[2], together[3])


def test_every_kind_has_a_case() -> None:
    assert {kind for kind, *_ in CASES} == set(KINDS)


@pytest.mark.parametrize(("kind", "entries", "fields"), CASES, ids=[kind for kind, *_ in CASES])
def test_a_fault_changes_its_fields_at_its_time(
    sound: tuple[ArmSimulation, SimulatedScans], kind: str, entries: dict[str, Any], fields: set[str]
) -> None:
    arm, expected = sound
    names = dict(zip(("gap", "diode"), channels(arm), strict=True))
    if "channel" in entries:
        entries = {**entries, "channel": names[entries["channel"]]}
    faulty = arm.with_faults([SimulatedFault.model_validate(fault(kind, **entries))])
    scans = faulty.scans("shoulder", TICKS)
    assert changed_fields(scans, expected) == fields
    delays = [faulty.latency_ns("shoulder", tick) for tick in (FIRST - 1, FIRST, END - 1, END)]
    assert delays == scans.latencies_ns[[FIRST - 1, FIRST, END - 1, END]].tolist()
    one = faulty.scans("shoulder", TICKS[FIRST + 3 : FIRST + 4])
    pairs = [(getattr(one.scans, name)[0], getattr(scans.scans, name)[FIRST + 3]) for name in FIELDS]
    pairs += [(getattr(one, name)[0], getattr(scans, name)[FIRST + 3]) for name in PUBLISHED]
    for alone, among_others in pairs:  # a scan does not depend on which other scans are asked for
        assert np.array_equal(alone, among_others, equal_nan=True)


def test_a_repeated_scan_is_that_of_the_beginning(sound: tuple[ArmSimulation, SimulatedScans]) -> None:
    arm, expected = sound
    faulty = arm.with_faults([SimulatedFault.model_validate(fault("repeat"))])
    scans = faulty.scans("shoulder", TICKS[FIRST:END])
    for name in (*CONTENT, "numbers", "stamps_ns"):
        np.testing.assert_array_equal(
            getattr(scans.scans, name), [getattr(expected.scans, name)[FIRST]] * (END - FIRST)
        )
    assert np.all(scans.statuses == expected.statuses[FIRST])


def test_sizes_of_faults(tmp_path: Path, sound: tuple[ArmSimulation, SimulatedScans]) -> None:
    arm, expected = sound
    gap, diode = channels(arm)
    faults = [
        fault("offset", channel=gap, size=quantity(0.1, "V")),
        fault("stuck", channel=diode),
        fault("slip", size=quantity(2, "1")),
        fault("clock", size=quantity(-2.0, "s")),
        fault("home"),
    ]
    scans = simulation(tmp_path, Imperfections.only("noise"), {**scenario(), "faults": faults}).scans("shoulder", TICKS)
    part = slice(FIRST, END)
    assert np.allclose(scans.scans.gap_voltages[part, 0] - expected.scans.gap_voltages[part, 0], 0.1, atol=1e-12)
    assert np.all(scans.scans.diode_currents[part, 0] == expected.scans.diode_currents[FIRST, 0])
    diodes = arm.calibrations["shoulder"].sensors[1]
    assert isinstance(diodes, DiodesCalibration)
    count = len(diodes.light_sources)
    assert np.array_equal(scans.scans.lit_sources[part], (expected.scans.lit_sources[part] + 2) % count)
    assert np.all(expected.scans.stamps_ns[part] - scans.scans.stamps_ns[part] == 2 * NS)
    assert np.all(scans.statuses[part] & HOME_BUMP)


@pytest.mark.parametrize("order", [1, -1])
def test_an_exchanged_scan_leaves_other_faults_of_the_joint(
    sound: tuple[ArmSimulation, SimulatedScans], order: int
) -> None:
    arm, expected = sound
    offset = fault("offset", channel=channels(arm)[0], size=quantity(0.5, "V"))
    both = [offset, fault("late_scan", size=quantity(2, "1"))][::order]
    scans = arm.with_faults([SimulatedFault.model_validate(each) for each in both]).scans("shoulder", TICKS)
    change = scans.scans.gap_voltages[FIRST + 3 : END, 0] - expected.scans.gap_voltages[FIRST + 3 : END, 0]
    assert np.allclose(change, 0.5, rtol=0.0, atol=1e-12)


def test_a_scan_from_before_time_zero(sound: tuple[ArmSimulation, SimulatedScans]) -> None:
    aged = fault("aged", size=quantity(0.5, "s")) | {"from": quantity(0.0, "s")}
    faulty = sound[0].with_faults([SimulatedFault.model_validate(aged)])
    assert np.isfinite(faulty.scans("shoulder", np.arange(3)).scans.gap_voltages).all()


@pytest.mark.parametrize(
    ("kind", "size", "unit", "expected"),
    [
        ("status", -1, "1", "a whole number of 0 to 4.29497e+09"),
        ("status", 1e10, "1", "a whole number of 0 to 4.29497e+09"),
        ("slip", 0.5, "1", "a whole number of -1e+06 to 1e+06"),
        ("late", -0.5, "s", "0 to 3600"),
        ("clock", 1e300, "s", "-1e+08 to 1e+08"),
        ("burst", 0, "1", "a whole number of 1 to 1000"),
    ],
)
def test_a_size_that_no_scan_can_have_is_refused(kind: str, size: float, unit: str, expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        SimulatedFault.model_validate(fault(kind, size=quantity(size, unit)))
    assert expected in str(caught.value)


def test_faults_of_time(sound: tuple[ArmSimulation, SimulatedScans]) -> None:
    tick_ns, part = NS // 100, slice(FIRST, END)
    sizes = {"arrival": (2e-3, "s"), "burst": (4, "1"), "late_scan": (2, "1"), "restart": (-0.02, "s")}
    sizes["aged"] = (0.04, "s")
    arm, expected = sound[0], sound[1].scans

    def published(kind: str) -> Any:
        entry = SimulatedFault.model_validate(fault(kind, size=quantity(*sizes[kind])))
        return arm.with_faults([entry]).scans("shoulder", TICKS).scans

    late = (published("arrival").stamps_ns - expected.stamps_ns)[part] * 1e-9
    assert 1e-3 < np.std(late) < 3e-3
    behind = np.divmod(published("burst").stamps_ns - expected.stamps_ns, tick_ns)
    assert behind[0][part].tolist() == [3 - n % 4 for n in range(FIRST, END)]
    assert behind[1][part].tolist() == [10_000 * (n % 4) for n in range(FIRST, END)]
    assert published("late_scan").numbers[FIRST : FIRST + 4].tolist() == [FIRST + 1, FIRST + 2, FIRST, FIRST + 3]
    restart = published("restart")
    assert restart.numbers[part].tolist() == list(range(END - FIRST))
    assert np.all(expected.stamps_ns[part] - restart.stamps_ns[part] == 2 * tick_ns)
    np.testing.assert_array_equal(published("aged").gap_voltages[part], expected.gap_voltages[FIRST - 4 : END - 4])


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (fault("melted"), "kind"),
        (fault("offset", size=quantity(0.1, "V")), "expected the name of a probe or diode"),
        (fault("offset", channel="nobody", size=quantity(0.1, "V")), "joint 'shoulder' has no probe 'nobody'"),
        (fault("supply", size=quantity(16.0, "K")), "expected one number, unit 'V'"),
        (fault("offset", channel="gap_1", size=quantity(0.1, "A")), "expected 'V'"),
        (fault("off", size=quantity(1.0, "s")), "expected none for 'off'"),
        (fault("stuck", channel="nobody"), "joint 'shoulder' has no probe 'nobody'"),
        ({**fault("off"), "until": quantity(99.0, "s")}, "expected at most 8 s"),
        ({**fault("off"), "joint": "knee"}, "joint 'knee'"),
        ({**fault("slip", size=quantity(1, "1")), "joint": "base"}, "joint 'base' has no light sources"),
    ],
)
def test_a_wrong_fault_is_refused(tmp_path: Path, entry: dict[str, Any], message: str) -> None:
    error = str(refused(tmp_path, {**scenario(), "faults": [entry]}))
    assert message in error
    assert "faults[0]" in error
