# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""All checks of a commissioning, their page and JSON, and the record of an arm that passes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING

from posor.chain.commissioning_record import CheckRecord, CommissionedFiles, CommissioningContent
from posor.reporting.html_page import Cell, Section, bullet_list, definition_list, render_page, table

from posor_calibration.commissioning.file_checks import arm_identity, check_files, check_gates, check_serial
from posor_calibration.commissioning.motion_checks import (
    LONGEST_GAP_NS,
    check_encoder,
    check_nominal_motion,
    check_postures,
    check_residuals,
    estimate_motion,
    measured_angles,
)
from posor_calibration.commissioning.plan import steps_of
from posor_calibration.commissioning.plug_checks import Lift, check_cover, check_lift, check_scale

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile
    from posor.chain.commissioning_record import CommissioningRecord
    from posor.chain.identity import ArmIdentity
    from posor.chain.kinematic_chain import Chain

    from posor_calibration.commissioning.commissioning_recording import CommissioningRecording, RecordedStep
    from posor_calibration.commissioning.motion_checks import JointMotion
    from posor_calibration.commissioning.plan import CommissioningSettings

WORDS = {"passed": "passed", "failed": "FAILED", "not_checked": "not checked"}
STYLES = {"passed": "holds", "failed": "fails", "not_checked": ""}
NO_STEP = (
    "sign and size of the sensitivities to supply and temperature: no step changes either",
    "a growth of all gaps of a joint that is smaller than the limit of its nominal motion",
    "uncertainties in the files: no step repeats a calibration",
)
"""What no step of a commissioning can find."""


@dataclass(frozen=True)
class CommissioningReport:
    """Result of a commissioning."""

    arm: str
    serial: str
    date: str
    source: str  # of the recording, and its SHA-256
    sha256: str
    identity: ArmIdentity  # of the files, without a record
    checks: tuple[CheckRecord, ...]
    limits: Mapping[str, Mapping[str, tuple[float, float]]]  # observed native coordinates of each joint
    is_whole: bool  # whether all joints were checked

    @property
    def failed(self) -> list[CheckRecord]:
        """The checks that failed."""
        return [check for check in self.checks if check.verdict == "failed"]

    @property
    def sentence(self) -> str:
        """The verdict."""
        open_checks = sum(check.verdict == "not_checked" for check in self.checks)
        passed = len(self.checks) - len(self.failed) - open_checks
        rest = f"{passed} of {len(self.checks)} checks passed, {open_checks} were not possible"
        if self.failed:
            return f"{self.arm} is not commissioned: {len(self.failed)} checks failed; {rest}."
        return (
            f"{self.arm} passed: {rest}." if self.is_whole else f"The joints passed: {rest}; {self.arm} is not whole."
        )

    def record(self) -> CommissioningRecord | None:
        """Return the record of the arm; None: a check failed, or joints are missing."""
        if self.failed or not self.is_whole:
            return None
        parts = self.identity
        files = CommissionedFiles(calibrations=dict(parts.calibrations), urdf=parts.urdf, beams=parts.beams)
        limits = {joint: dict(spans) for joint, spans in self.limits.items()}
        return CommissioningContent(
            arm=self.arm,
            serial=self.serial,
            date=self.date,
            software=f"posor {version('posor')}",
            files=files,
            checks=self.checks,
            limits=limits,
        ).record()

    def to_json(self) -> str:
        """Return all results as JSON."""
        content = {
            "arm": self.arm,
            "serial": self.serial,
            "date": self.date,
            "recording": self.source,
            "recording_sha256": self.sha256,
            "passed": not self.failed,
            "verdict": self.sentence,
            "files": asdict(self.identity),
            "checks": [check.model_dump() for check in self.checks],
            "limits": self.limits,
            "found_by_no_step": NO_STEP,
        }
        return json.dumps(content, indent=1) + "\n"

    def to_page(self) -> str:
        """Return all results as a page."""
        rows = [
            (check.check, Cell(check.found, "wrapped"), Cell(WORDS[check.verdict], STYLES[check.verdict]))
            for check in self.checks
        ]
        blind = [(check.check, Cell(check.blind, "wrapped")) for check in self.checks if check.blind]
        files = {
            **{f"calibration of {joint}": number for joint, number in self.identity.calibrations.items()},
            "URDF": self.identity.urdf,
            "beams file": self.identity.beams or "none",
            "recording": f"{self.source} {self.sha256}",
        }
        spans = [
            (joint, name, f"{low:.9g}", f"{high:.9g}")
            for joint, limits in self.limits.items()
            for name, (low, high) in limits.items()
        ]
        sections = [
            Section("Checks", table(("check", "found", "verdict"), rows)),
            Section("Not found by a check", table(("check", "what it cannot find"), blind)),
            Section("Not found by any step", bullet_list(NO_STEP)),
            Section("Files", definition_list(files)),
            Section(
                "Observed native coordinates [m], [rad]", table(("joint", "coordinate", "least", "greatest"), spans)
            ),
        ]
        title = f"Commissioning of {self.arm}, {self.date}"
        return render_page(title, self.sentence, holds=not self.failed, sections=sections)


