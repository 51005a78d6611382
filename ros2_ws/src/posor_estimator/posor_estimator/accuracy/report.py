"""The accuracy run: ``./run posor_estimator accuracy`` (``make accuracy``) prints a table and writes a JSON file."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from posor_estimator.accuracy.closure import closure
from posor_estimator.accuracy.consistency import monte_carlo, nees
from posor_estimator.accuracy.health import FAULTS, detection, ring_observability, visibility
from posor_estimator.accuracy.poses import STACKS
from posor_estimator.errors import ParameterError, PosorError

FULL = {"poses": 100_000, "runs": 10_000, "draws": 10_000, "faults": 1_000}
SEED = 1985

WHY = """\
Why: seven readings for six freedoms leave one contradiction that can show, the distance between the spots or the
two pairs of ring probes. A shift that only looks like another pose is seen by its jump alone: slower drift than
the limits of motion, and any shift before the first scan, cannot be told from motion.
False alarms are rarer than the 0.1 % that the chi-square test allows, since its limit leaves room for the
calibration's uncertainty, which these runs do without. The missed bump is a gap of 100 scans in a turn at 2 rad/s:
the count is put in doubt because it may have been lost, whether or not it was."""

Report = dict[str, dict[str, dict[str, float]]]


def accuracy_report(scale: float, progress: Progress) -> Report:
    """Run everything at a share of the full size; return the figures, named as in the JSON file."""
    sizes = {name: max(int(size * scale), 20) for name, size in FULL.items()}
    report: Report = {name: {} for name in ("closure", "closed_form", "nees", "monte_carlo", "health")}
    task = progress.add_task("accuracy", total=3 * len(STACKS) + len(FAULTS))
    for stack in STACKS:
        progress.update(task, description=f"closure of {stack}")
        exact, simple = closure(stack, sizes["poses"], SEED)
        report["closure"][stack], report["closed_form"][stack] = exact.as_dict(), simple.as_dict()
        progress.advance(task)
        progress.update(task, description=f"normalised errors of {stack}")
        report["nees"][stack] = nees(stack, sizes["runs"], SEED).as_dict()
        progress.advance(task)
        progress.update(task, description=f"Monte Carlo of {stack}")
        report["monte_carlo"][stack] = monte_carlo(stack, sizes["draws"], SEED).as_dict()
        progress.advance(task)
    for fault in FAULTS:
        progress.update(task, description=f"health: {fault}")
        report["health"][fault] = detection(fault, sizes["faults"], SEED).as_dict()
        progress.advance(task)
    return report


def print_report(report: Report, console: Console) -> None:
    """Print the figures as tables, and from which size on shifts of single readings can be seen."""
    table = Table(title="Accuracy of the estimator over the full range of each design (SI units)", title_justify="left")
    for column in ("stack", "closure", "closed form", "NEES / 6 in [95 % band]", "Monte Carlo / stated"):
        table.add_column(column)
    for stack in STACKS:
        exact, simple = report["closure"][stack], report["closed_form"][stack]
        normalised, ratios = report["nees"][stack], report["monte_carlo"][stack]
        table.add_row(
            stack,
            f"{exact['translation_m']:.1e} m\n{exact['rotation_rad']:.1e} rad",
            f"{simple['translation_m']:.1e} m\n{simple['rotation_rad']:.1e} rad",
            f"{normalised['mean']:.4f}\n[{normalised['low']:.4f}, {normalised['high']:.4f}]",
            f"random {ratios['random_ratio']:.3f}\nsystematic {ratios['systematic_ratio']:.3f}",
        )
    console.print(table)
    health = Table(title="Faults flagged in their first scan, at 1 kHz", title_justify="left")
    for column in ("fault", "design", "flagged", "false alarms"):
        health.add_column(column)
    for fault, figures in report["health"].items():
        flagged, alarms = figures["detected_fraction"], figures["false_alarm_fraction"]
        health.add_row(fault, FAULTS[fault][0], f"{100 * flagged:.1f} %", f"{100 * alarms:.3f} %")
    console.print(health)
    shifts = Table(
        title="Smallest shift of one reading that is flagged within one scan: as motion faster than the design's\n"
        "limits (1 mm/s, 0.02 rad/s of lean, 3 rad/s of theta), or as a contradiction of the redundant reading",
        title_justify="left",
    )
    for column in ("stack", "reading", "by motion", "by chi-square"):
        shifts.add_column(column)
    for stack in STACKS:
        for row in visibility(stack):
            by_residual = "never" if row.by_residual_m > 1e-3 else f"{1e6 * row.by_residual_m:.1f} um"  # noqa: PLR2004
            shifts.add_row(stack, row.reading, f"{1e6 * row.by_motion_m:.1f} um", by_residual)
    console.print(shifts)
    console.print(WHY)
    blindness = Table(
        title="How well a bumpy ring tells x, y and theta apart over the phase of a bump", title_justify="left"
    )
    for column in ("ring probes", "worst phase / best phase"):
        blindness.add_column(column)
    for probes in (3, 4):
        seen = ring_observability(probes)
        blindness.add_row(str(probes), f"{seen.min() / seen.max():.4f}")
    console.print(blindness)


def main(arguments: list[str] | None = None) -> int:
    """Run the accuracy report; the exit code is 0 when it could be made."""
    parser = argparse.ArgumentParser(prog="accuracy", description=str(__doc__).splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("build/accuracy.json"), help="JSON file to write")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full size, for a quick look")
    options = parser.parse_args(arguments)
    try:
        if not 0.0 < options.scale <= 1.0:
            raise ParameterError(f"--scale {options.scale}", expected="more than 0, at most 1")
        writable(options.output)
        with Progress(console=Console(stderr=True)) as progress:
            report = accuracy_report(options.scale, progress)
    except PosorError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print_report(report, Console(width=118))
    write_json(options.output, report)
    return 0


def writable(path: Path) -> Path:
    """Return the path of a file to write, its folder made.

    Raises:
        ParameterError: The folder cannot be made or written.

    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise ParameterError(f"cannot be written: {error.strerror}", where=f"--output {path}") from error
    return path


def write_json(path: Path, content: Any) -> None:
    """Write figures as JSON and say where."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    print(f"figures written to {path}")


if __name__ == "__main__":
    sys.exit(main())
