# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of plugs: one probe is lifted by a stated amount, or one diode covered, and one channel must react.

A channel of another plug, a wrong direction or a wrong amount is named. All joints are compared: a plug may be that of
another joint.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.chain.commissioning_record import CheckRecord

from posor_calibration.commissioning.plan import diode_sums, probe_gaps, probes_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

    from posor_calibration.commissioning.commissioning_recording import CommissioningRecording, RecordedStep
    from posor_calibration.commissioning.plan import Step

LEAST_SCANS = 5  # of a step and of the rest before it
LEAST_REACTION = 0.02  # least share of a lift that is a reaction
SIMILAR = 0.5  # share of the greatest reaction from which on another channel reacts as well
COVERED = 0.5  # share of its light that a covered diode loses at least
SIGMAS = 5.0  # standard deviations beyond which a figure is wrong
FACTORS = {
    25.4: "inches read as millimetres",
    1.0 / 25.4: "millimetres read as inches",
    1e3: "millimetres read as metres",
}
"""Usual mistakes of units, and by how much they may be missed."""
FACTOR_TOLERANCE = 0.1


class Reaction(NamedTuple):
    """Change of a channel from rest to a step."""

    joint: str
    channel: str
    change: float  # [m], or [A] of a diode
    noise: float  # standard deviation of the change
    level: float  # value at rest


class Lift(NamedTuple):
    """What a probe read of a lift."""

    joint: str
    ratio: float  # to the stated amount
    sigma: float  # its standard uncertainty


def check_cover(
    recording: CommissioningRecording, calibrations: Mapping[str, Calibration], rest: RecordedStep, step: RecordedStep
) -> CheckRecord:
    """Return the result of covering a diode."""
    if (few := _check_count(recording, rest, step)) is not None:
        return few
    shares = [
        each._replace(change=each.change / each.level)
        for each in _reactions(recording, calibrations, rest, step, diode_sums)
    ]
    dark = [each for each in shares if each.change < -COVERED]
    found = f"{step.step.channel} alone lost {-100.0 * dark[0].change:.0f} % of its light" if dark else ""
    return _check_names(step.step, dark) or CheckRecord(check=step.step.name, found=found, verdict="passed")


def check_lift(
    recording: CommissioningRecording, calibrations: Mapping[str, Calibration], rest: RecordedStep, step: RecordedStep
) -> tuple[CheckRecord, Lift | None]:
    """Return the result of lifting a probe; and what the probe read if it alone reacted."""
    if (few := _check_count(recording, rest, step)) is not None:
        return few, None
    _, joint, channel, size, sigma = step.step
    reactions = _reactions(recording, calibrations, rest, step, probe_gaps)
    least = max(SIMILAR * max(abs(each.change) for each in reactions), LEAST_REACTION * size)
    reacting = [each for each in reactions if abs(each.change) >= max(least, 2.0 * SIGMAS * each.noise)]
    if (wrong := _check_names(step.step, reacting)) is not None:
        return wrong, None
    slope = probes_of(calibrations[joint])[channel][2].volts_to_gap
    relative = math.hypot(sigma / size, reacting[0].noise / size, float(slope.sigmas[1] / slope.array[1]))
    lift = Lift(joint, reacting[0].change / size, relative)
    return _check_ratio(step.step.name, lift, "reads"), lift


def check_scale(joint: str, lifts: Sequence[Lift]) -> CheckRecord:
    """Return whether the probes of a joint have the stated unit: the mean of all lifts is known better than one."""
    mean = float(np.mean([lift.ratio for lift in lifts]))
    sigma = float(np.linalg.norm([lift.sigma for lift in lifts])) / len(lifts)
    return _check_ratio(f"{joint}: unit of all probes", Lift(joint, mean, sigma), f"{len(lifts)} probes read")


def _check_count(recording: CommissioningRecording, rest: RecordedStep, step: RecordedStep) -> CheckRecord | None:
    """Return that scans are missing; None: there are enough."""
    counts = {each: min(len(rest.select(scans)), len(step.select(scans))) for each, scans in recording.scans.items()}
    few = [each for each, count in counts.items() if count < LEAST_SCANS]
    if not few:
        return None
    found = f"fewer than {LEAST_SCANS} scans of {', '.join(few)} at rest or in the step"
    return CheckRecord(check=step.step.name, found=found, verdict="failed", kind="missing")


def _reactions(
    recording: CommissioningRecording,
    calibrations: Mapping[str, Calibration],
    rest: RecordedStep,
    step: RecordedStep,
    read: Callable[[Calibration, Scans], dict[str, FloatArray]],
) -> list[Reaction]:
    """Return the reactions of all channels of all joints."""
    found = []
    for joint, calibration in calibrations.items():
        before, after = (read(calibration, each.select(recording.scans[joint])) for each in (rest, step))
        for channel, values in before.items():
            now, level = after[channel], float(np.mean(values))
            noise = math.hypot(*(float(np.std(each)) / math.sqrt(len(each)) for each in (values, now)))
            found.append(Reaction(joint, channel, float(np.mean(now)) - level, noise, level))
    return found


def _check_names(step: Step, reacting: list[Reaction]) -> CheckRecord | None:
    """Return what is wrong with the channels that react; None: it is the one of the step."""
    if [(each.joint, each.channel) for each in reacting] == [(step.joint, step.channel)]:
        return None
    if not reacting:
        return CheckRecord(check=step.name, found="no channel reacts", verdict="failed", kind="missing")
    names = [each.channel if each.joint == step.joint else f"{each.channel} of {each.joint}" for each in reacting]
    found = f"{names[0]} reacts instead of {step.channel}: their plugs are exchanged"
    if len(names) > 1:
        found = f"{', '.join(names)} react together"
    return CheckRecord(check=step.name, found=found, verdict="failed", kind="exchanged")


def _check_ratio(name: str, lift: Lift, subject: str) -> CheckRecord:
    """Return whether a reading has the stated direction and amount."""
    limit = SIGMAS * lift.sigma
    found, blind = f"{subject} {lift.ratio:.4f} of the stated lift", f"a gain wrong by less than {100.0 * limit:.2g} %"
    kind = "sign" if lift.ratio < 0.0 else "scale" if abs(lift.ratio - 1.0) > limit else ""
    usual = [
        text for factor, text in FACTORS.items() if kind and abs(abs(lift.ratio) / factor - 1.0) < FACTOR_TOLERANCE
    ]
    return CheckRecord(
        check=name,
        found=", perhaps ".join([found, *usual]),
        verdict="failed" if kind else "passed",
        kind=kind,
        blind=blind,
    )
