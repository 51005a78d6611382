# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A short run of the arm, and the judgement of scans that were missed, refused or lost."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from posor_bringup.arms import load_checked_arm
from posor_lab.benchmark.tick_statistics import TickWindow
from posor_lab.soak.process_sample import ProcessSample, growth_mb
from posor_lab.soak.soak_command import SoakFigures, SoakReceiver, main, soak_findings
from posor_ros.node_program import ros_context

RATE = 50
WINDOW = TickWindow(0, 10 * 20_000_000, RATE)
TICKS = WINDOW.stamps_ns.tolist()
SAMPLES = [ProcessSample(float(n), 100.0 + 1e-4 * n, 20, 50) for n in range(10)]


@pytest.fixture
def receiver(ros_domain: int) -> Iterator[SoakReceiver]:
    assert ros_domain
    with ros_context(["soak"]), SoakReceiver(load_checked_arm("five_axis")) as found:
        found.poses, found.states = array("q", TICKS), array("q", TICKS)
        yield found


def judge(receiver: SoakReceiver, missed: int, fewest: int = 0) -> SoakFigures:
    return receiver.figures(WINDOW, np.array([missed, *[fewest] * 4]), SAMPLES)


def test_nothing_is_lost_where_every_tick_has_pose_and_state(receiver: SoakReceiver) -> None:
    figures = judge(receiver, 0)
    assert (figures.ticks, figures.states, figures.poses, figures.lost) == (10, 10, 10, 0)
    assert soak_findings(figures).holds


def test_a_tick_without_a_state_is_lost_unless_all_drivers_missed_it(receiver: SoakReceiver) -> None:
    receiver.poses.remove(TICKS[3])
    receiver.states.remove(TICKS[3])
    assert judge(receiver, 1, 1).lost == 0
    assert judge(receiver, 1, 0).lost_states == 1


def test_a_state_explains_a_missing_pose(receiver: SoakReceiver) -> None:
    receiver.poses.remove(TICKS[4])
    figures = judge(receiver, 0)
    assert figures.lost_poses == 1
    assert not soak_findings(figures).holds
    receiver.reasons[TICKS[4]] = "elbow is lost (RESIDUAL)"
    figures = judge(receiver, 0)
    assert (figures.lost, figures.without_pose) == (0, {"lost (RESIDUAL)": 1})


def test_a_missing_transform_is_lost_unless_its_driver_missed_the_tick(receiver: SoakReceiver) -> None:
    receiver.poses.remove(TICKS[5])
    receiver.reasons[TICKS[5]] = "elbow: transform missing from a scan that the other joints sent"
    assert judge(receiver, 0).lost_transforms == 1
    assert judge(receiver, 1).lost == 0


def test_growth_of_memory_descriptors_or_threads_fails(receiver: SoakReceiver) -> None:
    figures = judge(receiver, 0)
    assert growth_mb(SAMPLES) == pytest.approx(9e-4)
    grown = [replace(each, memory_mb=100.0 + each.seconds) for each in SAMPLES]
    for samples in (
        grown,
        [*SAMPLES[:-1], replace(SAMPLES[-1], descriptors=21)],
        [*SAMPLES[:-1], replace(SAMPLES[-1], threads=49)],
    ):
        assert not soak_findings(replace(figures, samples=tuple(samples))).holds


@pytest.mark.parametrize("option", [["--seconds", "1"], ["--warm-up", "-1"], ["--arm", "nothing"]])
def test_wrong_options_are_refused(option: list[str]) -> None:
    assert main(["soak", *option]) == 2
