# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Health tests of arms that age, with the independent truth: a few months here, 100 years by ``make health``."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from posor.chain.arm_file import load_arm_file
from posor.errors import DataFileError, FitError, OutputError
from posor_bringup.health_command import NO_VERDICT, main
from posor_calibration.health.health_chart import chart_tests
from posor_calibration.health.health_history import HealthHistory, read_history, write_history
from posor_calibration.health.health_report import HealthReport
from posor_calibration.health.health_test import ANGLE, HealthTest
from posor_lab.arm_study.tracker_recording import write_calibration_recording
from posor_lab.health.ageing_arm import Ageing, AgeingArm
from posor_lab.health.health_study_command import BEGIN, BUMP, CREEP, run_case

ARM, POSES = "five_axis", 8
SHIFT = BUMP * np.array([0.36, 0.48, 0.8])
CASES = {
    "gap gap_2 of elbow": Ageing(BEGIN, creeps={("elbow", 1): CREEP}),
    "ring ring_1 of wrist_yaw": Ageing(BEGIN, creeps={("wrist_yaw", 3): CREEP}),
    "beam upper_arm": Ageing(BEGIN, bumps={"upper_arm": SHIFT}),
}
OFFLINE = ["--temperature-deviation", "0.2"]


@pytest.fixture(scope="module")
def arm() -> AgeingArm:
    return AgeingArm(ARM, POSES, 1985)


@pytest.fixture(scope="module")
def creeping(arm: AgeingArm) -> HealthHistory:
    """Months of an arm whose probe creeps."""
    return arm.history(arm.tests(7, BEGIN + 4, CASES["gap gap_2 of elbow"]))


@pytest.mark.parametrize("part", CASES)
def test_a_change_is_found_with_the_next_test_and_its_part_is_named(part: str) -> None:
    found = run_case(ARM, (part, CASES[part]), BEGIN + 1, 11)
    assert found.right
    assert found.named[0].startswith(part)
    assert found.months == 1


def test_a_sound_arm_gives_no_alarm() -> None:
    assert run_case(ARM, ("", Ageing()), 12, 5).alarms == 0