def check_commissioning(
    arm: ArmFile,
    chain: Chain,
    calibrations: Mapping[str, Calibration],
    recording: CommissioningRecording,
    settings: CommissioningSettings,
    *,
    date: str,
    before: CommissioningRecord | None = None,
) -> CommissioningReport:
    """Return the results of all checks.

    ``calibrations``: of the joints to check, in the order of the chain, sessions applied; ``date``: of today;
    ``before``: the present record of the arm. Raises CalibrationError: a file of the arm cannot be read.
    """
    identity = arm_identity(arm, calibrations)
    checks = [check_serial(arm, settings.serial), check_files(identity, before)]
    motions: dict[str, JointMotion] = {}
    steps = steps_of(calibrations, settings)
    for joint in calibrations:
        own = [step for step in steps if step.joint == joint]
        found = [each for each in map(recording.find, own) if each is not None]
        present = {each.step[:3] for each in found}
        checks += [
            CheckRecord(check=step.name, found="the step is missing", verdict="failed", kind="missing")
            for step in own
            if step[:3] not in present
        ]
        checks += _check_plugs(recording, calibrations, found)
        for sweep in (each for each in found if each.step.action == "sweep"):
            motions[joint] = estimate_motion(recording, calibrations[joint], sweep)
            checks += _check_sweep(chain, joint, recording, motions[joint], settings)
        checks.append(check_gates(joint, calibrations[joint], recording.scans[joint]))
    is_whole = set(calibrations) == set(arm.calibrations)
    if is_whole:
        postures = [each for each in recording.steps if each.step.action == "posture"]
        checks.append(check_postures(recording, chain, motions, postures, settings))
    limits = {joint: motion.limits() for joint, motion in motions.items()}
    return CommissioningReport(
        arm.name, arm.serial, date, recording.source, recording.sha256, identity, tuple(checks), limits, is_whole
    )


def _check_plugs(
    recording: CommissioningRecording, calibrations: Mapping[str, Calibration], steps: Sequence[RecordedStep]
) -> list[CheckRecord]:
    """Return the results of the plugs of a joint; without its rest there are none."""
    rest = next((each for each in steps if each.step.action == "rest"), None)
    checks: list[CheckRecord] = []
    if rest is None:
        return checks
    lifts: list[Lift] = []
    for each in steps:
        if each.step.action == "cover":
            checks.append(check_cover(recording, calibrations, rest, each))
        elif each.step.action == "lift":
            check, lift = check_lift(recording, calibrations, rest, each)
            checks.append(check)
            lifts += [] if lift is None or lift.ratio < 0.0 else [lift]
    return [*checks, check_scale(rest.step.joint, lifts)] if lifts else checks


def _check_sweep(
    chain: Chain, joint: str, recording: CommissioningRecording, motion: JointMotion, settings: CommissioningSettings
) -> list[CheckRecord]:
    """Return the results of a sweep: residuals; then, if there are poses, encoder and nominal motion."""
    results = [check_residuals(f"{joint}: residuals", motion)]
    if results[0].verdict == "failed":
        return results
    angles, encoder = measured_angles(chain, joint, motion), None
    if joint in recording.encoders:
        track = recording.encoders[joint]
        encoder = track.interpolate(motion.stamps_ns, LONGEST_GAP_NS)[:, 0]
    sweep = motion.sweep
    own = check_encoder(f"{joint}: encoder", angles[sweep], None if encoder is None else encoder[sweep], settings)
    reference = encoder if encoder is not None and own.verdict == "passed" else angles
    nominal = check_nominal_motion(f"{joint}: nominal motion", chain, joint, motion, reference, settings)
    return [*results, own, nominal]


def checked_joints(arm: ArmFile, joints: Collection[str]) -> dict[str, Calibration]:
    """Return the calibrations of some joints of an arm, sessions applied, in its order; empty: of all.

    Raises ParameterError: the arm has no such joint; CalibrationError: a calibration is invalid.
    """
    for joint in joints:
        arm.calibration(joint)
    return {joint: arm.calibration(joint) for joint in arm.calibrations if not joints or joint in joints}
