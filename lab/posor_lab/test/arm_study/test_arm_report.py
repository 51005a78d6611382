# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors, findings, page and JSON figures of constructed records."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from posor.numerics.array_types import FloatArray
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.pose_array import PoseArray
from posor_lab.accuracy.consistency import MeanEstimate
from posor_lab.arm_study.arm_budget_command import arm_budget
from posor_lab.arm_study.arm_coverage import Coverage
from posor_lab.arm_study.arm_record import (
    CHAIN,
    GIVEN_UP,
    NO_SCAN,
    TRUTH,
    ArmRecord,
    Dropouts,
    NodeCounters,
    TickOutcomes,
    count_outcomes,
    rms,
)
from posor_lab.arm_study.arm_report import ArmOutcome, arm_figures, arm_findings, arm_page
from posor_lab.arm_study.arm_run import ArmLiveTable
from posor_lab.harness.report_page import ReportPage
from posor_lab.reports.findings import Verdict
from rich.console import Console

NEAR = np.array([0.0, 0.0, 5e-6])
POSOR_OFF = np.array([3e-6, 0.0, 4e-6])
ENCODERS_OFF = np.array([0.0, 3e-4, 4e-4])
SIGMA = 5e-6


def record(
    count: int = 40,
    *,
    first: int = 100,
    off_target: FloatArray = ENCODERS_OFF,
    reasons: Mapping[int, Mapping[str, str]] | None = None,
) -> ArmRecord:
    """Return a record along a circle: POSORs 5 um off, encoders 500 um; ``reasons``: indices without a pose."""
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    place = np.column_stack([1.5 + 0.2 * np.cos(angle), 0.2 * np.sin(angle), 0.1 * np.sin(angle)])
    turn = np.column_stack([0.3 * np.sin(angle), np.zeros(count), angle])
    none = np.zeros((count, 3))
    truth = PoseArray.from_rotation_vectors(place, turn)
    posor = truth.displace(none + POSOR_OFF, none + np.array([0.0, 6e-6, 8e-6]))
    without = list(reasons or {})
    posor.translations[without], posor.rotations[without] = np.nan, np.nan
    covariances = np.tile(np.eye(6) * SIGMA**2, (count, 1, 1))
    covariances[without] = np.nan
    return ArmRecord(
        ticks=range(first, first + count),
        times_s=np.arange(count) / 200.0,
        truth=truth,
        posor=posor,
        covariances=covariances,
        encoders=truth.displace(none + ENCODERS_OFF, none + np.array([3e-4, 0.0, 0.0])),
        target=truth.displace(none - off_target, none),
        stage=none,
        reasons=tuple((reasons or {}).get(n, {}) for n in range(count)),
    )


@pytest.fixture(scope="module")
def simulation() -> ArmSimulation:
    return ArmSimulation(load_checked_arm("five_axis"))


@pytest.fixture(scope="module")
def budget(simulation: ArmSimulation) -> dict[str, Any]:
    return arm_budget(simulation.arm, 50)


def drawn(inside: float = 0.951, ratio: float = 1.001) -> Coverage:
    shifts = np.array([[0.0, 0.0, 1.5e-4], [0.0, 0.0, 1.3e-4]])
    normalised = np.random.default_rng(1).chisquare(6, 2000)
    return Coverage(
        arms=1000,
        poses=2,
        lost=0,
        inside=MeanEstimate(inside, 0.003),
        nees=MeanEstimate(6.01, 0.04),
        normalised=normalised,
        rms_m=8e-6,
        rms_without_sag_m=1.4e-4,
        shift_found_m=ratio * shifts,
        shift_predicted_m=shifts,
        shift_ratio=MeanEstimate(ratio, 0.002),
    )


@pytest.fixture(scope="module")
def outcome(budget: dict[str, Any]) -> ArmOutcome:
    return ArmOutcome(
        before=record(),
        after=record(first=150, off_target=NEAR),
        ticks=TickOutcomes(80, 80, {}, 0),
        coverage=drawn(),
        budget=budget,
    )


def failing(outcome: ArmOutcome) -> list[str]:
    return [finding.quantity for finding in arm_findings(outcome).findings if finding.verdict is Verdict.FAILS]