def test_an_arm_anywhere_within_its_stated_uncertainties_gives_no_more_alarms_than_stated(
    arm: AgeingArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parameters are drawn anew in each test; a chart that knows the noise alone would give alarms."""
    tests, random = [next(arm.tests(1, 1))] * 120, np.random.default_rng(4)
    model = arm.model(tests[0])
    root = np.hstack([np.linalg.cholesky(model.noise(tests[0])), model.stated])
    alarms = {}
    for name, stated in (("stated", model.stated), ("noise alone", 0.0 * model.stated)):
        drawn = iter(random.normal(size=(len(tests), root.shape[1])) @ root.T)
        monkeypatch.setattr(model, "observe", lambda _, drawn=drawn: next(drawn))
        monkeypatch.setattr(model, "stated", stated)
        alarms[name] = len(chart_tests(model, tests, false_alarm=0.05).alarms)
    assert alarms["stated"] <= 0.05 * len(tests)
    assert alarms["noise alone"] > 0.5 * len(tests)


def test_tests_that_observe_nothing_have_no_verdict(arm: AgeingArm, monkeypatch: pytest.MonkeyPatch) -> None:
    tests = [next(arm.tests(1, 1))] * 4
    model = arm.model(tests[0])
    noise = model.noise(tests[0])
    monkeypatch.setattr(model, "noise", lambda _: 1e12 * noise)  # as of uncertainties in um taken for m
    with pytest.raises(FitError, match="the tests observe no change of"):
        chart_tests(model, tests)


def test_the_change_of_a_beam_is_that_of_the_truth(arm: AgeingArm) -> None:
    tests = list(arm.tests(3, BEGIN + 1, CASES["beam upper_arm"]))
    chart = chart_tests(arm.model(tests[0]), tests)
    (beam,) = [p for p, part in enumerate(chart.parts) if part.name.startswith("beam upper_arm")]
    turn = next(each.T_start_end.rotation for each in arm.health.chain.beams if each.name == "upper_arm")
    errors = chart.drifts[beam][-1] - np.concatenate([turn.T @ SHIFT, np.zeros(3)])
    assert np.abs(errors / chart.sigmas[beam][-1]).max() < 4.0
    assert chart.sigmas[beam][-1][:3].max() < 0.3 * BUMP


def test_the_creep_is_stated_with_its_rate_and_remedy(arm: AgeingArm, creeping: HealthHistory) -> None:
    report = HealthReport(ARM, chart_tests(arm.model(creeping.tests[0]), creeping.tests))
    change = report.suspects[0]
    assert (change.part, change.kind) == ("gap gap_2 of elbow", "creep")
    assert change.rate == pytest.approx(-CREEP, abs=5.0 * change.rate_sigma)  # a nearer tip reads a smaller gap
    assert change.rate_sigma < 0.1 * CREEP
    assert report.advice == "calibrate the joint elbow again."


def test_a_slow_creep_gives_no_alarm_but_a_date(arm: AgeingArm) -> None:
    tests = list(arm.tests(9, 15, Ageing(3, creeps={("elbow", 1): 5e-8})))
    report = HealthReport(ARM, chart_tests(arm.model(tests[0]), tests))
    assert not report.suspects
    assert re.match(r"calibrate before 2027-\S+: gap gap_2 of elbow then leaves", report.advice)


def test_a_history_is_read_as_it_was_written(creeping: HealthHistory, tmp_path: Path) -> None:
    path = tmp_path / "history.parquet"
    write_history(path, creeping)
    again = read_history(path)
    assert again.tests == creeping.tests
    assert (again.arm, again.identity, again.balls) == (creeping.arm, creeping.identity, creeping.balls)
    assert again.T_artefact_base.isApprox(creeping.T_artefact_base)
    before = path.read_bytes()
    write_history(path, replace(creeping, tests=creeping.tests[:3]), before)
    with pytest.raises(OutputError, match="has been changed by another program"):
        write_history(path, replace(creeping, tests=creeping.tests[:4]), before)
    assert len(read_history(path).tests) == 3
    assert list(tmp_path.iterdir()) == [path]


def changed(test: HealthTest, change: Callable[[int, str], float], *, sigma: float = 1.0) -> HealthTest:
    """Return a test a month later; ``change``: of each number, by its place and quantity."""
    numbers = [
        each._replace(value=each.value + change(n, each.quantity), sigma=each.sigma * sigma)
        for n, each in enumerate(test.numbers)
    ]
    return HealthTest(test.stamp_ns + 10**15, tuple(numbers))


MISTAKES: dict[str, tuple[Callable[[HealthTest], HealthTest], str]] = {
    "earlier": (lambda t: replace(t, stamp_ns=t.stamp_ns - 1), r"the test is of 2026-\S+; expected a test after"),
    "again": (lambda t: t, r"the test is of 2026-\S+; expected a test after"),
    "dwell missing": (
        lambda t: HealthTest(t.stamp_ns + 1, tuple(n for n in t.numbers if n.pose < POSES)),
        r"x of ball at dwell 8 is missing",
    ),
    "posture": (
        lambda t: changed(t, lambda n, quantity: 0.1 if quantity == ANGLE and n == 1 else 0.0),
        r"joint 'shoulder' is at \S+ rad at dwell 1; expected \S+ within 0.02",
    ),
    "beside the seat": (
        lambda t: changed(t, lambda _, quantity: 1e-3 if quantity == "y" else 0.0),
        r"y of ball at dwell 1 is 1 mm from the first test; expected at most 0.5 mm",
    ),
    "not finite": (lambda t: changed(t, lambda n, _: np.nan if n > 5 else 0.0), r"a number that is not finite"),
    "clock not set": (lambda t: replace(t, stamp_ns=10**15), r"the test is of 1970-\S+; expected a clock that was set"),
    "no noise": (lambda t: changed(t, lambda *_: 0.0, sigma=0.0), r"or no noise"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_test_that_does_not_belong_to_the_history_is_refused(creeping: HealthHistory, name: str) -> None:
    mistake, sentence = MISTAKES[name]
    first = replace(creeping, tests=creeping.tests[:1])
    with pytest.raises(DataFileError, match=sentence):
        first.with_test(mistake(creeping.tests[0]), "bag")


def test_a_posture_near_half_a_turn_is_the_same_on_both_sides(creeping: HealthHistory) -> None:
    def at(test: HealthTest, angle: float) -> HealthTest:
        numbers = [each._replace(value=angle) if each.quantity == ANGLE else each for each in test.numbers]
        return replace(test, numbers=tuple(numbers))

    first = replace(creeping, tests=(at(creeping.tests[0], np.pi - 1e-4),))
    assert len(first.with_test(at(creeping.tests[1], 1e-4 - np.pi), "bag").tests) == 2


def test_the_program_judges_a_history_and_writes_its_page(
    creeping: HealthHistory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "history.parquet"
    options = [ARM, "--history", str(path), *OFFLINE, "--output", str(tmp_path / "page")]
    for count, code in ((2, 4), (BEGIN, 0), (len(creeping.tests), 3)):
        write_history(path, replace(creeping, tests=creeping.tests[:count]))
        assert main(options) == code
    assert "2 tests of five_axis: 2 more and there is a verdict" in capsys.readouterr().out
    content = json.loads((tmp_path / "page" / "report.json").read_text(encoding="utf-8"))
    assert content["suspects"][0] == "gap gap_2 of elbow"
    assert "gap gap_2 of elbow" in (tmp_path / "page" / "report.html").read_text(encoding="utf-8")


def test_histories_of_other_arms_or_files_and_damaged_ones_are_refused(
    creeping: HealthHistory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "history.parquet"
    options = ["--history", str(path), "--output", str(tmp_path / "page")]
    write_history(path, creeping)
    whole = path.read_bytes()
    table = pyarrow.parquet.read_table(path)
    about = json.loads(table.schema.metadata[b"posor_health"])

    def with_about(**changes: object) -> None:
        """Write a history whose metadata are invalid."""
        metadata = {"posor_health": json.dumps({**about, **changes})}
        pyarrow.parquet.write_table(table.replace_schema_metadata(metadata), path)

    other = replace(creeping.identity, calibrations={**creeping.identity.calibrations, "elbow": "0" * 16})
    refused: dict[str, tuple[str, Callable[[], object]]] = {
        "is the history of arm 'five_axis'; expected that of 'six_axis'": ("six_axis", lambda: None),
        "calibration of elbow is": (ARM, lambda: write_history(path, replace(creeping, identity=other))),
        "is not a whole history": (ARM, lambda: path.write_bytes(whole[: len(whole) // 2])),
        "is not a whole": (ARM, lambda: with_about(T_artefact_base=[0.0] * 7)),
        "is not a whole h": (ARM, lambda: with_about(balls=[1])),
        "not a whole": (ARM, lambda: pyarrow.parquet.write_table(table.slice(0, 0), path)),
        "not a whole history": (ARM, lambda: pyarrow.parquet.write_table(pa.table({"a": [1]}), path)),
        "does not exist": (ARM, path.unlink),
    }
    for sentence, (name, damage) in refused.items():
        damage()
        assert main([name, *options]) == 1
        assert sentence in capsys.readouterr().err
    assert main([ARM, *options, "--bag", "b"]) == 2
    assert "--bag alone; expected --bag, --table and --map together" in capsys.readouterr().err


def test_the_program_makes_a_history_from_a_bag_and_adds_no_test_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files, path = tmp_path / "files", tmp_path / "history.parquet"
    write_calibration_recording(load_arm_file(ARM), files, 4, 3)
    options = [str(files / "arm.yaml"), "--history", str(path), "--output", str(tmp_path / "page")]
    seen = ["--bag", str(files / "bag"), "--table", str(files / "tracker.csv"), "--map", str(files / "map.yaml")]
    balls = {"smr1": "0,0,0.05", "smr2": "0,0.08,0", "smr3": "0.1,0,0.02"}
    for name, place in balls.items():
        seen += ["--uncertainty", f"{name}=15e-6,6e-6", "--tool", f"{name}={place}"]
    assert main([*options, *seen]) == NO_VERDICT
    (test,) = read_history(path).tests
    places = [each.value for each in test.numbers if each.part in balls]
    residuals = [each.value / each.sigma for each in test.numbers if each.part not in balls and each.sigma]
    assert len(places) == 4 * 3 * 3
    assert np.abs(places).max() < 3e-3  # the balls are 1 mm beside their drawing, the beams as assembled
    assert np.abs(residuals).max() < 100.0  # noise and calibration errors
    before = path.read_bytes()
    assert main([*options, *seen]) == 1
    assert re.search(r"expected a test after the last one", capsys.readouterr().err)
    assert path.read_bytes() == before
    lines = (files / "tracker.csv").read_text(encoding="utf-8").splitlines()
    now_ns = time.time_ns()
    with monkeypatch.context() as patch:
        patch.setattr(time, "time_ns", lambda: now_ns - 100 * 366 * 86_400 * 10**9)
        path.rename(files / "former.parquet")
        assert main([*options, *seen]) == 1
        assert "expected one before now" in capsys.readouterr().err
        (files / "former.parquet").rename(path)
    path.unlink()
    rows = [line.split(";") for line in lines]
    mistakes = {
        "m from its seat; expected at most 0.01 m: perhaps rows, seats": [
            [time_s, *places]
            for (time_s, *_), (_, *places) in zip(rows, [rows[0], rows[2], rows[1], *rows[3:]], strict=True)
        ],
        "m from its seat; expected at most 0.01": [
            rows[0],
            *([each[c] if c % 3 < 2 else rows[1][c] for c in range(10)] for each in rows[1:]),
        ],
        "0.001 times those of the arm": [
            rows[0],
            *([time_s, *(f"{1e-3 * float(x):.9f}" for x in places)] for time_s, *places in rows[1:]),
        ],
    }
    for sentence, table in mistakes.items():
        (files / "tracker.csv").write_text("\n".join(map(";".join, table)) + "\n", encoding="utf-8")
        assert main([*options, *seen]) == 1
        assert sentence in capsys.readouterr().err
    assert not path.exists()
    (files / "tracker.csv").write_text("\n".join(lines[:4]) + "\n", encoding="utf-8")
    assert main([*options, *seen]) == 1
    assert "3 dwells; expected at least 4 in postures that differ" in capsys.readouterr().err
