# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Replays of the 1985 rig for tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from posor_bringup.supervisor import Supervisor
from posor_lab.harness.rig_files import JOINT
from posor_lab.harness.ros_domain import leased_domain
from posor_lab.replay_1985.replay import Replay, ReplayPlan, StepCollector
from posor_ros.node_program import ros_context


@contextmanager
def open_replay(plan: ReplayPlan) -> Iterator[Replay]:
    """Yield a replay, not yet started, in a ROS domain of its own; end its processes afterwards."""
    with pytest.MonkeyPatch.context() as environment, leased_domain() as domain:
        environment.setenv("ROS_DOMAIN_ID", str(domain))
        with (
            ros_context(["test"]) as stop,
            Supervisor(plan.output / "logs") as supervisor,
            StepCollector(JOINT) as collector,
        ):
            yield Replay(plan, supervisor, collector, interrupted=lambda: stop.requested)


def run_replay(plan: ReplayPlan) -> StepCollector:
    with open_replay(plan) as replay:
        replay.start()
        replay.activate_driver()
        replay.wait_for_end()
        replay.stop()
        return replay.collector
