# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The files of a designed POSOR: an arm of one joint that ``posor bringup`` starts, its requirement and its budget."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from posor.arm_names import ARM_FILE
from posor.calibration.document_text import document_text
from posor.errors import OutputError, ParameterError
from posor.output_files import make_folder, write_files, writing
from posor.reporting.json_text import json_text

from posor_design.layout_search import objectives
from posor_design.posor_design_page import render_posor_page
from posor_design.posor_layout import CURRENT_SPAN, SPEED_RESERVE, VOLTAGE_SPAN
from posor_design.requirement import FREEDOMS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.reporting.command_line_parser import CommandLineParser

    from posor_design.layout_evaluation import Candidate
    from posor_design.layout_search import SearchResult
    from posor_design.posor_layout import PosorLayout
    from posor_design.requirement import Requirement

JOINT = "joint1"
FRAMES = (f"{JOINT}_receiving", f"{JOINT}_target")
CALIBRATION = f"calibrations/{JOINT}.yaml"
URDF, SCENARIO, REQUIREMENT = "posor.urdf", "scenario.yaml", "requirement.yaml"
PAGE, FIGURES = "design.html", "design.json"
PROGRAM = "posor design posor"
PLATE_THICKNESS = 0.0127  # of the plates in the URDF, assumed [m]
_SPLINE_TURNS = 12.0
"""Duration of the motion to either side and back, in times that theta takes from the middle to one side."""
_PART_OF_RANGE = 0.5  # error motions of the simulated bearing over the required range
_PART_OF_ROTATION = 0.9  # waypoints of theta over the required rotation: between them a spline goes further


def output_files(result: SearchResult, chosen: Candidate) -> dict[str, str]:
    """Return the texts of all files but the budget, by their paths in the folder."""
    requirement, layout = result.requirement, chosen.layout
    calibration = layout.calibration(requirement, FRAMES)
    return {
        REQUIREMENT: requirement_text(requirement),
        CALIBRATION: document_text(calibration.model_dump(mode="json"), made_by(PROGRAM)),
        URDF: urdf_text(requirement.name, layout),
        SCENARIO: document_text(_scenario(requirement, layout), made_by(PROGRAM)),
        ARM_FILE: arm_text(
            PROGRAM,
            requirement.name,
            f"designed for {REQUIREMENT}",
            urdf=URDF,
            endpoint_frame="endpoint",
            joints={JOINT: {"calibration": CALIBRATION}},
            driver={"source": "simulated"},
            scenario=SCENARIO,
        ),
        FIGURES: json_text(figures(result, chosen), indent=2),
        PAGE: render_posor_page(result, chosen),
    }


def made_by(program: str) -> str:
    """Return the comment of a file that a program makes."""
    return f"Made by {program}; SI units throughout."


def arm_text(program: str, name: str, source: str, **entries: Any) -> str:
    """Return the text of an arm file: its name, what it is designed for, and the other entries of the format."""
    provenance = {"source": source, "method": program, "date": "none"}
    content = {"format": "posor_arm", "version": 1, "name": name, "provenance": provenance, **entries}
    return document_text(content, f"{made_by(program)} Paths are relative to this file.")


def add_output_options(parser: CommandLineParser, name: str) -> None:
    """Add the options of ``output_folder``; ``name``: of the default folder, for help."""
    parser.add_argument("--output", metavar="FOLDER", help=f"default: build/design/{name}")
    parser.add_argument("--force", action="store_true", help="replace files of an earlier design")


def output_folder(text: str | None, name: str, first: str, *, force: bool) -> Path:
    """Return the folder of a design, checked before the search.

    ``text``: option ``--output``; None: ``build/design/<name>``. ``name``: name of the arm. ``first``: file that an
    earlier design left in its folder. ``force``: whether an earlier design is replaced. Raises ParameterError: the
    option is empty. Raises OutputError: the folder cannot be written, or holds an earlier design.
    """
    if text is not None and not text.strip():
        raise ParameterError(f"'{text}'", where="--output", expected="a folder")
    folder = Path("build/design") / name if text is None else Path(text)
    with writing(folder):
        nearest = next(each for each in (folder, *folder.absolute().parents) if each.exists())
        if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
            raise OutputError(f"cannot be written below {nearest}", where=str(folder), expected="a writable folder")
        if (folder / first).exists() and not force:
            raise OutputError(f"{first} exists already", where=str(folder), expected="another folder, or --force")
    return folder


