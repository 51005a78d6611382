"""A statement as tables, JSON, one page (HTML), and the same page as PDF."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin
import typst
from markupsafe import Markup
from posor.chain.fault_bounds import INTEGRITY_RISK
from posor.reporting.html_page import Section, bullet_list, paragraph, render_page, table
from posor.reporting.report_table import ReportTable

from posor_design.endpoint_components import Kind
from posor_design.reliability_report import AXES
from posor_design.statement_map import draw_map
from posor_design.statement_records import Origin

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console

    from posor_design.statement import Statement
    from posor_design.statement_records import Record

FORMAT, VERSION = "posor_statement", 1
OUTPUT_FILES = ("statement.json", "statement.html", "statement.pdf")
TEMPLATE = Path(__file__).with_name("statement.typ")
LEAST_SHARE = 5e-4  # smaller shares have no digit
PIXELS_PER_INCH = 110.0  # of a picture
MOST_FREEDOMS = 1e4  # more make no difference
_UNITS = ("µm",) * 3 + ("µrad",) * 3

Cell = str | Origin


@dataclass(frozen=True)
class StatementTable:
    """A table whose cells may be origins, which are links on the page."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""


def micro(value: float) -> str:
    """Return metres or radians in µm or µrad with three digits."""
    if math.isinf(value):
        return "∞"
    scaled = 1e6 * value
    if abs(scaled) < 5e-4:  # noqa: PLR2004  half a nanometre, or a nanoradian
        return "0"
    return f"{scaled:#.3g}".rstrip(".") if abs(scaled) < 1e3 else f"{scaled:.0f}"  # noqa: PLR2004  three digits


def _percent(share: float) -> str:
    if share < LEAST_SHARE:
        return "< 0.1 %" if share else ""
    return f"{100.0 * share:.1f} %"


def _freedoms(number: float) -> str:
    return "∞" if math.isinf(number) else f"{number:.0f}" if number < MOST_FREEDOMS else f"> {MOST_FREEDOMS:g}"


def verdict(statement: Statement) -> str:
    """Return the sentence of the whole statement."""
    worst = statement.worst
    x, y, z = worst.T_base_endpoint.translation
    level = statement.reliability.protection_level[statement.level_axis]
    joint, cause = statement.reliability.set_by[statement.level_axis]
    bounded = (
        f"an undetected fault leaves it within {micro(level)} µm along each axis"
        if math.isfinite(level)
        else "an undetected fault may move it without bound"
    )
    return (
        f"The endpoint of {statement.arm.name} is at x {x:.6f}, y {y:.6f}, z {z:.6f} m in {statement.base_frame} to "
        f"within {micro(worst.largest)} µm along any direction (U, 95 %); {bounded} ({joint}: {cause})."
    )


def tables(statement: Statement) -> list[StatementTable]:
    """Return all tables of the page."""
    return [
        _uncertainty(statement),
        _ellipsoid(statement),
        _shares(statement),
        _components(statement),
        _protection(statement),
        _conditions(statement),
        _records(statement),
    ]


def _uncertainty(statement: Statement) -> StatementTable:
    worst = statement.worst
    values = [*worst.T_base_endpoint.translation, *pin.rpy.matrixToRpy(worst.T_base_endpoint.rotation)]
    rows = [
        [
            axis,
            f"{value:.6f} {'m' if n < 3 else 'rad'}",  # noqa: PLR2004  positions first
            f"{micro(worst.standard[n])} {unit}",
            _freedoms(worst.freedoms[n]),
            f"{worst.factors[n]:.2f}",
            f"± {micro(worst.expanded[n])} {unit}",
        ]
        for n, (axis, value, unit) in enumerate(zip(AXES, values, _UNITS, strict=True))
    ]
    header = ("axis", "value", "u", "degrees of freedom", "k", "U")
    return StatementTable("Endpoint", header, rows, "Axes of the base; orientation as roll, pitch, yaw.")


