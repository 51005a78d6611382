# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What each fault of an estimate means, in a few words."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

FAULT_TEXTS: Mapping[str, str] = {
    "BAD_READING": "a reading is missing or invalid",
    "DARK_DIODE": "a diode is dark",
    "OUT_OF_RANGE": "a reading is out of its calibrated range",
    "NOT_CONVERGED": "the estimate did not converge",
    "ILL_CONDITIONED": "the readings do not determine the pose",
    "RESIDUAL": "the readings contradict one another",
    "INNOVATION": "a leap beyond the motion limits",
    "SOURCE": "the wrong light source, or several",
    "COUNT": "the count of bumps is in doubt",
    "ENVIRONMENT": "supply or temperature out of range or not measured",
    "FLAGGED": "the driver marked a reading as unusable",
    "FROZEN": "readings repeat to the last bit",
    "LATCHED": "latched by an earlier fault",
    "ENCODER": "theta disagrees with the encoder",
    "TIME": "uncertain times of readings while the joint moves",
    "ACKNOWLEDGED": "a released latch is not confirmed yet",
    "AMBIENT": "the ambient light is not known",
    "TRAVEL": "a pose beyond the travel of the bearing",
}
"""What each flag of ``posor_msgs/JointTransform.faults`` means, in a few words."""
