# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of every node, of posor_node and of chain_node; documentation and checks follow from these fields.

This module imports no ROS. Drivers declare their parameters in ``posor_drivers.driver_parameters``, since those depend
on the source.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, Field, field_validator, model_validator

from posor.calibration.causes import FALSE_ALARM
from posor.parameter_model import ChangeableAtRunTime, FixedAtStart, ParameterGroup
from posor.ros_names import ACCELERATION_TOPIC, TEMPERATURE_TOPIC, TOPIC_NAME_RULE, is_topic_name

MIN_TF_RATE = 0.01
MIN_ZERO_SCANS = 10  # scans below which their scatter is unknown
HOME_COORDINATES = ("gap", "alpha", "beta")  # elements of the parameter ``home_pose``

_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=True), ChangeableAtRunTime()]


def _check_topic(name: str) -> str:
    if not is_topic_name(name):
        message = f"'{name}' is wrong; expected {TOPIC_NAME_RULE}"
        raise ValueError(message)
    return name


TopicName = Annotated[str, AfterValidator(_check_topic)]


class LimitParameters(ParameterGroup):
    """Timing figures beyond which the diagnostics warn."""

    latency: _Limit = Field(
        default=math.inf, description="warn where a scan was published later than this after its stamp [s]; .inf: never"
    )
    jitter: _Limit = Field(
        default=math.inf,
        description="warn where the time between two publications differed from its mean by more than this [s]; "
        ".inf: never",
    )
    pause: _Limit = Field(
        default=math.inf,
        description="warn where the garbage collector stopped the process for longer than this [s]; .inf: never",
    )


class FreshnessParameters(ParameterGroup):
    """How fresh the inputs of a node must be."""

    max_silence: Annotated[float, Field(ge=0.05, allow_inf_nan=True)] = Field(
        default=0.2,
        description="longest time without input [s], or ten periods where these are longer; then the diagnostics show "
        "an error; .inf: never",
    )
    max_age: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(
        default=1.0, description="greatest age of a stamp [s]; an older scan is not used; .inf: any, for a recording"
    )
    max_future: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(
        default=0.1, description="how far a stamp may be ahead of ROS time [s]; .inf: any, for a recording"
    )


class RealtimeParameters(ParameterGroup):
    """Requests of the whole process to the operating system, for all of its threads."""

    priority: Annotated[int, Field(ge=0, le=99), FixedAtStart()] = Field(
        default=0, description="real-time priority (SCHED_FIFO) of the process; 0: normal scheduling"
    )
    cpus: Annotated[tuple[int, ...], FixedAtStart()] = Field(
        default=(), description="processors that the process may run on, from 0; empty: all"
    )
    lock_memory: Annotated[bool, FixedAtStart()] = Field(
        default=False, description="keep all memory of the process from being swapped out"
    )
    required: Annotated[bool, FixedAtStart()] = Field(
        default=False, description="do not start if the system refuses any of this; false: warn in the diagnostics"
    )

    @field_validator("cpus", mode="before")
    @classmethod
    def _to_tuple(cls, cpus: object) -> object:
        return tuple(cpus) if isinstance(cpus, list) else cpus

    @field_validator("cpus")
    @classmethod
    def _check_cpus(cls, cpus: tuple[int, ...]) -> tuple[int, ...]:
        if any(cpu < 0 for cpu in cpus):
            message = f"{list(cpus)} is wrong; expected numbers of processors, at least 0"
            raise ValueError(message)
        return cpus


class NodeParameters(ParameterGroup):
    """Parameters that every node has."""

    autostart: Annotated[bool, FixedAtStart()] = Field(
        default=True, description="configure and activate at start; false: wait for the lifecycle services"
    )
    allow_changes: Annotated[bool, FixedAtStart()] = Field(
        default=True,
        description="open the services that change state: ~/reload, ~/zero, ~/home, ~/acknowledge, ~/set_home, those "
        "that set parameters, and those of the lifecycle; false: they do not exist",
    )
    hardware_id: Annotated[str, FixedAtStart()] = Field(
        default="", description="hardware named in the diagnostics; empty: the node's namespace, or its name"
    )
    lossless: bool = Field(
        default=False,
        description="publish and subscribe reliably and keep all messages, so that a fast publisher waits for a slow "
        "subscription: for replays; set it for all nodes; qos_overrides.* changes single topics",
    )
    freshness: FreshnessParameters = FreshnessParameters()
    limits: LimitParameters = LimitParameters()
    realtime: RealtimeParameters = RealtimeParameters()

    @model_validator(mode="after")
    def _check_changes(self) -> NodeParameters:
        if not (self.autostart or self.allow_changes):
            text = (
                "'autostart' and 'allow_changes' are both false, so that nothing can start the node; "
                "expected one of them true"
            )
            raise ValueError(text)
        return self


