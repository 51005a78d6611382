# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``iso9283``: accuracy and repeatability of poses, distances and paths of a recorded arm (ISO 9283:1998)."""

from __future__ import annotations

import csv
import math
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.arm_names import describe_argument
from posor.bags.calibration_recording import Reference, bag_sha256, load_recording
from posor.bags.offline_pipeline import load_arm, topics_of
from posor.bags.recording import POINT, POSE
from posor.bags.reprocess_task import Settings, common_namespace
from posor.bags.result_folder import name_of_bag
from posor.errors import BagError, DataFileError, ParameterError
from posor.numerics.stamps import NS
from posor.output_files import make_folder, write_files
from posor.reporting.command_line_parser import CommandLineParser, number_above, number_from
from posor.reporting.json_text import json_text
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console
from posor.ros_names import ENDPOINT_TOPIC
from posor.tables.named_rows import read_named_rows
from posor_calibration.dwells import find_dwells
from posor_design.iso9283 import COMPONENTS, LEAST_CYCLES, PATH_CYCLES, POSE_CYCLES
from posor_design.iso9283_checks import count_elsewhere, interpolation_error, settling_of
from posor_design.iso9283_cycles import Sameness, distance_cycles, distance_pairs, motion_of, path_cycles, pose_cycles

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterable, Mapping, Sequence

    from posor.bags.recording import Track
    from posor.numerics.array_types import FloatArray
    from posor_design.iso9283 import Figures
    from posor_design.iso9283_cycles import Cycles, Motion, PathCycles, PoseCycles
    from rich.console import Console

WIDTH = 160
LARGEST_OPTION = 1e6  # [m] or [s]
DWELL_OPTIONS = {"still": 1e-5, "least": 0.2, "settle": 0.0}  # of dwells that are found, and their defaults [m], [s]
MOST_INTERPOLATION = 0.1  # error of a straight line between two readings, over the accuracy of a path
MOST_TURN = 0.1  # of the endpoint from the reference, median [rad]: more is another frame
MOST_DEVIATION = 0.1  # of the endpoint from the reference, median [m]: more is another unit, frame or point
LONGEST_GAP_S = 0.1  # between two readings of the reference, for a value between them
OUTPUT_FILES = ("iso9283.json", "points.csv")


