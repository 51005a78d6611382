# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the estimator on simulated scans: ``./run posor_lab accuracy`` prints tables and writes JSON.

With ``--design FOLDER`` it simulates a POSOR of ``posor design posor`` instead, and compares it with its requirement.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import ARM_FILE
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor
from posor.model.native_coordinates import native_from_rotation, native_jacobian
from posor.numerics.vector import wrapped_angles
from posor.reporting.command_line_parser import CommandLineParser, number_above
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console
from posor_design.layout_evaluation import random_poses
from posor_design.posor_output import JOINT, REQUIREMENT
from posor_design.requirement import FREEDOMS, load_requirement
from rich.console import Console
from rich.progress import Progress

from posor_lab.accuracy.consistency import FALSE_ALARM, DrawnPosors, Nees, closure, monte_carlo, nees, normalised
from posor_lab.accuracy.fault_detection import FAULTS, detectable_shifts, detection, ring_observability
from posor_lab.harness.random_poses import STACKS, errors_in_parent
from posor_lab.lab_output import parse_study, write_json

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.accuracy.fault_detection import DetectableShift

BAND = 0.99  # probability that the mean normalised error of a consistent estimator is in its band


@dataclass(frozen=True)
class DesignConfirmation:
    """Errors of drawn POSORs."""

    required: dict[str, float]  # largest standard uncertainty of each freedom [m, rad]
    errors: dict[str, float]  # root mean square of the errors over all draws
    stated: dict[str, float]  # root mean square of the standard uncertainties that the estimator stated
    nees: Nees  # normalised errors with the total covariance
    draws: int  # number of draws
    lost: int  # draws without a pose

    @property
    def within(self) -> bool:
        """Whether no error is larger than required."""
        return all(self.errors[name] <= self.required[name] for name in FREEDOMS)

    @property
    def consistent(self) -> bool:
        """Whether the errors agree with the stated covariances."""
        return self.nees.low <= self.nees.mean <= self.nees.high

    @property
    def confirmed(self) -> bool:
        """Whether the simulation confirms the requirement."""
        return self.within and self.consistent and self.lost == 0


def confirm_design(folder: Path, draws: int, seed: int) -> DesignConfirmation:
    """Simulate the POSOR in a folder of ``posor design posor``.

    Raises CalibrationError: a file of the folder is missing or invalid. Raises ChainError: its URDF is invalid.
    """
    requirement, arm = load_requirement(folder / REQUIREMENT), load_arm_file(folder / ARM_FILE)
    gap = float(arm.chain().nominal_joint(JOINT, 0.0).translation[2])
    random = np.random.default_rng(seed)
    posor = Posor(arm.calibration(JOINT), false_alarm=FALSE_ALARM)
    posors = DrawnPosors(posor, random)
    poses = random_poses(requirement, gap, draws, random)
    rotations, translations, thetas = poses.rotations, poses.translations, poses.thetas
    errors, native = np.empty((draws, len(FREEDOMS))), np.empty((draws, len(FREEDOMS)))
    covariances, known = np.empty((draws, 6, 6)), np.zeros(draws, dtype=bool)
    variances = np.empty((draws, len(FREEDOMS)))
    for n in range(draws):
        rotation, translation = rotations[n : n + 1], translations[n : n + 1]
        found = posor.estimate_each(posors.scans(rotation, translation, random), thetas[n : n + 1])
        known[n] = np.isfinite(found.thetas[0])
        if not known[n]:
            continue
        errors[n] = errors_in_parent(found.rotations, found.translations, rotation, translation)[0]
        covariances[n] = found.covariances_random[0] + found.covariances_systematic[0]
        turned = np.subtract(native_from_rotation(found.rotations[0]), native_from_rotation(rotation[0]))
        native[n] = *(found.translations[0] - translation[0]), *wrapped_angles(turned)
        jacobian = native_jacobian(rotation[0])
        turns = jacobian @ covariances[n, 3:, 3:] @ jacobian.T
        variances[n] = *np.diagonal(covariances[n])[:3], *np.diagonal(turns)

    def by_freedom(values: FloatArray) -> dict[str, float]:
        return dict(zip(FREEDOMS, map(float, values), strict=True))

    return DesignConfirmation(
        required=by_freedom(requirement.sigmas),
        errors=by_freedom(np.sqrt(np.mean(np.square(native[known]), axis=0))),
        stated=by_freedom(np.sqrt(np.mean(variances[known], axis=0))),
        nees=normalised(errors[known], covariances[known], BAND),
        draws=draws,
        lost=int(np.sum(~known)),
    )