def test_errors_of_a_constructed_record() -> None:
    known = record(reasons={3: {"elbow": "is lost (RESIDUAL)"}})
    assert np.count_nonzero(known.has_pose) == 39
    assert rms(known.posor_errors[:, :3]) == pytest.approx(5e-6, rel=1e-9)
    assert rms(known.posor_errors[:, 3:]) == pytest.approx(1e-5, rel=1e-6)
    assert rms(known.encoder_errors[:, :3]) == pytest.approx(5e-4, rel=1e-9)
    assert known.normalised[0] == pytest.approx((5e-6**2 + 1e-5**2) / SIGMA**2, rel=1e-6)
    assert np.isnan(known.normalised[3])
    assert known.inside == 1.0
    assert known.target_distances == pytest.approx(5e-4)


def test_everything_holds(outcome: ArmOutcome) -> None:
    assert failing(outcome) == []
    assert arm_findings(outcome).holds


def test_each_figure_beyond_its_limit_fails(outcome: ArmOutcome, budget: dict[str, Any]) -> None:
    bad = record()
    worse = replace(bad, posor=bad.encoders.displace(np.full((40, 3), 1e-3), np.zeros((40, 3))))
    assert failing(replace(outcome, before=worse)) == ["endpoint minus truth, POSORs"]
    assert failing(replace(outcome, after=record(off_target=np.array([1e-3, 0.0, 0.0])))) == [
        "true endpoint minus target, with the controller"
    ]
    assert failing(replace(outcome, ticks=TickOutcomes(80, 79, {}, 1))) == ["ticks"]
    assert failing(replace(outcome, coverage=drawn(inside=0.90))) == ["poses inside their published 95 % region"]
    assert failing(replace(outcome, coverage=drawn(ratio=0.9))) == [
        "displacement left by an uncorrected sag, found over predicted"
    ]
    wrong = {**budget, "extended": {**budget["extended"], "alpha_z_urad": 6.5}}
    assert failing(replace(outcome, budget=wrong)) == ["budget, extended: about Z"]


def test_empty_outcome_does_not_hold() -> None:
    assert not arm_findings(ArmOutcome()).holds


def test_figures_of_the_json_file(outcome: ArmOutcome) -> None:
    figures = json.loads(json.dumps(arm_figures(outcome), allow_nan=False))
    for configuration in ("extended", "bent"):
        assert {"alpha_x_urad", "alpha_y_urad", "alpha_z_urad", "displacement_uin"} <= set(
            figures["budget"][configuration]
        )
    assert figures["budget"]["extended"]["alpha_z_urad"] == pytest.approx(5.77, rel=0.02)
    assert figures["coverage95"] == 0.951
    assert figures["endpoint_error_rms_m"] == pytest.approx({"posor": 5e-6, "encoder_only": 5e-4})
    assert figures["controller"]["before_rms_m"] == pytest.approx(5e-4)
    assert figures["controller"]["after_rms_m"] == pytest.approx(5e-6)
    assert figures["ticks"] == {"recorded": 80, "with_pose": 80, "without_pose_by_cause": {}, "unaccounted": 0}
    assert set(arm_figures(ArmOutcome(coverage=drawn()))) == {"coverage95", "coverage", "sag"}


def read_page(outcome: ArmOutcome, simulation: ArmSimulation) -> ReportPage:
    reader = ReportPage(arm_page(simulation.arm, simulation.scenario, outcome, arm_findings(outcome)))
    assert reader.problems == []
    return reader


def test_page_is_complete(outcome: ArmOutcome, simulation: ArmSimulation) -> None:
    reader = read_page(outcome, simulation)
    assert len(reader.data) == 13
    assert "Everything holds." in reader.texts
    (name,) = (name for name in reader.data if name.startswith("x_"))
    assert len(reader.data[name]) == 40
    for row in reader.data[name]:
        assert float(row["POSORs minus truth, x [µm]"]) == pytest.approx(3.0, rel=1e-4)
        assert float(row["published sigma [µm]"]) == pytest.approx(5.0, rel=1e-4)
    assert {finding.computed for finding in arm_findings(outcome).findings} <= set(reader.texts)
    text = " ".join(reader.texts)
    assert f"seed {simulation.scenario.seed}, 200 Hz, cycle of 10 s" in text
    assert all(simulation.arm.calibration(joint).content_hash in text for joint in simulation.joints)


def test_page_shows_the_parts_that_were_run_and_their_gaps(outcome: ArmOutcome, simulation: ArmSimulation) -> None:
    gaps = record(reasons={0: {"elbow": NO_SCAN}, 7: {CHAIN: GIVEN_UP}})
    without = read_page(replace(outcome, before=gaps, after=None), simulation)
    assert len(without.data) == 12
    assert not any("Controller:" in text for text in without.texts)
    data = without.data["Position_error_along_the_path.csv"]
    posors = [row["distance from the truth [µm]"] for row in data if row["series"].startswith("POSORs")]
    assert [n for n, cell in enumerate(posors) if not cell] == [0, 7]
    alone = read_page(ArmOutcome(coverage=outcome.coverage), simulation)
    assert len(alone.data) == 2
    assert sum(text.startswith(("Many arms:", "Sag:", "Truth, endpoint")) for text in alone.texts) == 2


