# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""States and faults of an estimate; a test holds their numbers to those of ``posor_msgs/JointTransform``."""

from __future__ import annotations

from enum import IntEnum, IntFlag


class State(IntEnum):
    """May the pose be used?"""

    OK = 0
    DEGRADED = 1
    LOST = 2
    UNCOUNTED = 3


USABLE_STATES = (State.OK, State.DEGRADED)  # states in which the pose of an estimate may be used


class Fault(IntFlag):
    """Why the state is not OK."""

    NONE = 0
    BAD_READING = 1
    DARK_DIODE = 2
    OUT_OF_RANGE = 4
    NOT_CONVERGED = 8
    ILL_CONDITIONED = 16
    RESIDUAL = 32
    INNOVATION = 64
    SOURCE = 128
    COUNT = 256
    ENVIRONMENT = 512
    FLAGGED = 1024
    FROZEN = 2048
    LATCHED = 4096
    ENCODER = 8192
    TIME = 16384
    ACKNOWLEDGED = 32768
    AMBIENT = 65536
    TRAVEL = 131072
