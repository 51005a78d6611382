# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
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
from posor.output_files import write_files
from posor.reporting.html_page import Cell, Section, bullet_list, paragraph, render_page, table
from posor.reporting.json_text import json_text
from posor.reporting.number_columns import align_numbers, decimals
from posor.reporting.report_table import ReportTable

from posor_design.endpoint_components import Kind
from posor_design.reliability_report import AXES, UNITS
from posor_design.statement_map import draw_map
from posor_design.statement_records import BEAMS, URDF, Origin

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console

    from posor_design.statement import Statement
    from posor_design.statement_records import Record

FORMAT, VERSION = "posor_statement", 1
OUTPUT_FILES = ("statement.json", "statement.html", "statement.pdf")
TEMPLATE = Path(__file__).with_name("statement.typ")
LEAST_SHARE = 5e-4  # smaller shares have no digit
PIXELS_PER_INCH, COARSE = 110.0, 5.0  # of a picture, and of one whose pages are counted only
TEXT_SIZES = (6.9, 6.3, 5.7, 5.2)  # [pt]; the largest with which the sheet is one page, or the smallest
MOST_FREEDOMS = 1e4  # more make no difference
NANO = 5e-4  # half a nanometre or nanoradian [µm, µrad]: less is 0
ROUNDING = 1e-9  # of a digit, by which a bound may exceed its last digit

Text = tuple[str | Origin, ...]
"""A text with origins in it, which are links on the page."""


