# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Time offset between a joint's scans and its encoder, found in motion; and the encoder's reading at a scan's stamp.

Where the content of the scans is older than their stamps by tau, the encoder leads theta by ``tau`` times the rate.
Each difference d of encoder minus theta at the rate w is one observation of offset and bias,

    d = b + w tau + v,   variance of v: that of the encoder and of theta,

and both are estimated by recursive weighted least squares (M. Li, A. I. Mourikis, *Online temporal calibration for
camera-IMU systems*, Int. J. Robotics Research 33(7), 2014; A. Gelb, *Applied Optimal Estimation*, 1974, 3.8 and 4.2).
Between two differences the joint turns by a:

* An encoder's error depends on its angle. The bias b is exponentially correlated over BIAS_ANGLE, with the encoder's
  stated standard uncertainty and the systematic one of theta, variance B together: ``b *= p``, its variance
  ``P = p^2 P + (1 - p^2) B``, ``p = exp(-a / BIAS_ANGLE)``. At rest, the differences show the bias only. Where
  the direction of the motion turns, p is zero, so that backlash is not taken for an offset.
* Earlier differences are forgotten over MEMORY_ANGLE: the variance of tau grows by ``exp(a / MEMORY_ANGLE)``, up to
  PRIOR_S^2. At rest nothing is forgotten.

A difference that is further than DEVIATION_SIGMAS from the expected one begins the estimate anew. While the rate
changes by c per second, ``c tau^2 / 2``, which the model leaves out, is added to the standard deviation of v.
"""

from __future__ import annotations

import math
from typing import Any

from posor.estimation.tracking import rate_is_known, uniform_sigma
from posor.numerics.compiled import in_place
from posor.numerics.vector import square, wrapped

BIAS_ANGLE = 0.5  # angle over which the error of an encoder changes [rad]
MEMORY_ANGLE = 2.0  # angle after which a difference has lost 63 % of its weight [rad]
PRIOR_S = 1.0  # standard uncertainty of the offset before any motion [s]
STILL_SIGMAS = 5.0  # standard uncertainties of the rate up to which the joint counts as standing
DEVIATION_SIGMAS = 5.0
LARGEST_MOTION = 0.1  # possible turn since a reference was read [rad]; beyond, it neither confirms nor contradicts
OFFSET_SIGMAS = 5.0  # standard uncertainties that an offset may exceed the largest error of the stamps


@in_place
def move_reference(workspace: Any, scan: Any, widest: float) -> None:
    """Move a reference of theta from its own stamp to that of a scan, into ``checks``.

    A reference that may be off by half a period of theta, or by LARGEST_MOTION because the joint may have turned since,
    is left out; ``widest``: standard deviations of these errors.
    """
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    apart = (scan.stamp_ns - tracker.reference_stamp_ns) * 1e-9 if tracker.reference_stamp_ns != 0 else 0.0
    rate, spread, fastest = 0.0, uniform_sigma(settings.max_theta_rate), settings.max_theta_rate
    if rate_is_known(tracker, checks.elapsed):
        rate, fastest = tracker.theta_rate, abs(tracker.theta_rate)
        spread = tracker.rate_sigmas[3] * (1.0 + abs(apart) / tracker.interval)
    checks.reference_theta = tracker.reference_theta + rate * apart
    checks.reference_tolerance = fastest * scan.stamp_limit if scan.stamp_limit > 0.0 else 0.0
    variance = square(tracker.reference_sigma) + square(spread * apart)
    away = widest * math.sqrt(variance) + checks.reference_tolerance
    is_old = widest * abs(spread * apart) > LARGEST_MOTION
    if away < math.inf and not is_old and not away > 0.5 * settings.period > 0.0:
        checks.reference_variance = variance


@in_place
def follow_offset(workspace: Any, theta: float, difference: float, noise: float, bias: float, limit: float) -> None:
    """Add a difference of encoder minus theta [rad] to the estimate of offset and bias.

    ``theta``: where the difference was found [rad]; ``noise``, ``bias``: variances of the difference [rad^2];
    ``limit``: stated largest error of the stamps [s].
    """
    tracker, checks = workspace.tracker, workspace.checks
    if not rate_is_known(tracker, checks.elapsed) or tracker.rates < 2:  # noqa: PLR2004  the first has no uncertainty
        return
    offset, rate, spread = tracker.offset, tracker.theta_rate, tracker.rate_sigmas[3]
    if abs(rate) <= STILL_SIGMAS * spread:
        rate = 0.0
    turned = abs(wrapped(theta - offset.theta))
    offset.theta = theta
    if not offset.known:
        _begin(offset, bias)
    kept, growth = math.exp(-turned / BIAS_ANGLE), math.exp(0.5 * turned / MEMORY_ANGLE)
    if rate * offset.direction <= 0.0 and rate != 0.0:
        kept, offset.direction = 0.0, math.copysign(1.0, rate)
    growth = min(growth, PRIOR_S / math.sqrt(offset.variance))
    offset.bias *= kept
    offset.bias_variance = bias + square(kept) * (offset.bias_variance - bias)
    offset.covariance *= kept * growth
    offset.variance *= square(growth)
    noise += square(0.5 * square(offset.seconds) * spread / tracker.interval)
    total = _variance_of_difference(offset, rate) + noise
    deviation = difference - offset.bias - rate * offset.seconds
    if square(deviation) > square(DEVIATION_SIGMAS) * total:
        _begin(offset, bias)
        total, deviation = _variance_of_difference(offset, rate) + noise, difference
    of_bias = (offset.bias_variance + rate * offset.covariance) / total
    of_offset = (offset.covariance + rate * offset.variance) / total
    offset.bias += of_bias * deviation
    offset.seconds += of_offset * deviation
    offset.bias_variance -= square(of_bias) * total
    offset.covariance -= of_bias * of_offset * total
    offset.variance -= square(of_offset) * total
    _judge(offset, limit)


@in_place
def _begin(offset: Any, bias: float) -> None:
    offset.known, offset.bias, offset.seconds = 1, 0.0, 0.0
    offset.bias_variance, offset.covariance, offset.variance = bias, 0.0, square(PRIOR_S)


@in_place
def _variance_of_difference(offset: Any, rate: float) -> float:
    return float(offset.bias_variance + 2.0 * rate * offset.covariance + square(rate) * offset.variance)


@in_place
def _judge(offset: Any, limit: float) -> None:
    """Keep an offset that is beyond its uncertainty and the limit, until one is known to half of it that is not."""
    uncertainty = OFFSET_SIGMAS * math.sqrt(offset.variance)
    if abs(offset.seconds) > uncertainty + limit:
        offset.disagreeing = offset.seconds
    elif uncertainty < 0.5 * abs(offset.disagreeing):
        offset.disagreeing = 0.0