def write_design(folder: Path, texts: Mapping[str, str], *, force: bool = False) -> None:
    """Write files into a folder, all or none.

    Raises OutputError: a file exists and ``force`` is false, or it cannot be written.
    """
    existing = [name for name in texts if (folder / name).exists()]
    if existing and not force:
        raise OutputError(f"{existing[0]} exists already", where=str(folder), expected="another folder, or --force")
    for name in texts:
        make_folder((folder / name).parent)
    write_files({folder / name: text for name, text in texts.items()})


def requirement_text(requirement: Requirement) -> str:
    """Return the text of a requirement file."""
    return document_text(requirement.model_dump(mode="json"), "A requirement for posor design posor; SI units.")


def urdf_text(name: str, layout: PosorLayout) -> str:
    """Return the URDF of a POSOR whose receiving plate is the base."""
    template = Path(__file__).with_name("posor.urdf.template").read_text(encoding="utf-8")
    return template.format(
        comment="Made by posor design posor. To use the joint in another arm, copy its two links and the joint.",
        name=name,
        joint=JOINT,
        parent=FRAMES[0],
        child=FRAMES[1],
        radius=f"{0.5 * layout.outside_diameter:.6g}",
        thickness=f"{PLATE_THICKNESS:g}",
        below=f"{-0.5 * PLATE_THICKNESS:g}",
        above=f"{0.5 * PLATE_THICKNESS:g}",
        gap=f"{layout.gap:.9g}",
    )


def _scenario(requirement: Requirement, layout: PosorLayout) -> dict[str, Any]:
    """Return a scenario in which the joint turns through its whole rotation, with error motions of half the range."""
    limits, rotation = requirement.range, _PART_OF_ROTATION * requirement.rotation
    turning = float(math.ceil(_SPLINE_TURNS * rotation / requirement.speed.number))
    text = Template(Path(__file__).with_name("scenario.json.template").read_text(encoding="utf-8")).substitute(
        name=requirement.name,
        joint=JOINT,
        radial=_PART_OF_RANGE * limits.runout.number,
        axial=_PART_OF_RANGE * limits.gap.number,
        tilt=_PART_OF_RANGE * limits.tilt.number,
        rate=requirement.scan_rate.number,
        duration=turning + 1.0,
        turning=turning,
        rotation=rotation,
        bits=layout.bits(requirement.scan_rate.number),
        volts=0.5 * VOLTAGE_SPAN,
        amperes=CURRENT_SPAN,
    )
    return dict(json.loads(text))


def figures(result: SearchResult, chosen: Candidate) -> dict[str, Any]:
    """Return requirement, chosen layout and trade-off, SI units."""
    return {
        "requirement": result.requirement.model_dump(mode="json"),
        "chosen": _candidate(result.requirement, chosen),
        "unobservable_causes": result.unobservable(chosen),
        "trade_off": [_candidate(result.requirement, each) for each in result.trade_off],
        "layouts_evaluated": result.evaluations,
        "layouts_that_meet_the_requirement": len(result.feasible),
        "largest_speed_of_the_calibration_rad_s": SPEED_RESERVE * result.requirement.speed.number,
    }


def _candidate(requirement: Requirement, candidate: Candidate) -> dict[str, Any]:
    return {
        "kind": candidate.kind.name,
        **asdict(candidate.layout),
        "gap_in_the_middle": candidate.layout.gap,
        "bits": candidate.layout.bits(requirement.scan_rate.number),
        "standard_uncertainty": dict(zip(FREEDOMS, map(float, candidate.sigmas), strict=True)),
        "share_of_required_uncertainty": objectives(requirement, candidate)["accuracy"],
        "minimal_detectable_fault": candidate.fault,
    }