@dataclass(frozen=True)
class StatementTable:
    """A table whose cells may be origins."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str | Text]]
    note: Text = ()

    def aligned(self) -> tuple[list[bool], list[list[Text]]]:
        """Return which columns hold numbers, and the rows with their decimal points below each other."""
        columns, numeric = [], []
        for cells in zip(*self.rows, strict=True):
            numbers = align_numbers([str(cell) for cell in cells]) if all(isinstance(c, str) for c in cells) else None
            numeric.append(numbers is not None)
            columns.append([(cell,) if isinstance(cell, str) else cell for cell in numbers or cells])
        return numeric, [list(row) for row in zip(*columns, strict=True)]


def micro(value: float) -> str:
    """Return metres or radians in µm or µrad with two digits, all of a whole number (JCGM 100, 7.2.6)."""
    scaled = 1e6 * value
    if math.isinf(scaled):
        return "∞"
    return "0" if scaled < NANO else f"{scaled:.{decimals(scaled, 2)}f}"


def micro_bound(value: float) -> str:
    """Return a bound in µm or µrad with three digits, rounded up."""
    scaled = 1e6 * value
    if math.isinf(scaled):
        return "not bounded"
    step = 10.0 ** -decimals(max(scaled, NANO), 3)
    return f"{math.ceil(scaled / step - ROUNDING) * step:.{decimals(max(scaled, NANO), 3)}f}"


def rounded(value: float, expanded: float) -> str:
    """Return a value in SI units with the digits that its expanded uncertainty allows (JCGM 100, 7.2.6)."""
    known = 0.0 < expanded < math.inf
    return f"{value:.{6 + decimals(1e6 * expanded, 2) if known and expanded > 1e-6 * NANO else 9}f}"


def _percent(share: float) -> str:
    if share < LEAST_SHARE:
        return "< 0.1" if share else ""
    return f"{100.0 * share:.1f}"


def _freedoms(number: float) -> str:
    return "∞" if math.isinf(number) else f"{number:.0f}" if number < MOST_FREEDOMS else f"> {MOST_FREEDOMS:g}"


def verdict(statement: Statement) -> str:
    """Return the sentence of the whole statement."""
    worst = statement.worst
    x, y, z = (rounded(value, worst.largest) for value in worst.T_base_endpoint.translation)
    level = statement.reliability.protection_level[statement.level_axis]
    joint, cause = statement.reliability.set_by[statement.level_axis]
    bounded = (
        f"an undetected fault leaves it within {micro_bound(level)} µm along each axis"
        if math.isfinite(level)
        else "an undetected fault may move it without bound"
    )
    return (
        f"The endpoint of {statement.arm.name} is at x {x}, y {y}, z {z} m in {statement.base_frame} to "
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
    position = [rounded(*each) for each in zip(worst.T_base_endpoint.translation, worst.expanded, strict=False)]
    rows = [
        [
            axis,
            value,
            micro(worst.standard[n]),
            _freedoms(worst.freedoms[n]),
            f"{worst.factors[n]:.2f}",
            micro(worst.expanded[n]),
        ]
        for n, (axis, value) in enumerate(zip(AXES, [*position, "0", "0", "0"], strict=True))
    ]
    header = ("axis", "value [m, rad]", "u [µm, µrad]", "degrees of freedom", "k", "U = k u [µm, µrad]")
    files = [statement.records.origin(role) for role in (URDF, BEAMS) if role in statement.records]
    quaternion = ", ".join(f"{each:.9f}" for each in pin.SE3ToXYZQUAT(worst.T_base_endpoint)[3:])
    note = (
        f"Axes of the base. Rotations: deviation from the orientation {quaternion} (quaternion x, y, z, w). ",
        "Value: the joint angles (conditions) through ",
        *_listed(files),
        ". u: root of the sum of the squared components. k: t distribution, 95 % (JCGM 100, G.4).",
    )
    return StatementTable("Endpoint", header, rows, note)


def _listed(origins: Iterable[Origin]) -> Text:
    found: list[str | Origin] = []
    for origin in dict.fromkeys(origins):
        found += [", ", origin] if found else [origin]
    return tuple(found)


def _file(origin: Origin) -> Origin:
    return Origin(origin.role, origin.file)


def _ellipsoid(statement: Statement) -> StatementTable:
    worst = statement.worst
    rows = [
        [f"semi-axis {n + 1}", micro(length), *(f"{round(part, 3) + 0.0:.3f}" for part in direction)]
        for n, (length, direction) in enumerate(zip(worst.ellipsoid, worst.ellipsoid_axes.T, strict=True))
    ]
    note = (
        f"Directions in the base. From the components; coverage factor {worst.ellipsoid_factor:.2f} for 3 dimensions."
    )
    return StatementTable("Position ellipsoid, 95 %", ("", "length [µm]", "x", "y", "z"), rows, (note,))


def _shares(statement: Statement) -> StatementTable:
    """Return the shares of sources and kinds in the variance of the position: rows and columns add up to 100 %."""
    worst = statement.worst
    kinds = [kind for kind in Kind if any(each.kind is kind for each in worst.components)]
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
    rows.append(["all", *(_percent(statement.share_of(kind=kind)) for kind in kinds), "100.0"])
    header = ("source", *(f"{kind} [%]" for kind in kinds), "all [%]")
    return StatementTable("Shares of the variance of the position", header, rows, ("From the components.",))


def _components(statement: Statement) -> StatementTable:
    worst = statement.worst
    shares = worst.position_shares()
    order = sorted(range(len(shares)), key=lambda n: -shares[n])
    rows: list[list[str | Text]] = []
    small = [n for n in order if shares[n] < LEAST_SHARE]
    for n in order[: len(order) - len(small)]:
        each = worst.components[n]
        sigmas = np.sqrt(np.diagonal(each.covariance))
        what, part, origin = "", "", statement.origins[n]
        if each.kind is Kind.SYSTEMATIC and each.source in statement.largest:
            largest = statement.largest[each.source]
            what, part, origin = largest.name, f"{100.0 * largest.share:.0f}", largest.origin
        cells = [each.source, each.kind, *map(micro, sigmas), _percent(shares[n]), _freedoms(each.freedoms), what, part]
        rows.append([*cells, (origin,)])
    if small:
        sigmas = np.sqrt(sum(np.diagonal(worst.components[n].covariance) for n in small))
        share, origins = (
            _percent(float(shares[small].sum())),
            _listed(map(_file, (statement.origins[n] for n in small))),
        )
        rows.append([f"{len(small)} smaller", "", *map(micro, sigmas), share, "", "", "", origins])
    units = (f"{axis} [{unit}]" for axis, unit in zip(AXES, UNITS, strict=True))
    header = ("source", "kind", *units, "share [%]", "dof", "largest quantity", "of it [%]", "origin")
    note = (
        "Standard uncertainties; share in the variance of the position; dof: degrees of freedom; of it: share of the "
        "largest quantity in the component, to whose line the origin leads."
    )
    return StatementTable("Components", header, rows, (note,))


def _protection(statement: Statement) -> StatementTable:
    reliability = statement.reliability
    rows: list[list[str | Text]] = [
        [axis, micro_bound(level), f"{joint}: {cause}", _cause_source(statement, joint, cause), (origin,)]
        for axis, level, (joint, cause), origin in zip(
            AXES, reliability.protection_level, reliability.set_by, statement.level_origins, strict=True
        )
    ]
    note = (
        "An undetected fault of one cause leaves the error within the level, but for an integrity risk of "
        f"{INTEGRITY_RISK:g} for one scan and axis. The origin is the line of the bound, or of the sensors whose "
        "default it is."
    )
    header = ("axis", "level [µm, µrad]", "set by", "source of the bound", "origin")
    return StatementTable("Protection level", header, rows, (note,))


def _cause_source(statement: Statement, joint: str, cause: str) -> str:
    known = statement.reliability.joints.get(joint)
    causes = [] if known is None else known.hypotheses.causes
    return next((each.source for each in causes if each.name == cause), "")


def _conditions(statement: Statement) -> StatementTable:
    rows: list[list[str | Text]] = [[each.name, each.text, (each.origin,)] for each in statement.conditions]
    return StatementTable("Conditions", ("condition", "value", "origin"), rows)


def _records(statement: Statement) -> StatementTable:
    rows: list[list[str | Text]] = [
        [
            each.role,
            (Origin(each.role, each.path.name),),
            each.source or "not stated",
            each.date if each.date not in ("", "none") else "not stated",
            each.sha256,
        ]
        for each in statement.records.all.values()
    ]
    serial = statement.arm.serial or "not stated"
    note = f"Arm {statement.arm.name}, serial number {serial}, identity {statement.identity}."
    return StatementTable("Records", ("record", "file", "source", "date", "SHA-256"), rows, (note,))


def as_json(statement: Statement) -> dict[str, Any]:
    """Return everything by name, SI units; None: not stated."""
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
                "degrees_of_freedom": float(worst.freedoms[n]),
                "coverage_factor": float(worst.factors[n]),
                "expanded": float(worst.expanded[n]),
                "protection_level": float(statement.reliability.protection_level[n]),
                "protection_level_origin": _origin_json(statement.level_origins[n]),
                "protection_level_set_by": dict(zip(("joint", "cause"), statement.reliability.set_by[n], strict=True)),
            }
            for n, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True))
        },
        "position": {
            "largest": float(worst.largest),
            "coverage_factor": float(worst.ellipsoid_factor),
            "semi_axes": worst.ellipsoid.tolist(),
            "directions": worst.ellipsoid_axes.T.tolist(),
        },
        "components": [
            {
                "source": each.source,
                "kind": str(each.kind),
                "standard_uncertainty": np.sqrt(np.diagonal(each.covariance)).tolist(),
                "covariance": each.covariance.tolist(),
                "degrees_of_freedom": float(each.freedoms),
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
                "largest": float(each.largest),
                "expanded": each.expanded.tolist(),
            }
            for name, each in zip(statement.names, statement.poses, strict=True)
        ],
    }


def _origin_json(origin: Origin) -> dict[str, Any]:
    return {"record": origin.role, "file": origin.file, "line": origin.line or None, "key": origin.key}


def _anchor(statement: Statement, origin: Origin) -> str:
    """Return the place of a record, or of its line, on the page."""
    number = list(statement.records.all).index(origin.role)
    return f"record-{number}-{origin.line}" if origin.line else f"record-{number}"


def render_statement_page(statement: Statement) -> str:
    """Return the page as HTML without external references; the files follow the statement, line by line."""

    def html(text: Text) -> Markup:
        return Markup("").join(
            Markup('<a href="#{}" title="{}">{}</a>').format(_anchor(statement, each), each.key or each.role, each)
            if isinstance(each, Origin)
            else each
            for each in text
        )

    sections = []
    for each in tables(statement):
        numeric, rows = each.aligned()
        classes = ["number" if is_number else "" for is_number in numeric]
        cells = [[Cell(html(text), css) for text, css in zip(row, classes, strict=True)] for row in rows]
        header = [Cell(name, css) for name, css in zip(each.header, classes, strict=True)]
        sections.append(Section(each.title, table(header, cells) + (paragraph(html(each.note)) if each.note else "")))
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
        "tables": [_sheet_table(statement, each) for each in tables(statement)],
    }

    def compiled(kind: Literal["pdf", "png"], size: float, ppi: float) -> list[bytes]:
        inputs = {"statement": json.dumps({**content, "size": size})}
        made: bytes | list[bytes] = typst.compile(
            TEMPLATE, format=kind, ppi=ppi, sys_inputs=inputs, ignore_system_fonts=True
        )
        return made if isinstance(made, list) else [made]

    size = next((size for size in TEXT_SIZES if len(compiled("png", size, COARSE)) == 1), TEXT_SIZES[-1])
    return compiled(kind, size, PIXELS_PER_INCH)


def _sheet_table(statement: Statement, shown: StatementTable) -> dict[str, Any]:
    def parts(text: Text) -> list[dict[str, str]]:
        links = (f"statement.html#{_anchor(statement, each)}" if isinstance(each, Origin) else "" for each in text)
        return [{"text": str(each), "link": link} for each, link in zip(text, links, strict=True)]

    numeric, rows = shown.aligned()
    cells = [[parts(text) for text in row] for row in rows]
    header = list(shown.header)
    return {"title": shown.title, "header": header, "numeric": numeric, "rows": cells, "note": parts(shown.note)}


def write_statement(statement: Statement, folder: Path) -> None:
    """Write JSON, page and PDF into an existing folder. Raises OutputError: one cannot be written."""
    json_file, page_file, pdf_file = (folder / name for name in OUTPUT_FILES)
    texts = {json_file: json_text(as_json(statement), indent=2), page_file: render_statement_page(statement)}
    write_files({**texts, pdf_file: render_sheet(statement)[0]})


def print_statement(statement: Statement, console: Console) -> None:
    """Print the sentences, and the tables but for components and records."""
    console.print(verdict(statement), markup=False)
    for each in (_uncertainty(statement), _shares(statement), _protection(statement), _conditions(statement)):
        rows = [[cell if isinstance(cell, str) else "".join(map(str, cell)) for cell in row] for row in each.rows]
        ReportTable(each.title, each.header, rows).print(console)
    _print_lines(console, statement.sentences())
    if len(statement.poses) > 1:
        _print_lines(console, [map_note(statement)])
    _print_lines(console, [f"Not in the numbers: {each}" for each in statement.reservations])


def _print_lines(console: Console, lines: Iterable[str]) -> None:
    for line in lines:
        console.print(line, markup=False)