RECORDING: dict[str, float] = {"freshness.max_age": math.inf, "freshness.max_future": math.inf}
"""Parameters of nodes that receive the stamps of a recording."""


ParametersT = TypeVar("ParametersT", bound=NodeParameters)


class AlarmParameters(NodeParameters):
    """Parameters of the nodes that judge scans."""

    alarm_count: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=5,
        description="scans without a pose in a row that the diagnostics show as an error; fewer are a warning, unless "
        "there are more than false alarms explain",
    )


class EncoderParameters(ParameterGroup):
    """Encoder of the joint (sensor_msgs/JointState), a coarse measurement of theta."""

    sigma: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0, description="standard uncertainty of the encoder's angle as theta [rad]; 0: no encoder"
    )
    joint: str = Field(default="", description="joint in the encoder's messages; empty: they hold one position only")
    topic: TopicName = Field(default="encoder", description="topic of the encoder, relative to the node's namespace")


class PosorParameters(AlarmParameters):
    """Parameters of posor_node."""

    calibration: str = Field(description="path of the calibration file (YAML) of this joint's POSOR")
    session: str = Field(default="", description="session whose zero shifts and maps apply; empty: none")
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=FALSE_ALARM,
        description="probability that the chi-square test of the redundant readings rejects a sound scan; given their "
        "calibration errors, one joint of 100 may have a larger one",
    )
    home_pose: tuple[float, ...] = Field(
        default=(),
        description="gap [m], alpha and beta [rad] of the pose that ~/zero makes home; empty: no such service",
    )
    zero_scans: Annotated[int, Field(ge=MIN_ZERO_SCANS, le=100_000)] = Field(
        default=100, description="number of most recent scans whose mean ~/zero uses"
    )
    acknowledge_interval: Annotated[float, Field(ge=0.0, le=86_400.0)] = Field(
        default=10.0, description="least time between two releases of a latched fault by ~/acknowledge [s]; 0: any"
    )
    encoder: EncoderParameters = EncoderParameters()

    @field_validator("home_pose")
    @classmethod
    def _check_home_pose(cls, home: tuple[float, ...]) -> tuple[float, ...]:
        if len(home) not in (0, len(HOME_COORDINATES)):
            message = f"{len(home)} numbers; expected 3: {', '.join(HOME_COORDINATES)}, or none"
            raise ValueError(message)
        return home


class EncodersParameters(ParameterGroup):
    """Encoders of the joints (sensor_msgs/JointState), which predict the endpoint between scans."""

    topic: str = Field(
        default="",
        description="topic of the readings, relative to the node's namespace; empty: no prediction of the endpoint",
    )
    names: tuple[str, ...] = Field(
        default=(), description="the joints' names in the readings, in the order of the chain; empty: as in the URDF"
    )
    sigma: tuple[float, ...] = Field(
        default=(),
        description="standard uncertainty of a reading against its neighbours [rad]: noise, and step/sqrt(12); one for "
        "all joints, or one for each",
    )
    backlash: tuple[float, ...] = Field(
        default=(0.0,),
        description="angle by which an encoder may turn while its joint stands still [rad]; one for all joints, or one "
        "for each",
    )
    slope: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=1e-4,
        description="change of the slow errors of a reading per turned angle, rms: eccentricity, gears [rad/rad]",
    )
    stamp_sigma: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        default=1e-4, description="standard uncertainty of the stamps of the readings against those of the scans [s]"
    )
    max_offset: Annotated[float, Field(gt=0.0, allow_inf_nan=True)] = Field(
        default=0.005, description="largest difference of encoder and POSOR [rad]; .inf: any"
    )
    max_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = Field(
        default=10.0, description="largest rate of a joint [rad/s]; a faster change of a reading is refused"
    )
    max_jerk: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        default=10.0, description="standard deviation of the jerk of a joint in motion [rad/s^3]"
    )
    lead_time: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0, description="the endpoint is also predicted for this time after each reading [s]; 0: it is not"
    )
    gap: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.02, description="time without a transform of a joint after which the prediction is DEGRADED [s]"
    )
    max_holdover: Annotated[float, Field(gt=0.0, le=10.0)] = Field(
        default=0.1, description="longest time for which encoders carry a joint on without a transform [s]"
    )

    @field_validator("topic")
    @classmethod
    def _check_topic(cls, name: str) -> str:
        return _check_topic(name) if name else name

    @field_validator("sigma", "backlash")
    @classmethod
    def _check_angles(cls, angles: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0.0 <= angle <= 1.0 for angle in angles):
            message = f"{list(angles)} is wrong; expected angles of 0 to 1 rad"
            raise ValueError(message)
        return angles

    @model_validator(mode="after")
    def _check_times(self) -> EncodersParameters:
        if self.gap > self.max_holdover:
            text = f"'gap' of {self.gap:g} s is longer than 'max_holdover' of {self.max_holdover:g} s"
            raise ValueError(text)
        if self.topic and not (self.sigma and all(self.sigma)):
            text = "'topic' without 'sigma'; expected the standard uncertainty of a reading, such as step/sqrt(12)"
            raise ValueError(text)
        return self