def test_a_long_record_stays_a_small_page(simulation: ArmSimulation) -> None:
    long = ArmOutcome(before=record(20_001))
    assert any("(1 tick of 11)" in text for text in read_page(long, simulation).texts)


def test_a_failed_figure_says_what_it_means(outcome: ArmOutcome) -> None:
    judged = [finding for finding in arm_findings(outcome).findings if finding.verdict is Verdict.HOLDS]
    assert all(finding.if_fails and finding.if_fails not in finding.comment for finding in judged)
    failed = arm_findings(replace(outcome, ticks=TickOutcomes(80, 79, {}, 1))).findings[0]
    assert failed.comment.endswith("a message was lost on its way")


def test_a_surprising_coverage_is_explained(outcome: ArmOutcome) -> None:
    def remark(inside: float) -> str:
        findings = arm_findings(replace(outcome, coverage=drawn(inside))).findings
        return next(finding.remark for finding in findings if finding.quantity.startswith("poses inside"))

    assert "standard uncertainties from 95 %" not in remark(0.951)
    assert "3.3 standard uncertainties from 95 %: on average the published variance is" in remark(0.96)


def test_ticks_that_no_counter_explains_are_unaccounted_for(simulation: ArmSimulation) -> None:
    dropouts = Dropouts(simulation)
    tick = next(tick for tick in range(2000, 6000) if "elbow" in dropouts.dropped_joints(tick))
    assert not simulation.scans("elbow", np.array([tick])).sent[0]
    assert dropouts.dropped_joints(tick - 1) == frozenset()
    known = record(
        first=tick - 5,
        reasons={
            1: {"shoulder": NO_SCAN},
            2: {"wrist_roll": "is lost (RESIDUAL)"},
            3: {CHAIN: GIVEN_UP},
            5: {"elbow": NO_SCAN},
        },
    )
    none = dict.fromkeys(simulation.joints, 0)
    outcomes = count_outcomes([known], simulation, NodeCounters({**none, "shoulder": 1}, 3))
    assert (outcomes.ticks, outcomes.poses, outcomes.unaccounted) == (40, 36, 0)
    assert outcomes.causes == {
        "shoulder tick missed, its process was late": 1,
        "wrist_roll is lost (RESIDUAL)": 1,
        GIVEN_UP: 1,
        "elbow scan dropped by the scenario": 1,
    }
    assert "36 with a pose, 4 without (shoulder tick missed, " in outcomes.sentence
    assert count_outcomes([known], simulation, NodeCounters(none, 3)).unaccounted == 1
    assert count_outcomes([known], simulation, NodeCounters({**none, "shoulder": 1}, 2)).unaccounted == 1
    no_truth = record(reasons={4: {TRUTH: NO_SCAN}, 6: dict.fromkeys(simulation.joints, NO_SCAN)})
    assert count_outcomes([no_truth], simulation, NodeCounters(none, 0)).unaccounted == 6
    assert (
        count_outcomes([no_truth], simulation, NodeCounters({**dict.fromkeys(none, 1), "wrist_yaw": 2}, 0)).unaccounted
        == 0
    )


@pytest.mark.parametrize("terminal", [True, False])
def test_live_table_shows_the_newest_tick(*, terminal: bool) -> None:
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=terminal, width=150, highlight=False)
    with ArmLiveTable("an arm", console) as table:
        table.show_state("starting 3 nodes")
        assert "an arm: starting 3 nodes" in screen.getvalue()  # at once
        table.show_waiting("/an_arm/elbow/transform")
        assert "an arm: starting 3 nodes, waiting for /an_arm/elbow/transform" in screen.getvalue()
        table.show_state("with controller")
        table.show_tick(record(), 40, 2, 0.5)
    text = screen.getvalue()
    assert "an arm: with controller" in text
    assert "scans 40, without pose 2; speed 50 %" in text
    assert "NEES 5.0 (6 expected)" in text
    assert ("POSOR minus truth" in text) == terminal
    assert ("POSOR off 5.0 um, 10.0 urad; encoders off 500 um, 300 urad; 500 um from its target" in text) != terminal
