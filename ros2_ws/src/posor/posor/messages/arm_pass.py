# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The tick of an arm in one compiled call: the raw scans of all joints in, the endpoint out, without messages between.

The transforms go from the streams to the rows of the endpoint estimator as bytes. Where a scan needs more than the
kernels do, such as a start or another layout, the endpoint is not estimated: it then takes the transforms as messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.chain.forward_kinematics import HISTORY_FULL, ROWS_MISSING
from posor.numerics.compiled import run_in_turn

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.messages.message_stream import RawScanStream


class ArmPass:
    """Estimates prepared scans of all joints, then the endpoint.

    Attributes:
        rows_kernel: That of the estimator for which the pass was made.
        worst: Result of ``EndpointEstimator.estimate_rows`` in the last run that has estimated the endpoint.

    """

    def __init__(self, streams: Mapping[int, RawScanStream], estimator: EndpointEstimator) -> None:
        """Connect the streams, by the index of their joint, to an estimator.

        The streams run in the order of the mapping. Transforms must have the layouts of the estimator's rows.
        """
        self._estimator, self.rows_kernel, self.worst = estimator, estimator.rows_kernel, 0
        copies = [stream.copies_to(estimator.joint_rows, j) for j, stream in streams.items()]
        self._run = run_in_turn([*(stream.kernel for stream in streams.values()), *copies, self.rows_kernel])

    @staticmethod
    def is_possible(streams: Mapping[int, RawScanStream]) -> bool:
        """Return whether streams can run in one compiled call; kernels that run in Python cannot."""
        return all(stream.kernel.call for stream in streams.values())

    def run(self, stamp_ns: int) -> bool:
        """Estimate the scans of ``RawScanStream.prepare``, and the endpoint at their stamp; return whether it is done.

        If not, ``finish`` of each stream does what is left.
        """
        self.rows_kernel.put((stamp_ns,))
        self._run()
        self.worst = int(self.rows_kernel.results())
        if self.worst == HISTORY_FULL:
            self.worst = self._estimator.estimate_rows(stamp_ns)
        return self.worst != ROWS_MISSING