class ChainParameters(AlarmParameters):
    """Parameters of chain_node."""

    urdf: str = Field(description="path of the arm's URDF; its floating joints are the POSORs")
    endpoint_frame: str = Field(default="endpoint", description="link of the URDF whose pose is published")
    beams: str = Field(
        default="",
        description="path of the beams file: uncertainty, sag, temperature, vibration of beams; empty: straight, exact",
    )
    commissioning: str = Field(
        default="",
        description="path of the commissioning record; where the arm differs from it, the endpoint is DEGRADED; empty: "
        "nothing is compared",
    )
    require_commissioned: bool = Field(
        default=False, description="no pose where the arm differs from its commissioning record"
    )
    acceleration_window: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.0,
        description="motion [s] from which the beams' accelerations are estimated, for their sag; 0: assume rest",
    )
    max_wait: Annotated[float, Field(gt=0.0, le=60.0)] = Field(
        default=0.1,
        description="how long the first transform of a scan waits for the others [s]; then there is no pose",
    )
    false_alarm: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=FALSE_ALARM, description="probability that a posor_node rejects a sound scan, as stated there"
    )
    reference: Literal["absolute", "home"] = Field(
        default="absolute",
        description="publish the endpoint in the URDF's base frame, or relative to its pose at home: at the first "
        "pose, or at the last call of ~/set_home",
    )
    temperature_topic: TopicName = Field(
        default=TEMPERATURE_TOPIC,
        description="name before those of the thermometers of the beams file in their topics, relative to the node's "
        "namespace: 'temperature/upper_arm'",
    )
    acceleration_topic: TopicName = Field(
        default=ACCELERATION_TOPIC,
        description="name before those of the accelerometers of the beams file in their topics, likewise: "
        "'acceleration/upper_arm_near'",
    )
    encoders: EncodersParameters = EncodersParameters()
    tf_rate: Annotated[float, Field(ge=0.0, allow_inf_nan=True)] = Field(
        default=math.inf, description="how often /tf is published at most [1/s]; .inf: with each pose; 0: not at all"
    )
    frame_prefix: str = Field(
        default="",
        description="prefix of the frames that chain_node publishes, so that arms of one URDF share one /tf: 'cell1/'; "
        "transforms of joints keep the frames of their calibrations",
    )

    @model_validator(mode="after")
    def _check_commissioning(self) -> ChainParameters:
        if self.require_commissioned and not self.commissioning:
            text = "'require_commissioned' is true without 'commissioning'; expected the path of a commissioning record"
            raise ValueError(text)
        return self

    @field_validator("tf_rate")
    @classmethod
    def _check_tf_rate(cls, rate: float) -> float:
        if not (rate == 0.0 or rate >= MIN_TF_RATE):
            message = f"{rate:g} is wrong; expected 0, or at least {MIN_TF_RATE:g}"
            raise ValueError(message)
        return rate

    @field_validator("frame_prefix")
    @classmethod
    def _check_frame_prefix(cls, prefix: str) -> str:
        if prefix.startswith("/") or prefix.split() not in ([], [prefix]):
            message = f"'{prefix}' is wrong; expected a prefix without '/' at its begin and without spaces, as tf2 does"
            raise ValueError(message)
        return prefix
