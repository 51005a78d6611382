"""Source ``simulated``: one joint of a simulated arm, in step with the drivers of the others without talking to them.

The driver of the last joint also tells the truth about the endpoint, and it moves the stage where there is one.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from posor_estimator.core.arm import load_arm
from posor_estimator.errors import ParameterError
from posor_estimator.ros.message_types import RAW_SCAN
from posor_estimator.ros.parameters import ParameterGroup
from posor_estimator.ros.qos import RAW_TOPIC
from pydantic import Field

from posor_drivers.simulated_messages import SimulatedMessages
from posor_drivers.simulator.arm import ArmSimulation
from posor_drivers.simulator.stage import Stage
from posor_drivers.simulator.switches import Switches
from posor_drivers.simulator.ticks import NS, first_tick_after, stamp_of
from posor_drivers.sources.base import Input, LiveSource, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_drivers.sources.base import SourceMessage


class SimulatedParameters(ParameterGroup):
    """Parameters of the source ``simulated``; how large each imperfection is stands in the scenario."""

    arm: Annotated[str, Field(min_length=1)] = Field(description="arm file (YAML), with a scenario")
    joint: Annotated[str, Field(min_length=1)] = Field(description="name of this driver's joint")
    cycles: Annotated[int, Field(ge=0)] = Field(
        default=0,
        description="end after this many whole cycles of the scenario, and what was left of the present one at the "
        "start; 0: never",
    )
    noise: bool = Field(default=True, description="noise of the readings, as large as the calibration says")
    quantisation: bool = Field(default=True, description="steps of the analogue-to-digital converter")
    zero_drift: bool = Field(default=True, description="the probes' zeros wander")
    supply_drift: bool = Field(default=True, description="the supply voltage of the probes wanders")
    contamination: bool = Field(default=True, description="dirt on single channels, part of the time")
    dropouts: bool = Field(default=True, description="some scans are never sent")
    latency: bool = Field(default=True, description="scans are published some time after their exposure")
    calibration_errors: bool = Field(
        default=True, description="POSORs differ from their calibrations, by as much as those say is uncertain"
    )
    beam_errors: bool = Field(
        default=True, description="measuring beams differ from the beams file, by as much as it says is uncertain"
    )
    sag: bool = Field(default=True, description="measuring beams sag")
    inertia: bool = Field(default=True, description="measuring beams sag otherwise while they accelerate")


class SimulatedSource(LiveSource[SimulatedParameters]):
    """One joint of a simulated arm."""

    Parameters = SimulatedParameters

    _simulation: ArmSimulation
    _make: SimulatedMessages
    _stage: Stage | None
    _latest: tuple[int, int]

    @property
    def record(self) -> str:
        """The arm file."""
        return self.parameters.arm

    def open(self) -> Sequence[Topic]:
        """Read the arm's files and work out one cycle."""
        self._simulation = ArmSimulation(load_arm(Path(self.parameters.arm)), self._switches())
        joints, joint = self._simulation.joints, self.parameters.joint
        if joint not in joints:
            raise ParameterError(
                f"'{joint}' is no joint of {self.parameters.arm}",
                where="parameter 'simulated.joint'",
                expected=f"one of {', '.join(joints)}",
            )
        self._make = SimulatedMessages(self.types, self._simulation)
        self._latest = (-1, 0)
        said = self._simulation.scenario.stage
        last = joint == joints[-1]
        self._stage = Stage(said, self._simulation.arm.endpoint_frame) if last and said is not None else None
        topics = self._make.topics
        every = [Topic(RAW_TOPIC, RAW_SCAN), topics.joint(joint)]
        if last:
            every += [topics.endpoint, topics.target, topics.encoders]
        if self._stage is not None:
            every.append(topics.stage)
        return every

    def _switches(self) -> Switches:
        return Switches(**{field.name: getattr(self.parameters, field.name) for field in fields(Switches)})

    def inputs(self) -> Sequence[Input]:
        """Listen to commands for the stage, if there is one and this is the last joint."""
        return [] if self._stage is None else [Input(self._make.topics.stage_command, self._command)]

    def _command(self, message: Any, now_ns: int) -> None:
        """Pass a command (geometry_msgs/Vector3Stamped) on to the stage."""
        if self._stage is not None:
            header, vector = message.header, message.vector
            stamp_ns = header.stamp.sec * NS + header.stamp.nanosec
            self._stage.command(np.array([vector.x, vector.y, vector.z]), header.frame_id, stamp_ns, now_ns)

    @property
    def rate(self) -> int:
        """The scenario's rate [Hz]."""
        return self._simulation.scenario.ticks_per_second

    def begin(self, now_ns: int) -> tuple[int, int | None]:
        """Begin with the next tick; end with a cycle, so that the drivers of an arm end alike."""
        if self._stage is not None:
            self._stage.restart()
        first = first_tick_after(now_ns, self.rate)
        if not self.parameters.cycles:
            return first, None
        length = self._simulation.scenario.cycle_ticks
        started = -(-first // length)
        return first, (started + self.parameters.cycles) * length - 1

    def newest(self, now_ns: int) -> int:
        """Return the newest tick that has happened."""
        return first_tick_after(now_ns, self.rate) - 1

    def due_ns(self, tick: int) -> int:
        """Return when the scan of a tick is published."""
        known, due_ns = self._latest
        if tick != known:
            latency_ns = self._simulation.latency_ns(self.parameters.joint, tick)
            due_ns = stamp_of(tick, self.rate) + latency_ns
            self._latest = (tick, due_ns)
        return due_ns

    def messages(self, tick: int) -> Iterator[SourceMessage]:
        """Yield scan and truth of a tick."""
        joint, ticks, stamp_ns = self.parameters.joint, np.array([tick]), stamp_of(tick, self.rate)
        position = None if self._stage is None else self._stage.position_at(stamp_ns)
        truth = self._simulation.truth(ticks, None if position is None else position[None, :])
        scans = self._simulation.scans(joint, ticks, truth)
        if scans.sent[0]:
            yield self._make.raw(joint, scans, 0)
        yield self._make.joint_truth(joint, stamp_ns, truth, 0)
        if joint == self._simulation.joints[-1]:
            yield from self._make.arm_truth(stamp_ns, truth, 0)
        if position is not None:
            yield self._make.stage(stamp_ns, position)
