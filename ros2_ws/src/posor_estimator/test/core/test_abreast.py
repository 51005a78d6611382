"""Scans of several POSORs at once: the same bytes as of each alone, whatever happens to any of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.abreast import LEAST, LONGEST_ALONE, Abreast, design_of
from posor_estimator.core.calibration.model import calibration_from
from posor_estimator.core.compiled import COMPILING, EIGHT
from posor_estimator.core.designs import design
from posor_estimator.core.fault import State
from posor_estimator.core.kernels.diode import DOMAIN, SUMS
from posor_estimator.core.kernels.tables import CHANNELS, DIODES, MEMORY
from posor_estimator.core.kernels.voltage import COLUMNS, LOWEST
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import Records
from posor_estimator.core.warm_up import OF_A_POSE
from posor_estimator.testing.twice import COUNT, CURRENTS, GAPS, LIT, TICK_NS, Joints, joints, sized

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import ByteArray

pytestmark = pytest.mark.skipif(not COMPILING, reason="without numba every POSOR is located alone")


@pytest.mark.parametrize("number", [LEAST, 5, EIGHT])
@pytest.mark.parametrize("motion", [False, True], ids=["free", "limited"])
def test_scans_abreast_give_the_bytes_of_scans_alone(
    monkeypatch: pytest.MonkeyPatch,
    number: int,
    motion: bool,  # noqa: FBT001  a parameter of the test
) -> None:
    made = joints([design("triad_diodes", motion=motion)] * number)
    states, alone = made.located(monkeypatch)
    assert (states == State.OK).all()
    assert alone <= LEAST


def test_posors_of_other_sizes_and_with_other_sources_lit_go_abreast(monkeypatch: pytest.MonkeyPatch) -> None:
    made = joints(sized(), spin=1.8)
    lit = [raw[:, LIT : LIT + 2] for raw in made.raw]
    other = np.any([np.diff(each, axis=0).any(axis=1) for each in lit], axis=0)
    assert np.count_nonzero(other) > 10
    assert len({each[0].tobytes() for each in lit}) > 2
    states, alone = made.located(monkeypatch)
    assert (states == State.OK).all()
    assert alone < np.count_nonzero(other) / 2  # some stand near one another


def nan_voltage(raw: ByteArray) -> None:
    raw.view(np.float64)[100, GAPS + 1] = math.nan


def voltage_out_of_range(raw: ByteArray) -> None:
    raw.view(np.float64)[100:103, GAPS] = 50.0


def dark(raw: ByteArray) -> None:
    raw.view(np.float64)[100, CURRENTS : CURRENTS + 4] = 0.0


def moved_spot(raw: ByteArray) -> None:
    raw.view(np.float64)[100, CURRENTS : CURRENTS + 2] *= 1.2


def beyond_the_map(raw: ByteArray) -> None:
    raw.view(np.float64)[100, CURRENTS] *= 60.0


def jump(raw: ByteArray) -> None:
    raw.view(np.float64)[100:, GAPS : GAPS + 3] += 0.4


def no_stamp(raw: ByteArray) -> None:
    raw.view(np.int32)[100, :2] = 0


def stamps_stand_still(raw: ByteArray) -> None:
    raw.view(np.int32)[101, :2] = raw.view(np.int32)[100, :2]


def stamps_go_back(raw: ByteArray) -> None:
    raw.view(np.int32)[100:, 0] -= 1


def gap_in_time(raw: ByteArray) -> None:
    raw.view(np.int32)[100:, 0] += 2


def home_seen(raw: ByteArray) -> None:
    raw.view(np.int32)[100, 4] = 1


def other_status(raw: ByteArray) -> None:
    raw.view(np.int32)[100, 4] = 2


def unknown_source(raw: ByteArray) -> None:
    raw[100, LIT] = 200


def other_source(raw: ByteArray) -> None:
    raw[100, LIT] = 1


def long_fault(raw: ByteArray) -> None:
    raw.view(np.float64)[60:400, GAPS] = math.nan


def measured_supply(raw: ByteArray) -> None:
    raw.view(np.float64)[:, 18] = 15.01
    raw.view(np.float64)[::3, 19] = 294.0
    raw.view(np.float64)[::7, 18] = math.inf


FAULTS = [
    nan_voltage,
    voltage_out_of_range,
    dark,
    moved_spot,
    beyond_the_map,
    jump,
    no_stamp,
    stamps_stand_still,
    stamps_go_back,
    gap_in_time,
    home_seen,
    other_status,
    unknown_source,
    other_source,
    long_fault,
    measured_supply,
]
HARMLESS = {gap_in_time, home_seen, other_status, measured_supply, stamps_go_back, stamps_stand_still}
LASTING = {jump, long_fault}


@pytest.mark.parametrize("victim", [0, 2])
@pytest.mark.parametrize("motion", [False, True], ids=["free", "limited"])
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_with_one_is_said_of_it_as_alone_and_harms_no_other(
    monkeypatch: pytest.MonkeyPatch,
    fault: Callable[[ByteArray], None],
    motion: bool,  # noqa: FBT001  a parameter of the test
    victim: int,
) -> None:
    made = joints([design("triad_diodes", motion=motion)] * 4)
    fault(made.raw[victim])
    states, alone = made.located(monkeypatch)
    others = np.delete(states, victim, axis=0)
    assert (others == State.OK).all()
    assert (states[victim] != State.OK).any() == (fault not in HARMLESS and (motion or fault is not jump))
    assert alone < (COUNT if fault in LASTING else 24)


@pytest.mark.parametrize("which", ["least volts", "most volts", "least sum", "most sum", "least ratio", "most ratio"])
def test_a_range_ends_for_all_where_it_ends_for_one(monkeypatch: pytest.MonkeyPatch, which: str) -> None:
    made = joints([design("triad_diodes")] * LEAST, count=80)
    raw = made.raw[0].view(np.float64)
    plus, minus = raw[:, CURRENTS + 1], raw[:, CURRENTS + 3]
    tables = made.records()[0].tables
    order = tables.of_floats(CHANNELS).shape[1] - COLUMNS
    shift = float(tables.of_floats(CHANNELS)[1, order])
    found, *place = {
        "volts": (raw[:, GAPS + 1] + shift, CHANNELS, 1, order + LOWEST),
        "sum": (plus + minus, DIODES, 0, SUMS),
        "ratio": ((plus - minus) / (plus + minus), DIODES, 0, DOMAIN + 2),
    }[which.split()[1]]
    first = int(which.startswith("most"))
    made.limits = [(place[0], place[1], place[2] + first, float(np.median(found)))]
    states, _ = made.located(monkeypatch, counts=(80,))
    assert 20 < np.count_nonzero(states[0] == State.LOST) < 60
    assert (states[1:] == State.OK).all()


def test_a_long_stretch_of_faults_is_located_alone_in_few_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    made = joints([design("triad_diodes")] * LEAST)
    for raw in made.raw:
        raw.view(np.float64)[:, GAPS] = math.nan
    calls = 0
    locate = Records.locate

    def counted(records: Records, raw: ByteArray, out: ByteArray) -> None:
        nonlocal calls
        calls += 1
        locate(records, raw, out)

    records, out = made.records(), np.zeros((LEAST, COUNT, OF_A_POSE.size), dtype=np.uint8)
    monkeypatch.setattr(Records, "locate", counted)
    Abreast(records).locate(made.raw, list(out))
    assert calls <= LEAST * (COUNT // LONGEST_ALONE + 8)
    assert (out[:, :, OF_A_POSE.state] == State.LOST).all()


def test_where_other_sources_are_lit_all_the_time_most_scans_go_alone_in_few_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = joints([design("triad_light_ring")] * 4, spin=2.0)
    for turn, raw in enumerate(made.raw):
        raw[:] = raw[(np.arange(COUNT) + 5 * turn) // 3 % 2 * 299]  # two poses whose sources are others, in turns
        raw.view(np.int32)[:, 0], raw.view(np.int32)[:, 1] = 1, np.arange(1, COUNT + 1) * TICK_NS
    assert not np.array_equal(made.raw[0][0, LIT : LIT + 2], made.raw[0][3, LIT : LIT + 2])
    _, alone = made.located(monkeypatch)
    assert alone > 0.9 * COUNT


def test_what_raises_half_way_leaves_each_posor_at_its_last_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    made = joints([design("triad_diodes")] * LEAST, count=120)
    made.raw[1].view(np.float64)[80, GAPS] = math.nan
    locate, abreast, alone = Records.locate, made.records(), made.records()
    victim = abreast[0]

    def failing(records: Records, raw: ByteArray, out: ByteArray) -> None:
        if records is victim and (raw[0] == made.raw[0][80]).all():
            raise KeyboardInterrupt
        locate(records, raw, out)

    out = np.zeros((LEAST, 120, OF_A_POSE.size), dtype=np.uint8)
    monkeypatch.setattr(Records, "locate", failing)
    with pytest.raises(KeyboardInterrupt):
        Abreast(abreast).locate(made.raw, list(out))
    for records, raw, poses, stopped in zip(alone, made.raw, out, abreast, strict=True):
        locate(records, raw[:80], poses[:80])
        assert stopped.tables.of_floats(MEMORY).tobytes() == records.tables.of_floats(MEMORY).tobytes()


def test_scans_come_in_as_many_calls_as_one_likes(monkeypatch: pytest.MonkeyPatch) -> None:
    made = joints(sized(), count=300)
    made.raw[1].view(np.float64)[37, GAPS] = math.nan
    states, _ = made.located(monkeypatch, counts=(1, 7, 0, 42, 50))
    assert np.count_nonzero(states == State.LOST) == 1


@pytest.mark.parametrize("kind", [0, 1, 2], ids=["random", "systematic", "total"])
def test_the_covariance_is_of_the_kind_that_is_wanted(monkeypatch: pytest.MonkeyPatch, kind: int) -> None:
    made = joints([design("triad_diodes")] * LEAST, count=60)
    made.columns = [replace(columns, kind=kind) for columns in made.columns]
    made.located(monkeypatch, counts=(60,))


def test_posors_go_abreast_with_those_of_their_design_only() -> None:
    made = joints([*sized((8.0, 4.0)), design("triad_diodes"), design("triad_diodes", motion=True)], count=1)
    designs = [design_of(records) for records in made.records()]
    assert None not in designs
    assert designs[0] == designs[1]
    assert designs[2] == designs[3] != designs[0]


def certain_of(probe: int) -> Calibration:
    """Return a design of which the zero shift of one probe is exact: as many parameters as with another one, others."""
    content = design("triad_diodes").model_dump()
    content["sensors"][0]["probes"][probe]["zero_shift"]["sigma"] = 0.0
    return calibration_from(content)


def test_posors_whose_calibrations_leave_other_numbers_uncertain_are_not_taken_for_one_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = joints([certain_of(0), certain_of(1), certain_of(0)], count=60)
    designs = {design_of(records) for records in made.records()}
    assert len(designs) == 1
    states, _ = made.located(monkeypatch, counts=(60,))
    assert (states == State.OK).all()


def unfit(made: Joints) -> Records:
    return Records(Posor(made.calibrations[0]), made.columns[0], np.zeros(OF_A_POSE.size, dtype=np.uint8), fit=False)


def of_another_kind(made: Joints, **changed: Any) -> Records:
    columns = replace(made.columns[0], **changed)
    return Records(Posor(made.calibrations[0]), columns, np.zeros(OF_A_POSE.size, dtype=np.uint8))


@pytest.mark.parametrize(
    "records",
    [
        unfit,
        lambda made: of_another_kind(made, gaps=(24, 2)),
        lambda made: of_another_kind(made, currents=(80, 4)),
        lambda made: of_another_kind(made, lit=(160, 1)),
        lambda _: joints([design("triad_bumpy_ring")], count=1).records()[0],
    ],
    ids=["unfit", "gaps", "currents", "lit", "ring"],
)
def test_where_scans_are_not_ordinary_or_theta_is_counted_each_goes_alone(records: Callable[[Joints], Records]) -> None:
    assert design_of(records(joints([design("triad_diodes")], count=1))) is None