def _ellipsoid(statement: Statement) -> StatementTable:
    worst = statement.worst
    rows = [
        [f"semi-axis {n + 1}", f"{micro(length)} µm", ", ".join(f"{round(part, 3) + 0.0:.3f}" for part in direction)]
        for n, (length, direction) in enumerate(zip(worst.ellipsoid, worst.ellipsoid_axes.T, strict=True))
    ]
    note = f"Coverage factor {worst.ellipsoid_factor:.2f} for three dimensions."
    return StatementTable("Position ellipsoid, 95 %", ("", "length", "direction in the base"), rows, note)


def _shares(statement: Statement) -> StatementTable:
    """Return the shares of sources and kinds in the variance of the position: rows and columns add up to 100 %."""
    worst, kinds = statement.worst, list(Kind)
    sources = list(dict.fromkeys(each.source for each in worst.components))
    sources.sort(key=lambda source: -statement.share_of(source=source))
    rows = [
        [
            source,
            *(_percent(statement.share_of(kind=kind, source=source)) for kind in kinds),
            _percent(statement.share_of(source=source)),
        ]
        for source in sources
    ]
    rows.append(["all", *(_percent(statement.share_of(kind=kind)) for kind in kinds), "100.0 %"])
    return StatementTable("Shares of the variance of the position", ("source", *kinds, "all"), rows)


def _components(statement: Statement) -> StatementTable:
    worst = statement.worst
    shares = worst.position_shares()
    order = sorted(range(len(shares)), key=lambda n: -shares[n])
    rows: list[list[Cell]] = []
    small = [n for n in order if shares[n] < LEAST_SHARE]
    for n in order[: len(order) - len(small)]:
        each = worst.components[n]
        sigmas = np.sqrt(np.diagonal(each.covariance))
        origin: Cell = statement.origins[n]
        what = ""
        if each.kind is Kind.SYSTEMATIC and each.source in statement.largest:
            largest = statement.largest[each.source]
            what, origin = f"{largest.name} ({100.0 * largest.share:.0f} %)", largest.origin
        rows.append(
            [each.source, each.kind, *map(micro, sigmas), _percent(shares[n]), _freedoms(each.freedoms), what, origin]
        )
    if small:
        sigmas = np.sqrt(sum(np.diagonal(worst.components[n].covariance) for n in small))
        share = _percent(float(shares[small].sum()))
        rows.append([f"{len(small)} smaller", "", *map(micro, sigmas), share, "", "", ""])
    units = (f"{axis} [{unit}]" for axis, unit in zip(AXES, _UNITS, strict=True))
    header = ("source", "kind", *units, "share", "dof", "largest quantity", "origin")
    return StatementTable(
        "Components",
        header,
        rows,
        "Standard uncertainties; share in the variance of the position; dof: degrees of freedom.",
    )


def _protection(statement: Statement) -> StatementTable:
    reliability = statement.reliability
    rows = [
        [axis, f"{micro(level)} {unit}", f"{joint}: {cause}", _cause_source(statement, joint, cause)]
        for axis, unit, level, (joint, cause) in zip(
            AXES, _UNITS, reliability.protection_level, reliability.set_by, strict=True
        )
    ]
    note = (
        "An undetected fault of one cause leaves the error within the level, but for an integrity risk of "
        f"{INTEGRITY_RISK:g} for one scan and axis. ∞: not bounded."
    )
    return StatementTable("Protection level", ("axis", "level", "set by", "source of the bound"), rows, note)


def _cause_source(statement: Statement, joint: str, cause: str) -> str:
    known = statement.reliability.joints.get(joint)
    causes = [] if known is None else known.hypotheses.causes
    return next((each.source for each in causes if each.name == cause), "")


def _conditions(statement: Statement) -> StatementTable:
    worst = statement.worst
    angles = ", ".join(f"{name} {angle:.4f} ({math.degrees(angle):.2f}°)" for name, angle in worst.angles.items())
    rows: list[list[Cell]] = [["joint angles", f"{angles} rad", statement.name]]
    rows += [[each.name, each.text, each.origin] for each in statement.conditions]
    return StatementTable("Conditions", ("condition", "value", "origin"), rows)


def _records(statement: Statement) -> StatementTable:
    rows: list[list[Cell]] = [
        [each.role, Origin(each.role, each.path.name), each.source, each.date, each.sha256]
        for each in statement.records.all.values()
    ]
    serial = statement.arm.serial or "not stated"
    note = f"Arm {statement.arm.name}, serial number {serial}, identity {statement.identity}."
    return StatementTable("Records", ("record", "file", "source", "date", "SHA-256"), rows, note)


