# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Home of relative poses: a pose of the endpoint, and what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.numerics.array_types import FloatArray


class HomePose:
    """The pose that others are relative to. They have its errors, too, which their covariances do not contain.

    Attributes:
        pose: Home in the base frame, position [m] and quaternion, (7,); None: not taken yet.

    """

    def __init__(self) -> None:
        self.pose: FloatArray | None = None
        self._reason = self._identity = ""

    def forget(self) -> None:
        """Have no home until ``take``."""
        self.pose = None

    def take(self, pose: FloatArray, reason: str, identity: str) -> None:
        """Take a pose; ``reason``: why it is not OK, or empty; ``identity``: of the arm."""
        self.pose, self._reason, self._identity = pose.copy(), reason, identity

    def relate(self, estimator: EndpointEstimator) -> None:
        """Have the results of an estimator relative to home."""
        if self.pose is not None:
            estimator.estimate_relative_to(self.pose)

    def fault(self, identity: str) -> str:
        """Return why poses of an arm with this identity are degraded by their home; else empty."""
        if self.pose is None:
            return ""
        if identity != self._identity:
            return "home was taken with other calibrations; expected ~/set_home"
        return f"home was taken from a pose that was not OK ({self._reason})" if self._reason else ""