def design_rows(confirmation: DesignConfirmation) -> list[tuple[str, ...]]:
    """Return a row for each freedom: required, error, stated, error over required."""
    required, errors, stated = confirmation.required, confirmation.errors, confirmation.stated
    return [
        (name, *(f"{each[name]:.3e}" for each in (required, errors, stated)), f"{errors[name] / required[name]:.2f}")
        for name in FREEDOMS
    ]


def design_verdict(confirmation: DesignConfirmation) -> str:
    """Return the result in words."""
    nees = confirmation.nees
    errors = "All errors are within" if confirmation.within else "An error exceeds"
    agree = "agree with" if confirmation.consistent else "differ from"
    return (
        f"{errors} the requirement. NEES / 6 {nees.mean:.4f}, {100 * BAND:.0f} % band [{nees.low:.4f}, {nees.high:.4f}]"
        f": errors {agree} the stated covariances. {confirmation.lost} of {confirmation.draws} draws gave no pose."
    )


FULL = {"poses": 100_000, "runs": 10_000, "draws": 10_000, "faults": 1_000, "designs": 2_000}
SEED, WIDTH = 1985, 118
LARGEST_SHIFT_M = 1e-3

EXPLANATION = """\
Seven readings for six freedoms leave one contradiction: the distance between the spots, or the two pairs of ring
probes. A shift that resembles another pose is seen by its jump alone: drift slower than the motion limits, and any
shift before the first scan, cannot be distinguished from motion.
False alarms are rarer than the 0.1 % that the chi-square test allows, because its limit includes the calibration's
uncertainty, which these runs do not have. The missed bump is a gap of 100 scans in a turn at 2 rad/s: the count is
put in doubt because it may have been lost, whether or not it was."""

Report = dict[str, dict[str, dict[str, float]]]


def _measure_accuracy(scale: float, progress: Progress) -> Report:
    """Run everything at a share of the full size; return the figures, named as in the JSON file."""
    sizes = {name: max(int(size * scale), 20) for name, size in FULL.items()}
    report: Report = {name: {} for name in ("closure", "closed_form", "nees", "monte_carlo", "health")}
    task = progress.add_task("accuracy", total=3 * len(STACKS) + len(FAULTS))
    for stack in STACKS:
        progress.update(task, description=f"closure of {stack}")
        exact, simple = closure(stack, sizes["poses"], SEED)
        report["closure"][stack], report["closed_form"][stack] = asdict(exact), asdict(simple)
        progress.update(task, advance=1, description=f"normalised errors of {stack}")
        report["nees"][stack] = asdict(nees(stack, sizes["runs"], SEED))
        progress.update(task, advance=1, description=f"Monte Carlo of {stack}")
        report["monte_carlo"][stack] = asdict(monte_carlo(stack, sizes["draws"], SEED))
        progress.advance(task)
    for fault in FAULTS:
        progress.update(task, description=f"fault: {fault}")
        report["health"][fault] = asdict(detection(fault, sizes["faults"], SEED))
        progress.advance(task)
    return report


