# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of files: gates that let anything pass, the serial number, and what differs from the commissioned files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial
from posor.chain.commissioning_record import CheckRecord
from posor.chain.identity import ArmIdentity, calibration_id, file_sha256
from posor.estimation.posor import Posor
from posor.numerics.stamps import NS

from posor_calibration.commissioning.plan import probes_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile
    from posor.chain.commissioning_record import CommissioningRecord
    from posor.model.scan import Scans

INTERVAL_S = 1e-3  # scan interval at which a gate must still be narrower than what it guards


def arm_identity(arm: ArmFile, calibrations: Mapping[str, Calibration]) -> ArmIdentity:
    """Return the parts of the identity of an arm's files, without a record.

    Raises CalibrationError: a file cannot be read.
    """
    numbers = {joint: calibration_id(calibration) for joint, calibration in calibrations.items()}
    return ArmIdentity({}, file_sha256(arm.urdf), file_sha256(arm.beams)).with_calibrations(numbers, "")


def check_gates(joint: str, calibration: Calibration, scans: Scans) -> CheckRecord:
    """Return whether the motion limits of a calibration can refuse anything.

    From one scan to the next a gate must allow less than the range of a gap probe, and less than half a period of
    theta. Faster scans than every millisecond are taken at their interval.
    """
    name, motion = f"{joint}: gates", calibration.motion
    if motion is None:
        blind = "jumps of the pose that the residuals do not show"
        return CheckRecord(check=name, found="no motion limits", verdict="not_checked", blind=blind)
    stamps = scans.stamps_ns
    interval_s = min(INTERVAL_S, float(np.median(np.diff(stamps))) / NS) if len(scans) > 1 else INTERVAL_S
    probes = [probe for field, _, probe in probes_of(calibration).values() if field == "gap_voltages"]
    ranges = [float(np.ptp(polynomial.polyval(p.range.array, p.volts_to_gap.array))) for p in probes]
    reach = max(float(np.linalg.norm(probe.tip.array[:2])) for probe in probes) if probes else 0.0
    period = float(Posor(calibration).settings["period"])
    allowed = {
        "translation": (motion.translation.number * interval_s, min(ranges, default=np.inf), "m"),
        "lean": (motion.lean.number * interval_s * reach, min(ranges, default=np.inf), "m at the probes"),
        "theta": (motion.theta.number * interval_s, 0.5 * period if period else np.inf, "rad"),
    }
    void = [
        f"{limit} allows {step:.3g} {unit} in {1e3 * interval_s:g} ms, must be below {bound:.3g}"
        for limit, (step, bound, unit) in allowed.items()
        if step >= bound
    ]
    if void:
        return CheckRecord(check=name, found="; ".join(void), verdict="failed", kind="gate")
    least = min(bound / step for step, bound, _ in allowed.values() if step > 0.0)
    blind = f"gates up to {least:.0f} times too wide"
    return CheckRecord(check=name, found="narrower than what they guard", verdict="passed", blind=blind)


def check_serial(arm: ArmFile, read: str) -> CheckRecord:
    """Return whether the arm file is that of this arm; ``read``: the number on the arm's plate, empty: not read."""
    name, blind = "serial number", "the files of another arm whose errors are alike"
    if not arm.serial or not read:
        found = "the arm file states none" if not arm.serial else f"{arm.serial} in the arm file; not read on the arm"
        return CheckRecord(check=name, found=found, verdict="not_checked", blind=blind)
    if arm.serial != read:
        found = f"{arm.serial} in the arm file, {read} on the arm"
        return CheckRecord(check=name, found=found, verdict="failed", kind="serial")
    return CheckRecord(check=name, found=f"{read} in the arm file and on the arm", verdict="passed")


def check_files(present: ArmIdentity, before: CommissioningRecord | None) -> CheckRecord:
    """Return what differs from the files that were commissioned before; a difference is no fault by itself."""
    name = "files"
    if before is None:
        return CheckRecord(check=name, found="not commissioned before", verdict="passed")
    changed = present.differences(before.parts())
    found = f"{'; '.join(changed.values()) or 'the same'}, compared with those of {before.date}"
    return CheckRecord(check=name, found=found, verdict="passed")