def parse_options(arguments: Sequence[str] | None) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid."""
    parser = CommandLineParser(
        prog="posor iso9283", description="Accuracy and repeatability of poses, distances and paths (ISO 9283:1998)."
    )
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument("--bag", type=Path, required=True, help="raw scans of the arm, and the reference")
    text = "topic of the commanded or measured poses or points of the endpoint, in the base of the arm"
    parser.add_argument("--reference", required=True, metavar="TOPIC", help=text)
    text = f"the reference stands still within this [m] (default: {DWELL_OPTIONS['still']:g})"
    parser.add_argument("--still", type=number_above(0.0, LARGEST_OPTION, "m"), metavar="M", help=text)
    text = f"shortest time that it stands still [s] (default: {DWELL_OPTIONS['least']:g})"
    parser.add_argument("--least", type=number_above(0.0, LARGEST_OPTION, "s"), metavar="S", help=text)
    text = f"time left out at the beginning of each dwell, less than --least [s] (default: {DWELL_OPTIONS['settle']:g})"
    parser.add_argument("--settle", type=number_from(0.0, LARGEST_OPTION, "s"), metavar="S", help=text)
    text = "dwells whose references differ by less are cycles of one pose [m] (default: %(default)g)"
    parser.add_argument("--same", type=number_above(0.0, LARGEST_OPTION, "m"), default=1e-3, metavar="M", help=text)
    text = "and whose orientations differ by less [rad]; those of the endpoint if the reference is a point"
    text += " (default: %(default)g)"
    turn = number_above(0.0, math.pi, "rad")
    parser.add_argument("--same-turn", type=turn, default=1e-2, metavar="RAD", help=text)
    text = "dwells, in place of those that are found: a table with the columns begin_ns and end_ns"
    parser.add_argument("--dwells", type=Path, metavar="FILE.csv", help=text)
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/iso9283/<name of the bag>")
    options = parser.parse_args(arguments)
    for name, default in DWELL_OPTIONS.items():
        if getattr(options, name) is None:
            setattr(options, name, default)
        elif options.dwells is not None:
            raise ParameterError("is for dwells that are found", where=f"iso9283, --{name}", expected="no --dwells")
    if options.settle >= options.least:
        raise ParameterError(f"{options.settle:g} s", where="iso9283, --settle", expected="less than --least")
    options.output = options.output or Path("build/iso9283") / name_of_bag(options.bag)
    outputs = [options.output.resolve() / name for name in OUTPUT_FILES]
    if options.dwells is not None and options.dwells.resolve() in outputs:
        where = f"iso9283, --output {options.output}"
        raise ParameterError("the table of --dwells would be replaced", where=where, expected="another folder")
    return options


def _stated_dwells(path: Path) -> list[tuple[int, int]]:
    """Return the dwells of a table. Raises DataFileError: it cannot be read, or a dwell is invalid."""
    dwells: list[tuple[int, int]] = []
    for line, cells in read_named_rows(path, ("begin_ns", "end_ns")):
        try:
            begin, end = int(cells["begin_ns"]), int(cells["end_ns"])
        except ValueError:
            begin = end = 0
        if not (dwells[-1][1] if dwells else 0) < begin < end:
            what = f"dwell from {cells['begin_ns']} to {cells['end_ns']}"
            raise DataFileError(what, where=f"{path}, line {line}", expected="begin_ns before end_ns, in order")
        dwells.append((begin, end))
    return dwells


def _check_recorded(path: Path, dwells: Sequence[tuple[int, int]], motion: Motion) -> None:
    """Raise DataFileError if no dwell of a table overlaps the recording."""
    first, last = motion.stamps_ns[0].item(), motion.stamps_ns[-1].item()
    if all(begin > last or end < first for begin, end in dwells):
        what = f"dwells from {dwells[0][0]} to {dwells[-1][1]} ns, none of them in the recording"
        raise DataFileError(what, where=str(path), expected=f"dwells between {first} and {last} ns")


def _read(options: Namespace) -> tuple[Motion, Track, list[str]]:
    """Return the motion, the reference, and notes on endpoints that are left out or DEGRADED.

    Raises BagError: no common time, or a reference in another unit or frame, or of another point.
    """
    arm = load_arm(options.arm)
    topics = topics_of(options.bag, Settings.of_arm(arm).joints).raw
    if options.reference == f"{common_namespace(topics)}/{ENDPOINT_TOPIC}":
        what = f"topic {options.reference} is the endpoint that the POSORs have measured"
        raise BagError(what, where=str(options.bag), expected="a commanded endpoint, or that of another instrument")
    recording = load_recording(
        options.bag, topic=next(iter(topics.values())), references=[Reference(options.reference)]
    )
    track = recording.tracks[options.reference]
    columns = track.values.shape[1]
    if columns not in (POINT, POSE):
        raise BagError(
            f"topic {options.reference} holds {columns} numbers", where=str(options.bag), expected="poses or points"
        )
    base = arm.chain().base_frame
    if track.frame not in ("", base):
        what = f"topic {options.reference} is in the frame '{track.frame}'"
        raise BagError(what, where=str(options.bag), expected=f"'{base}', the base of {arm.path}")
    estimates = arm.estimate(options.bag)
    end = estimates.endpoint_of_one_run(str(options.bag))
    motion = motion_of(end.stamps_ns, end.poses, track, int(LONGEST_GAP_S * NS))
    deviation = float(np.median(np.linalg.norm(motion.positions - motion.references, axis=1)))
    if deviation > MOST_DEVIATION:
        what = f"topic {options.reference} is {deviation:.3g} m from the endpoint"
        expected = f"the same point in metres, in '{base}', within {MOST_DEVIATION:g} m"
        raise BagError(what, where=str(options.bag), expected=expected)
    if motion.reference_rotations is not None:
        turn = float(np.median((motion.rotations * motion.reference_rotations.inv()).magnitude()))
        if turn > MOST_TURN:
            what = f"topic {options.reference} is turned by {turn:.3g} rad from the endpoint"
            raise BagError(what, where=str(options.bag), expected=f"axes of '{base}' and of the endpoint, or points")
    missing = len(end) - len(motion.stamps_ns)
    notes = [f"{note}." for note in estimates.notes]
    if missing:
        notes.append(f"{missing} of {len(end)} endpoints have no reference and are left out.")
    if end.degraded.any():
        notes.append(f"DEGRADED endpoints: {np.count_nonzero(end.degraded)} of {len(end)}.")
    return motion, track, notes


def _notes(
    poses: Sequence[PoseCycles], paths: Sequence[PathCycles], unused: int, settling: FloatArray, same: float
) -> list[str]:
    notes = []
    if unused:
        notes.append(f"Dwells without an endpoint, left out: {unused}.")
    if settling.any():
        moved = f"{np.count_nonzero(settling)}, by up to {1e6 * settling.max():.2f} µm"
        notes.append(f"Dwells in which the endpoint still moves against the reference (see --settle): {moved}.")
    elsewhere = count_elsewhere(poses, same)
    if elsewhere:
        notes.append(
            f"Dwells whose endpoint is nearer to another pose, so the stamps may differ by a dwell: {elsewhere}."
        )
    for first, second in pairwise(poses):
        cycles = len(distance_cycles(first, second))
        if cycles < min(len(first.dwells), len(second.dwells)):
            counts = f"{cycles} of {len(first.dwells)} and {len(second.dwells)} dwells"
            notes.append(f"Distance of {first.name} to {second.name}: {counts} follow one another.")
    few = sorted({len(each.attained) for each in poses if len(each.attained) < POSE_CYCLES})
    if few:
        notes.append(f"{', '.join(map(str, few))} cycles of a pose; ISO 9283 asks for {POSE_CYCLES}.")
    short = sorted({each.attained.shape[1] for each in paths if each.attained.shape[1] < PATH_CYCLES})
    if short:
        notes.append(f"{', '.join(map(str, short))} cycles of a path; ISO 9283 asks for {PATH_CYCLES}.")
    return notes


def _table(title: str, rows: Mapping[str, Figures]) -> ReportTable:
    """Return figures in µm and µrad; NaN: no orientation is known."""
    names = [name for name in next(iter(rows.values())) if any(math.isfinite(row[name]) for row in rows.values())]
    header = ("", *(f"{name} [{'µrad' if name[-1] in COMPONENTS[3:] else 'µm'}]" for name in names))
    cells = [[label, *(f"{1e6 * row[name]:.2f}".replace("nan", "-") for name in names)] for label, row in rows.items()]
    return ReportTable(title, header, cells)


def _points_csv(found: Iterable[Cycles]) -> str:
    """Return all points with all digits: cycle 0, dwell 0 is the commanded one."""
    text = StringIO()
    writer = csv.writer(text)
    writer.writerow(("what", "name", "point", "cycle", "dwell", *COMPONENTS))
    for each in found:
        commanded = each.commanded.reshape(-1, 1, len(COMPONENTS))
        attained = each.attained.reshape(len(commanded), -1, len(COMPONENTS))
        for point, rows in enumerate(np.concatenate([commanded, attained], axis=1)):
            for cycle, (dwell, row) in enumerate(zip((0, *each.dwells), rows, strict=True)):
                writer.writerow((each.kind, each.name, point, cycle, dwell, *map(repr, map(float, row))))
    return text.getvalue()


def _print(console: Console, tables: Iterable[tuple[str, Mapping[str, Figures]]], notes: Iterable[str]) -> None:
    for title, rows in tables:
        if rows:
            _table(title, rows).print(console)
    for note in notes:
        console.print(note, markup=False)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the figures have been written."""
    options = parse_options(arguments)
    stated = None if options.dwells is None else _stated_dwells(options.dwells)
    motion, track, notes = _read(options)
    if stated:
        _check_recorded(options.dwells, stated, motion)
    dwells = stated or [
        (each.begin_ns, each.end_ns)
        for each in find_dwells(track, options.still, int(options.least * NS), settle_ns=int(options.settle * NS))
    ]
    poses, numbers = pose_cycles(motion, dwells, Sameness(options.same, options.same_turn))
    paths = path_cycles(motion, dwells, numbers, options.same)
    usable = [each for each in poses if len(each.attained) >= LEAST_CYCLES]
    if not usable:
        what = f"{len(dwells)} dwells of the reference, none of them at the same pose as another"
        raise BagError(
            what,
            where=f"{options.bag}, topic {options.reference}",
            expected=f"at least {LEAST_CYCLES} cycles of a pose",
        )
    pairs = distance_pairs(usable, options.same)
    of_poses = {f"{each.name}, {len(each.attained)} cycles": each.figures() for each in usable}
    of_distances = {f"{first} to {second}": figures for (first, second), figures in pairs.items()}
    of_paths = {f"{each.name}, {each.attained.shape[1]} cycles": each.figures() for each in paths}
    single = [each.name for each in poses if len(each.attained) < LEAST_CYCLES]
    if single:
        notes.append(f"One cycle only, so without figures: {', '.join(single)}.")
    notes += _notes(usable, paths, numbers.count(-1), settling_of(motion, dwells), options.same)
    between = interpolation_error(motion, track, dwells)
    if between > MOST_INTERPOLATION * min((each["AT_p"] for each in of_paths.values()), default=math.inf):
        what = f"up to {1e6 * between:.1f} µm off their straight line, which is much of AT_p"
        notes.append(f"Between two readings of the reference a path may be {what}.")
    content: dict[str, Any] = {
        "format": "posor_iso9283",
        "version": 1,
        "bag": {"path": str(options.bag), "sha256": bag_sha256(options.bag), "reference": options.reference},
        "dwells": dwells,
        "poses": of_poses,
        "distances": of_distances,
        "paths": of_paths,
        "notes": notes,
    }
    make_folder(options.output)
    json_file, points_file = (options.output / name for name in OUTPUT_FILES)
    write_files({json_file: json_text(content, indent=2), points_file: _points_csv((*usable, *paths))})
    console = report_console(WIDTH)
    tables = ("Poses", of_poses), ("Distances", of_distances), ("Paths", of_paths)
    _print(console, tables, notes)
    console.print(f"figures and points: {options.output}", soft_wrap=True, markup=False)
    return 0