def as_json(statement: Statement) -> dict[str, Any]:
    """Return everything by name, SI units; null: infinite, or not stated."""
    worst = statement.worst
    shares, all_shares = worst.position_shares(), worst.shares()
    return {
        "format": FORMAT,
        "version": VERSION,
        "issued": statement.issued,
        "software": statement.software,
        "arm": {"name": statement.arm.name, "serial": statement.arm.serial, "identity": statement.identity},
        "frames": {"base": statement.base_frame, "endpoint": statement.arm.endpoint_frame},
        "pose": {
            "name": statement.name,
            "angles": dict(worst.angles),
            "position": worst.T_base_endpoint.translation.tolist(),
            "quaternion": pin.SE3ToXYZQUAT(worst.T_base_endpoint)[3:].tolist(),
        },
        "uncertainty": {
            axis: {
                "unit": "m" if unit == "µm" else "rad",
                "standard": float(worst.standard[n]),
                "degrees_of_freedom": _finite(worst.freedoms[n]),
                "coverage_factor": float(worst.factors[n]),
                "expanded": float(worst.expanded[n]),
                "protection_level": _finite(statement.reliability.protection_level[n]),
                "protection_level_set_by": dict(zip(("joint", "cause"), statement.reliability.set_by[n], strict=True)),
            }
            for n, (axis, unit) in enumerate(zip(AXES, _UNITS, strict=True))
        },
        "position": {
            "largest": _finite(worst.largest),
            "coverage_factor": _finite(worst.ellipsoid_factor),
            "semi_axes": [_finite(length) for length in worst.ellipsoid],
            "directions": worst.ellipsoid_axes.T.tolist(),
        },
        "components": [
            {
                "source": each.source,
                "kind": str(each.kind),
                "standard_uncertainty": np.sqrt(np.diagonal(each.covariance)).tolist(),
                "covariance": each.covariance.tolist(),
                "degrees_of_freedom": _finite(each.freedoms),
                "share_of_position": float(shares[n]),
                "shares": all_shares[n].tolist(),
                "origin": _origin_json(statement.origins[n]),
            }
            for n, each in enumerate(worst.components)
        ],
        "shares": {
            "by_kind": {str(kind): statement.share_of(kind=kind) for kind in Kind},
            "by_source": {
                source: statement.share_of(source=source)
                for source in dict.fromkeys(each.source for each in worst.components)
            },
        },
        "largest_quantities": {
            joint: {"name": each.name, "share": each.share, "origin": _origin_json(each.origin)}
            for joint, each in statement.largest.items()
        },
        "conditions": {
            each.name: {
                "value": each.text,
                "origin": _origin_json(each.origin) if isinstance(each.origin, Origin) else each.origin,
            }
            for each in statement.conditions
        },
        "sentences": [verdict(statement), *statement.sentences()],
        "reservations": list(statement.reservations),
        "records": [
            {"role": each.role, "path": str(each.path), "sha256": each.sha256, "source": each.source, "date": each.date}
            for each in statement.records.all.values()
        ],
        "map": [
            {
                "name": name,
                "angles": dict(each.angles),
                "position": each.T_base_endpoint.translation.tolist(),
                "largest": _finite(each.largest),
                "expanded": [_finite(number) for number in each.expanded],
            }
            for name, each in zip(statement.names, statement.poses, strict=True)
        ],
    }


def _origin_json(origin: Origin) -> dict[str, Any]:
    return {"record": origin.role, "file": origin.file, "line": origin.line or None, "key": origin.key}


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None


def _anchor(statement: Statement, origin: Origin) -> str:
    number = list(statement.records.all).index(origin.role)
    return f"record-{number}-{origin.line}" if origin.line else f"record-{number}"


