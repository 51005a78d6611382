# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``simulated``: one joint of a simulated arm, in step with the drivers of the other joints.

Every driver computes the same truth from the same files. The driver of the last joint also publishes the truth of the
endpoint and moves the stage, if there is one. Scans are computed for several ticks together, except at the start of a
run and while the stage moves.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor.errors import ParameterError
from posor.numerics.stamps import tick_stamp_ns, time_ns
from posor.parameter_model import ParameterGroup
from posor.ros_names import RAW_SCAN, RAW_TOPIC
from posor_ros.delivery_round import run_after_round
from pydantic import Field

from posor_drivers.message_builder import SimulatedMessages
from posor_drivers.quantity_limits import MAX_RATE_HZ
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.stage import Stage
from posor_drivers.sources.source import Input, LiveSource, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.pose_array import ArmTruth
    from posor_drivers.simulator.simulated_scans import SimulatedScans
    from posor_drivers.sources.source import SourceMessage

BATCH_TICKS = 16
"""Ticks that are computed together, in about twice the time of a single one."""


class _Batch(NamedTuple):
    """Truth and scans of consecutive ticks."""

    ticks: range
    stage: list[float] | None  # position of the stage [m], axes of the endpoint
    truth: ArmTruth
    scans: SimulatedScans


class SimulatedParameters(Imperfections, ParameterGroup):
    """Parameters of the source ``simulated``, the switches of all imperfections included."""

    arm: Annotated[str, Field(min_length=1)] = Field(description="arm file (YAML), with a scenario")
    joint: Annotated[str, Field(min_length=1)] = Field(description="name of this driver's joint")
    namespace: str = Field(
        default="", description="namespace around that of the arm, for topics of the whole arm, such as encoders"
    )
    rate: Annotated[int, Field(ge=0, le=MAX_RATE_HZ)] = Field(
        default=0, description="scans per second, equal for all drivers of the arm [Hz]; 0: those of the scenario"
    )
    truth: str = Field(
        default="",
        description='model of the readings: "shared", or one of another package; empty: that of the scenario',
    )
    cycles: Annotated[int, Field(ge=0)] = Field(
        default=0,
        description="end after the rest of the present cycle of the scenario and this many whole cycles; 0: never",
    )


