# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transforms of a complete scan in the rows of an endpoint estimator: copied from messages, or by a pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.messages.arm_pass import ArmPass
from posor.messages.message_table import LEAD

from posor_estimator.endpoint_verdict import JointStatus

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.messages.joint_transform import JointTransformFormat, TransformConstants
    from posor_ros.intra_process import IntraProcessSubscription

    from posor_estimator.endpoint_prediction import JointMessage
    from posor_estimator.prepared_scan import PreparedScan


class ScanRows:
    """The rows of all joints of an arm, in the order of the chain, with their formats."""

    def __init__(self, estimator: EndpointEstimator) -> None:
        self._estimator = estimator
        self._rows: list[tuple[str, JointTransformFormat, memoryview]] = []
        self._pass: ArmPass | None = None
        self._pass_key: tuple[object, ...] = ()

    def fill(self, scan: Mapping[str, JointMessage]) -> list[TransformConstants]:
        """Copy the transforms of a scan into the rows.

        Where a format has changed, the estimator takes the rows, shared terms and causes of all joints before. Return
        the constants of all joints in this case, else an empty list.
        """
        changed: list[TransformConstants] = []
        if not self._rows or any(scan[name][0] is not expected for name, expected, _ in self._rows):
            changed = self._use_formats([scan[name][0] for name in self._estimator.joints])
        for name, expected, row in self._rows:
            data = scan[name][1]
            row[:] = data if len(data) == expected.size else data[: expected.size]
        return changed

    def _use_formats(self, formats: list[JointTransformFormat]) -> list[TransformConstants]:
        estimator, constants = self._estimator, [each.constants for each in formats]
        estimator.use_rows([each.row_layout for each in formats])
        estimator.use_terms([each.shared for each in constants])
        estimator.use_causes([each.causes for each in constants])
        self._rows = [
            (name, each, row[LEAD : LEAD + each.size].data)
            for name, each, row in zip(estimator.joints, formats, estimator.rows, strict=True)
        ]
        return constants

    def messages(self) -> list[JointMessage]:
        """Return the transforms in the rows as messages, with their formats."""
        return [(each, row.tobytes()) for _, each, row in self._rows]

    def statuses(self) -> list[JointStatus]:
        """Return the status of each joint after the estimate."""
        joints = zip(self._rows, self._estimator.faults.tolist(), strict=True)
        return [JointStatus(name, *each.read_state(row), code) for (name, each, row), code in joints]

    def find_pass(
        self, scans: Sequence[PreparedScan], joints: Mapping[IntraProcessSubscription, int]
    ) -> ArmPass | None:
        """Return the pass that fills the rows from a scan of each joint; None: the transforms are needed as messages.

        Their formats are others than those of the rows, they go to other subscriptions, or kernels run in Python.
        ``joints``: index of the joint of each subscription.
        """
        key = self._estimator.rows_kernel, *[scan.stream for scan in scans], *[scan.taker for scan in scans]
        if key != self._pass_key:
            self._pass, self._pass_key = self._make_pass(scans, joints), key
        return self._pass

    def _make_pass(
        self, scans: Sequence[PreparedScan], joints: Mapping[IntraProcessSubscription, int]
    ) -> ArmPass | None:
        streams = {joints[each.taker]: each.stream for each in scans if each.taker is not None and each.taker in joints}
        if len(streams) < len(self._rows) or not self._rows:
            return None
        matches = all(self._rows[j][1].matches(stream.transform()) for j, stream in streams.items())
        return ArmPass.of(streams, self._estimator) if matches else None