def render_statement_page(statement: Statement) -> str:
    """Return the page as HTML without external references; the files follow the statement, line by line."""

    def cell(content: Cell) -> str:
        if not isinstance(content, Origin):
            return content
        key = content.key or content.role
        return Markup('<a href="#{}" title="{}">{}</a>').format(_anchor(statement, content), key, content)

    sections = [
        Section(
            each.title,
            table(each.header, [[cell(content) for content in row] for row in each.rows])
            + (paragraph(each.note) if each.note else ""),
        )
        for each in tables(statement)
    ]
    if len(statement.poses) > 1:
        drawing = Markup(draw_map(statement))  # noqa: S704  made of numbers
        sections.insert(2, Section("Map", drawing + paragraph(map_note(statement))))
    sections.insert(0, Section("What U means", bullet_list(statement.sentences())))
    if statement.reservations:
        sections.insert(0, Section("Not in the numbers", bullet_list(statement.reservations)))
    texts = Markup("").join(_record_text(n, each) for n, each in enumerate(statement.records.all.values()))
    sections.append(Section("Files", Markup('<div class="records">{}</div>').format(texts)))
    return render_page(
        f"Uncertainty of the endpoint of {statement.arm.name}\nissued {statement.issued} by {statement.software}",
        verdict(statement),
        holds=bool(np.isfinite(statement.reliability.protection_level).all()),
        sections=sections,
    )


def _record_text(number: int, record: Record) -> Markup:
    lines = Markup("").join(
        Markup('<span id="record-{}-{}" data-line="{}">{}</span>\n').format(number, n, n, line)
        for n, line in enumerate(record.text.splitlines(), start=1)
    )
    heading = Markup('<h3 id="record-{}">{}: {}</h3>').format(number, record.role, record.path)
    return heading + Markup("<pre>{}</pre>").format(lines)


def map_note(statement: Statement) -> str:
    """Return what the map shows."""
    best = min(statement.poses, key=lambda each: each.largest)
    span = f"{micro(best.largest)} to {micro(statement.worst.largest)} µm"
    return f"{len(statement.poses)} poses, U from {span}; the worst is {statement.name}, which the statement is about."


def render_sheet(statement: Statement, kind: Literal["pdf", "png"] = "pdf") -> list[bytes]:
    """Return the statement on paper, with the fonts that typst brings: a PDF, or a picture of each page."""
    content = {
        "title": f"Uncertainty of the endpoint of {statement.arm.name}",
        "issued": f"issued {statement.issued} by {statement.software}",
        "verdict": verdict(statement),
        "sentences": statement.sentences(),
        "reservations": list(statement.reservations),
        "map": draw_map(statement) if len(statement.poses) > 1 else "",
        "map_note": map_note(statement),
        "tables": [
            {
                "title": each.title,
                "header": list(each.header),
                "rows": [
                    [
                        {"text": str(content), "link": f"statement.html#{_anchor(statement, content)}"}
                        if isinstance(content, Origin)
                        else {"text": str(content), "link": ""}
                        for content in row
                    ]
                    for row in each.rows
                ],
                "note": each.note,
            }
            for each in tables(statement)
        ],
    }
    inputs = {"statement": json.dumps(content)}
    sheet: bytes | list[bytes] = typst.compile(
        TEMPLATE, format=kind, ppi=PIXELS_PER_INCH, sys_inputs=inputs, ignore_system_fonts=True
    )
    return sheet if isinstance(sheet, list) else [sheet]


def write_statement(statement: Statement, folder: Path) -> None:
    """Write JSON, page and PDF into an existing folder."""
    json_file, page_file, pdf_file = (folder / name for name in OUTPUT_FILES)
    json_file.write_text(json.dumps(as_json(statement), indent=2) + "\n", encoding="utf-8")
    page_file.write_text(render_statement_page(statement), encoding="utf-8")
    pdf_file.write_bytes(render_sheet(statement)[0])


def print_statement(statement: Statement, console: Console) -> None:
    """Print the sentences, and the tables but for components and records."""
    console.print(verdict(statement), markup=False)
    for each in (_uncertainty(statement), _shares(statement), _protection(statement), _conditions(statement)):
        ReportTable(each.title, each.header, [[str(content) for content in row] for row in each.rows]).print(console)
    _print_lines(console, statement.sentences())
    if len(statement.poses) > 1:
        _print_lines(console, [map_note(statement)])
    _print_lines(console, [f"Not in the numbers: {each}" for each in statement.reservations])


def _print_lines(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.print(line, markup=False)