class SimulatedSource(LiveSource[SimulatedParameters]):
    """One joint of a simulated arm."""

    Parameters = SimulatedParameters

    _simulation: ArmSimulation
    _messages: SimulatedMessages
    _stage: Stage | None
    _batch: _Batch | None = None
    _latest: tuple[int, int]
    """Tick and publication time [ns] of the last call of ``publication_time_ns``."""

    @property
    def record(self) -> str:
        """The arm file."""
        return self.parameters.arm

    def open(self) -> Sequence[Topic]:
        """Read the arm's files and compute one cycle."""
        arm = load_arm_file(Path(self.parameters.arm)).in_namespace(self.parameters.namespace)
        self._simulation = ArmSimulation(arm, self.parameters, self.parameters.rate, self.parameters.truth)
        joints, joint = self._simulation.joints, self.parameters.joint
        if joint not in joints:
            what, expected = f"'{joint}' is not a joint of {self.parameters.arm}", f"one of {', '.join(joints)}"
            raise ParameterError(what, where="parameter 'simulated.joint'", expected=expected)
        self._messages = SimulatedMessages(self.types, self._simulation)
        self._rate = self._simulation.scenario.ticks_per_second
        self._latest = (-1, 0)
        self._is_last = joint == joints[-1]
        # Drivers of one process compute their batches at different ticks.
        self._batch_offset = BATCH_TICKS * joints.index(joint) // len(joints)
        settings = self._simulation.scenario.stage if self._is_last else None
        self._stage = None if settings is None else Stage(settings, self._simulation.arm.endpoint_frame)
        topics = self._messages.topics
        published = [Topic(RAW_TOPIC, RAW_SCAN), topics.joint_truth(joint)]
        if self._is_last:
            published += [topics.endpoint, topics.target, topics.encoders]
            published += [topics.temperature(each.name) for each in self._simulation.thermometers.values()]
            published += [topics.acceleration(name) for name in self._simulation.accelerometers]
        if self._stage is not None:
            published.append(topics.stage)
        return published

    def inputs(self) -> Sequence[Input]:
        """Return the topic of commands for the stage, if this driver moves it."""
        return [] if self._stage is None else [Input(self._messages.topics.stage_command, self._on_stage_command)]

    def _on_stage_command(self, message: Any, now_ns: int) -> None:
        """Pass a command (geometry_msgs/Vector3Stamped) on to the stage."""
        if self._stage is not None:
            header, vector = message.header, message.vector
            goal = np.array([vector.x, vector.y, vector.z])
            stamp_ns = time_ns(header.stamp.sec, header.stamp.nanosec)
            self._stage.add_command(goal, header.frame_id, stamp_ns, now_ns)

    @property
    def rate(self) -> int:
        """Scans per second."""
        return self._rate

    def start_run(self, now_ns: int) -> tuple[int, int | None]:
        """Start at the next tick; end with a cycle, so that all drivers of an arm end at the same tick."""
        if self._stage is not None:
            self._stage.restart()
        first, _ = super().start_run(now_ns)
        self._simulation.start_at(self.parameters.joint, first)
        self._batch = None
        if not self.parameters.cycles:
            return first, None
        length = self._simulation.scenario.cycle_ticks
        next_cycle = -(-first // length)
        return first, (next_cycle + self.parameters.cycles) * length - 1

    def publication_time_ns(self, tick: int) -> int:
        """Return the time of a tick plus its simulated latency [ns]."""
        known, time_ns = self._latest
        if tick != known:
            time_ns = tick_stamp_ns(tick, self._rate) + self._simulation.latency_ns(self.parameters.joint, tick)
            self._latest = (tick, time_ns)
        return time_ns

    def read_tick(self, tick: int) -> Iterator[SourceMessage]:
        """Yield scan and truth of a tick."""
        joint, stamp_ns = self.parameters.joint, tick_stamp_ns(tick, self.rate)
        position = None if self._stage is None else self._stage.position_at(stamp_ns)
        batch = self._batch_of(tick, position)
        truth, scans, n = batch.truth, batch.scans, tick - batch.ticks.start
        if self._is_last:  # before the scan, which needs them
            for name, reading in self._simulation.accelerations(tick).items():
                sigma = self._simulation.accelerometers[name].uncertainty.number
                yield self._messages.acceleration(name, stamp_ns, reading, sigma)
        if scans.sent[n]:
            yield self._messages.raw_scan(joint, scans, n)
        yield self._messages.joint_truth(joint, stamp_ns, truth, n)
        if self._is_last:
            yield from self._messages.arm_truth(stamp_ns, truth, n)
            for beam, kelvin in self._simulation.temperatures(tick).items():
                entry = self._simulation.thermometers[beam]
                yield self._messages.temperature(entry.name, stamp_ns, kelvin, entry.uncertainty.number)
        if position is not None:
            yield self._messages.stage_position(stamp_ns, position)
        if len(batch.ticks) > 1 and tick == batch.ticks[-1]:
            run_after_round(partial(self._batch_of, tick + 1, position))

    def _batch_of(self, tick: int, position: FloatArray | None) -> _Batch:
        """Return the batch of a tick.

        A new batch has one tick at the start of a run and where the stage has moved since the tick before; else it ends
        before the next multiple of BATCH_TICKS.
        """
        batch, stage = self._batch, None if position is None else position.tolist()
        is_at_rest = batch is not None and batch.stage == stage
        if batch is None or not is_at_rest or tick not in batch.ticks:
            count = BATCH_TICKS - (tick + self._batch_offset) % BATCH_TICKS if is_at_rest else 1
            ticks = np.arange(tick, tick + count)
            truth = self._simulation.truth(ticks, None if position is None else np.tile(position, (count, 1)))
            scans = self._simulation.scans(self.parameters.joint, ticks, truth)
            batch = self._batch = _Batch(range(tick, tick + count), stage, truth, scans)
        return batch
