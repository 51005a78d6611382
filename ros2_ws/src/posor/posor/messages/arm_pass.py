# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The tick of an arm in one compiled call: the raw scans of all joints in, the endpoint out, without messages between.

The transforms go from the streams to the rows of the endpoint estimator as bytes. Where a scan needs more than the
kernels do, such as a start or another layout, the endpoint is not estimated; the transforms are then sent as messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from posor.chain.forward_kinematics import HISTORY_FULL, ROWS_MISSING
from posor.numerics.compiled import run_in_turn

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.messages.message_stream import RawScanStream
    from posor.numerics.kernel_library import BoundKernel


class ArmPass:
    """Estimates prepared scans of all joints, then the endpoint."""

    def __init__(self, estimator: EndpointEstimator, kernels: Sequence[BoundKernel]) -> None:
        """Take all kernels in their order; the last is ``rows_kernel`` of the estimator."""
        self._estimator, self._rows_kernel = estimator, kernels[-1]
        self._run = run_in_turn(kernels)

    @classmethod
    def of(cls, streams: Mapping[int, RawScanStream], estimator: EndpointEstimator) -> Self | None:
        """Return the pass of streams, by the index of their joint; None: some kernel runs in Python.

        The transforms must have the layouts of the estimator's rows.
        """
        copies = [stream.copy_kernel(estimator.joint_rows, j) for j, stream in streams.items()]
        kernels = [*(stream.kernel for stream in streams.values()), *copies, estimator.rows_kernel]
        return cls(estimator, kernels) if all(kernel.call for kernel in kernels) else None

    def run(self, stamp_ns: int) -> int | None:
        """Estimate the scans of ``RawScanStream.prepare``, and the endpoint at their stamp.

        Return the result of ``EndpointEstimator.estimate_rows``; None: there is none, because a scan was not estimated
        in the call. ``finish`` of each stream then does what is left.
        """
        self._rows_kernel.put((stamp_ns,))
        self._run()
        worst = int(self._rows_kernel.results())
        if worst == HISTORY_FULL:
            worst = self._estimator.estimate_rows(stamp_ns)
        return None if worst == ROWS_MISSING else worst
