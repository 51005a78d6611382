# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""When an operator may release a latched joint: with a reason, not again at once, on a scan that is plausible alone."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, NamedTuple

from posor.errors import ParameterError
from posor.model.fault import State

if TYPE_CHECKING:
    from posor.estimation.posor import Posor
    from posor.model.scan import Scan

WHERE = "acknowledge"


class EncoderReading(NamedTuple):
    """The last reading of the joint's encoder."""

    theta: float  # [rad]
    sigma: float  # standard uncertainty [rad]
    stamp_ns: int  # [ns]


class FaultRelease:
    """Decides on requests to release the latch of one joint."""

    def __init__(self, interval_s: float) -> None:
        """Start without a release; ``interval_s``: least time between two releases [s]."""
        self._interval_s = interval_s
        self._last_s = -interval_s

    def check(self, caller: str, reason: str, now_s: float) -> None:
        """Check who asks, why and when; ``now_s``: steady time [s]. Raises ParameterError: the request is refused."""
        for name, text in (("caller", caller), ("reason", reason)):
            if not text.strip():
                raise ParameterError(f"'{name}' is empty", where=WHERE, expected="who releases the joint, and why")
        if now_s - self._last_s < self._interval_s:
            raise ParameterError(
                f"the last release was {now_s - self._last_s:.1f} s ago",
                where=WHERE,
                expected=f"at most one in {self._interval_s:g} s, 'acknowledge_interval', after an inspection",
            )

    def note(self, now_s: float) -> None:
        """Note that the joint was released."""
        self._last_s = now_s


def check_plausible(posor: Posor, scan: Scan | None, encoder: EncoderReading | None) -> None:
    """Check that a scan gives a pose by itself, without earlier poses, and agrees with the encoder.

    ``posor``: the estimator of the joint, which knows the ambient light; it does not change. Raises ParameterError: the
    scan does not.
    """
    if scan is None:
        raise ParameterError("no lit scan has arrived", where=WHERE, expected="sound scans at the release")
    alone = copy.deepcopy(posor)
    alone.reset()
    alone.tracker["ambient"]["light_left"] = 0  # so that the pose is looked at
    if encoder is not None:
        alone.confirm_theta(encoder.theta, encoder.sigma, encoder.stamp_ns)
    estimate = alone.estimate(scan)
    if estimate.state is State.LOST:
        raise ParameterError(
            f"the last scan is not plausible: {estimate.reason.rstrip('.')}", where=WHERE, expected="sound readings"
        )
