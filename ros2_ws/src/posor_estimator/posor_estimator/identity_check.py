# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compares the calibrations in force, the URDF and the beams file of an arm with its commissioning record.

The identity is computed anew only when a transform states another calibration than the one before.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posor.chain.commissioning_record import load_record
from posor.chain.identity import ArmIdentity, file_sha256
from posor.errors import CalibrationError
from posor.messages.endpoint_messages import EndpointVerdict
from posor_msgs.msg import EndpointState

from posor_estimator.endpoint_verdict import SOUND

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.node_parameters import ChainParameters


class IdentityCheck:
    """Identity of an arm, and whether it is the commissioned one.

    Attributes:
        sha256: The identity, 64 hexadecimal digits; empty: not known yet.
        refuses: Whether no scan may have a pose.
        verdict: On a scan whose joints are sound: OK where the arm is the commissioned one or there is no record.

    """

    def __init__(self, parameters: ChainParameters, joints: Sequence[str]) -> None:
        """Read the files.

        Raises CalibrationError: a file cannot be read, or the record is invalid or that of other joints.
        """
        beams = Path(parameters.beams) if parameters.beams else None
        files = ArmIdentity({}, file_sha256(Path(parameters.urdf)), file_sha256(beams))
        self._commissioned: ArmIdentity | None = None
        if parameters.commissioning:
            self._commissioned = load_record(Path(parameters.commissioning)).parts()
            if set(self._commissioned.calibrations) != set(joints):
                raise CalibrationError(
                    f"joints {', '.join(self._commissioned.calibrations)}",
                    where=f"commissioning record {parameters.commissioning}",
                    expected=", ".join(joints),
                )
        self._files, self._joints = files, tuple(joints)
        self._state = EndpointState.STATE_LOST if parameters.require_commissioned else EndpointState.STATE_DEGRADED
        self.sha256, self.verdict, self.refuses = "", SOUND, False

    def update(self, ids: Sequence[int]) -> None:
        """Use the calibrations that transforms state, an id (``calibration_id``) for each joint."""
        commissioned, numbers = self._commissioned, dict(zip(self._joints, ids, strict=True))
        present = self._files.with_calibrations(numbers, "" if commissioned is None else commissioned.record)
        self.sha256, self.verdict = present.sha256, SOUND
        if commissioned is not None and (found := present.differences(commissioned)):
            joint = next((name for name in self._joints if name in found), "")
            self.verdict = EndpointVerdict(self._state, 0, joint, f"not as commissioned: {'; '.join(found.values())}")
        self.refuses = not self.verdict.has_pose

    def degraded(self, verdict: EndpointVerdict) -> EndpointVerdict:
        """Return the verdict on a scan with a pose, with the difference from the commissioned arm, if any."""
        if self.verdict is SOUND or verdict is SOUND:
            return self.verdict if verdict is SOUND else verdict
        return verdict._replace(reason=f"{verdict.reason}; {self.verdict.reason}")