def _print_report(report: Report, console: Console) -> None:
    """Print the figures as tables, and the smallest shifts of single readings that are flagged."""
    title = "Accuracy of the estimator over the full range of each design (SI units)"
    columns = ("stack", "closure", "closed form", "NEES / 6 in [95 % band]", "Monte Carlo / stated")
    ReportTable(title, columns, [_stack_row(report, stack) for stack in STACKS]).print(console)
    rows: list[tuple[str, ...]] = [
        (
            fault,
            FAULTS[fault][0],
            f"{100 * found['detected_fraction']:.1f} %",
            f"{100 * found['false_alarm_fraction']:.3f} %",
        )
        for fault, found in report["health"].items()
    ]
    title = "Faults flagged in their first scan, at 1 kHz"
    ReportTable(title, ("fault", "design", "flagged", "false alarms"), rows).print(console)
    title = (
        "Smallest shift of one reading that is flagged within one scan: as motion faster than the design's\n"
        "limits (1 mm/s, 0.02 rad/s of lean, 3 rad/s of theta), or as a contradiction of the redundant reading"
    )
    rows = [_shift_row(stack, shift) for stack in STACKS for shift in detectable_shifts(stack)]
    ReportTable(title, ("stack", "reading", "by motion", "by chi-square"), rows).print(console)
    console.print(EXPLANATION)
    rings = [(probes, ring_observability(probes)) for probes in (3, 4)]
    ratios = [(str(probes), f"{each.min() / each.max():.4f}") for probes, each in rings]
    title = "Observability of x, y and theta by a bumpy ring over the phase of a bump"
    ReportTable(title, ("ring probes", "worst phase / best phase"), ratios).print(console)


def _stack_row(report: Report, stack: str) -> tuple[str, ...]:
    exact, simple, normalised, ratios = (
        report[name][stack] for name in ("closure", "closed_form", "nees", "monte_carlo")
    )
    return (
        stack,
        *(f"{error['translation_m']:.1e} m\n{error['rotation_rad']:.1e} rad" for error in (exact, simple)),
        f"{normalised['mean']:.4f}\n[{normalised['low']:.4f}, {normalised['high']:.4f}]",
        f"random {ratios['random_ratio']:.3f}\nsystematic {ratios['systematic_ratio']:.3f}",
    )


def _shift_row(stack: str, shift: DetectableShift) -> tuple[str, ...]:
    never = shift.by_residual_m > LARGEST_SHIFT_M
    by_residual = "never" if never else f"{1e6 * shift.by_residual_m:.1f} um"
    return stack, shift.reading, f"{1e6 * shift.by_motion_m:.1f} um", by_residual


def _confirm_design(folder: Path, scale: float, output: Path) -> int:
    """Print and write how a designed POSOR meets its requirement; exit code 0: the simulation confirms it."""
    draws = max(int(FULL["designs"] * scale), 20)
    confirmation = confirm_design(folder, draws, SEED)
    columns = ("freedom", "required", "error rms", "stated rms", "error / required")
    title = f"Simulated errors of {draws} POSORs drawn from {folder}, one pose each (standard uncertainties, SI units)"
    ReportTable(title, columns, design_rows(confirmation)).print(report_console(WIDTH))
    print(design_verdict(confirmation))
    write_json(output, {"design": asdict(confirmation)})
    return 0 if confirmation.confirmed else 1


@reports_errors
def main(arguments: list[str] | None = None) -> int:
    """Run the program; the exit code is 0 if the report could be made, or the requirement of a design is confirmed."""
    parser = CommandLineParser(prog="accuracy", description=str(__doc__).splitlines()[0])
    text = "share of the full size, for a quick look"
    parser.add_argument("--scale", type=number_above(0.0, 1.0), default=1.0, help=text)
    parser.add_argument("--design", type=Path, metavar="FOLDER", help="output of posor design posor to simulate")
    options = parse_study(parser, "build/accuracy.json", arguments)
    if options.design is not None:
        return _confirm_design(options.design, options.scale, options.output)
    with Progress(console=Console(stderr=True)) as progress:
        report = _measure_accuracy(options.scale, progress)
    _print_report(report, report_console(WIDTH))
    write_json(options.output, report)
    return 0
