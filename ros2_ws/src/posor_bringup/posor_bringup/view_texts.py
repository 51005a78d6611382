# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Texts of the live page: the statement on the endpoint, the causes, the joints, the numbers and the log of events.

The statement says where the endpoint is, to within how much, and why this may be believed; or why it is not known.
"""

from __future__ import annotations

from html import escape
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.numerics.stamps import NS
from posor.reporting.number_columns import decimals

from posor_bringup.view_events import NOTE, duration_text, utc
from posor_bringup.view_observation import NO_STATE, SILENT_NODE, USABLE
from posor_bringup.view_record import two_sigma

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from posor_bringup.view_events import Cause, Event, EventLog
    from posor_bringup.view_geometry import DrawnArm
    from posor_bringup.view_observation import EndpointView, Observation
    from posor_bringup.view_record import ArmRecord

GREY, RED, AMBER, GREEN, BLUE = (120, 120, 120), (218, 54, 51), (190, 115, 0), (36, 130, 60), (70, 120, 220)
COLOURS = {
    "OK": GREEN,
    "DEGRADED": AMBER,
    "UNCOUNTED": AMBER,
    "WARNING": AMBER,
    NO_STATE: AMBER,
    "NO MESSAGE": GREY,
    NOTE: GREY,
}
"""Of the states; red for all others."""
AXES = ("x", "y", "z", "about X", "about Y", "about Z")
NAMES_OF_AXES = ("along X", "along Y", "along Z", "about X", "about Y", "about Z")
EVENTS_SHOWN, CAUSES_SHOWN, DETAILS_SHOWN = 40, 4, 2
INSET = "margin:0 14px 0 4px"
"""Margins that keep the texts clear of the scroll bar."""
STYLE = """<style>
table.posor {width:calc(100% - 18px); margin-left:4px; font-size:12px; border-collapse:collapse; line-height:1.3}
.posor td, .posor th {padding:2px 8px 2px 0; vertical-align:top; text-align:left; border-top:1px solid #ddd}
.number td:nth-child(n+2):nth-child(-n+5), #endpoint th:nth-child(n+2):nth-child(-n+5) {text-align:right}
</style>"""

NO_UPDATE_S = 3.0
"""Time without an update after which the browser shows a notice; ``view`` itself may have ended."""
NOTICE = "<style>@keyframes posor-no-update {0%, 99% {visibility:hidden} 100% {visibility:visible}}</style>"
NOTICE_STYLE = (
    "position:fixed;inset:0;z-index:1000;pointer-events:none;padding:30px;color:white;font-size:20px;"
    "display:flex;align-items:center;justify-content:center;text-align:center;"
    f"background:rgba{*GREY, 0.95}"
)


def colour_of(state: str) -> tuple[int, int, int]:
    """Return the colour of a state."""
    return COLOURS.get(state, RED)


def statement(name: str, observation: Observation, record: ArmRecord) -> str:
    """Return the banner of the page: state, since when, and the sentence on the endpoint."""
    state, endpoint, time_ns = observation.state, observation.endpoint, observation.time_ns
    since = record.since(time_ns)
    form = "%H:%M:%S" if utc(since.time_ns, "%x") == utc(time_ns, "%x") else "%Y-%m-%d %H:%M:%S"
    kind = "" if state in (*USABLE, NO_STATE) else "no pose "
    begin = f"{kind}since {'at least ' if since.is_first else ''}{utc(since.time_ns, form)} UTC"
    lasts = f"({duration_text((time_ns - since.time_ns) / NS)})"
    if endpoint is None:
        lines = ["The endpoint is not known.", observation.causes[0].text]
        begin = lasts = ""
    elif state in (*USABLE, NO_STATE) and np.isfinite(endpoint.pose).all():
        lines = _position(endpoint, observation)
    else:
        texts = [_cause_text(cause, observation) for cause in observation.causes]
        count = len(texts) - 1
        more = f", and {count} more cause{'s' if count > 1 else ''}" if count else ""
        lines = [f"The endpoint is not known: {''.join(texts[:1])}{more}."]
    if endpoint is not None and endpoint.stamp_ns:
        kind = "scan" if observation.is_fresh else "last scan"
        lines.append(f"{kind} of {utc(endpoint.stamp_ns, '%Y-%m-%d %H:%M:%S.%f')} UTC")
    return banner(name, state, colour_of(state), f"{begin} {lasts}".strip(), lines)


def banner(name: str, state: str, colour: tuple[int, int, int], since: str, lines: Iterable[str]) -> str:
    """Return the banner with lines of text."""
    style = f"background:rgb{colour};color:white;padding:6px 10px;border-radius:4px;{INSET};font-size:14px"
    text = "<br>".join(escape(line) for line in lines)
    head = f'<b style="font-size:17px">{escape(name)}: {escape(state)}</b> <span id="since">{since}</span>'
    return f'{STYLE}<div id="banner" style="{style}">{head}<br>{text}</div>'


def no_update_notice(update: int) -> str:
    """Return a notice that the browser shows over the page after NO_UPDATE_S, unless a later one replaces it.

    ``update``: another number for each update, so that the browser measures the time anew.
    """
    style = f"animation:posor-no-update {NO_UPDATE_S:g}s forwards;{NOTICE_STYLE}"
    text = f"NO UPDATE for more than {NO_UPDATE_S:g} s: this page hears nothing from posor view; what it shows is old"
    return f'{NOTICE}<div id="no-update" data-update="{update}" style="{style}">{text}</div>'


def _cause_text(cause: Cause, observation: Observation) -> str:
    """Return joints and text of a cause, with the nodes of these joints that are silent."""
    texts = [text for name in cause.joints for text in observation.details.get(name, ()) if SILENT_NODE in text]
    text = "; ".join((cause.text, *dict.fromkeys(texts)))
    return f"{', '.join(cause.joints)}: {text}" if cause.joints else text


def _position(endpoint: EndpointView, observation: Observation) -> list[str]:
    """Return where the endpoint is, to within how much, and why this may be believed."""
    sigma = two_sigma(endpoint.covariance)
    places = zip("xyz", endpoint.pose, strict=False)
    place = ", ".join(f"{axis} {_pose_text(1e3 * value, 1e3 * np.max(sigma[:3]))}" for axis, value in places)
    lines = [f"The endpoint is at {place} mm in {endpoint.frame},"]
    if np.isfinite(sigma).all():
        position = 2e6 * np.sqrt(np.linalg.eigvalsh(endpoint.covariance[:3, :3])[-1])
        rotation = 2e6 * np.sqrt(np.linalg.eigvalsh(endpoint.covariance[3:, 3:])[-1])
        size = f"U = {_two_digits(position)} um and {_two_digits(rotation)} urad"
        lines[0] += f" to within {size} (2 sigma, in any direction)."
    else:
        lines[0] += " with an unknown uncertainty."
    lines.append(_level(endpoint))
    reasons = []
    if observation.joints and (count := sum(each == "OK" for each in observation.joints.values())):
        reasons.append(f"{count} of {len(observation.joints)} joints are OK")
    if observation.scan is not None and np.isfinite(observation.scan.residuals).any():
        worst = int(np.nanargmax(observation.scan.residuals))
        share, name = observation.scan.residuals[worst], list(observation.joints)[worst]
        reasons.append(f"redundant readings agree (largest chi-square: {100.0 * share:.0f} % of its limit, {name})")
    if reasons:
        lines.append(f"Believe it because {' and '.join(reasons)}.")
    return lines


def _level(endpoint: EndpointView) -> str:
    """Return the sentence on the protection level, and on the axes along which it is not bounded."""
    level = endpoint.protection_level
    if np.isnan(level).any():
        return "No protection level is known: an undetected fault is not bounded."
    causes = (*endpoint.protection_causes, *[""] * 6)[:6]
    known = {number: f" ({cause})" if (cause := causes[number]) else "" for number in range(6)}
    bounded = [number for number in range(3) if np.isfinite(level[number])]
    sentences = []
    if bounded:
        worst = max(bounded, key=lambda number: level[number])
        size = f"{np.ceil(1e6 * level[worst]):.0f} um {NAMES_OF_AXES[worst]}{known[worst]}"
        sentences.append(f"With an undetected fault of one cause the error is at most {size}.")
    if without := [number for number in range(6) if np.isinf(level[number])]:
        axes = ", ".join(NAMES_OF_AXES[number] for number in without) if len(without) < len(AXES) else "on any axis"
        by = "".join(dict.fromkeys(known[number] for number in without))
        sentences.append(f"The protection level is not bounded {axes}{by}.")
    return " ".join(sentences)


def causes_table(observation: Observation, log: EventLog) -> str:
    """Return a line for each cause: its state, the joints, what is wrong and since when."""
    causes, time_ns = (*observation.causes, *observation.reports), observation.time_ns
    rows = []
    for cause in causes[:CAUSES_SHOWN]:
        explained = cause.joints if cause in observation.causes else ()
        details = dict.fromkeys(text for name in explained for text in observation.details.get(name, ()))
        small = "".join(
            f"<br><small>{escape(text)}</small>" for text in islice(details, DETAILS_SHOWN) if text != cause.text
        )
        begin = "" if cause.state in (NOTE, NO_STATE) else utc(log.begin_ns(cause, time_ns), "%H:%M:%S")
        cells = (_state(cause.state), f"<b>{escape(', '.join(cause.joints))}</b> {escape(cause.text)}{small}", begin)
        rows.append(_row(cells, "cause"))
    if len(causes) > CAUSES_SHOWN:
        rows.append(_row(("", f"and {len(causes) - CAUSES_SHOWN} more, in the log", ""), "cause"))
    return _table("causes", ("state", "what is wrong, and where", "since"), rows) if rows else ""


def joints_table(observation: Observation) -> str:
    """Return the states of all joints, in one line each."""
    cells = []
    for name, state in observation.joints.items():
        colour = colour_of(state)
        cells.append(
            f'<span id="joint-{name}" style="display:inline-block;margin-right:10px">{escape(name)} '
            f'<b style="color:rgb{colour}">{escape(state)}</b></span>'
        )
    return f'<div id="joints" style="font-size:12px;{INSET}">{"".join(cells)}</div>'


def numbers_table(observation: Observation, drawn: DrawnArm | None) -> str:
    """Return the numbers of the endpoint; a level that is not bounded is left to the statement."""
    columns = np.full((4, 6), np.nan)
    endpoint = observation.endpoint
    if drawn is not None:
        columns[1] = 1e6 * drawn.deviation
    causes: Sequence[str] = ()
    if endpoint is not None and observation.is_fresh:
        if np.isfinite(endpoint.pose).all():
            pose = pin.XYZQUATToSE3(endpoint.pose)
            columns[0] = *(1e3 * pose.translation), *(1e3 * pin.log3(pose.rotation))
        columns[2], columns[3] = 1e6 * two_sigma(endpoint.covariance), 1e6 * endpoint.protection_level
        causes = endpoint.protection_causes
    if not np.isfinite(columns).any():
        return ""
    head = ["", "pose", "from nominal", "2 sigma", "level", "set by"]
    if not np.isfinite(columns[3]).any():
        head, columns, causes = head[:4], columns[:3], ()
    rows = []
    for number, axis in enumerate(AXES):
        units = ("mm", "um") if number < 3 else ("mrad", "urad")  # noqa: PLR2004  translation, then rotation
        pose, *others = columns[:, number]
        values = [
            _number(_pose_text(pose, 1e-3 * others[1]), units[0]),
            *(_number(f"{value:.1f}", units[1]) for value in others),
        ]
        cause = [f"<small>{escape(causes[number])}</small>"] if number < len(causes) else []
        rows.append(_row((axis, *values, *cause), "number"))
    return _table("endpoint", head, rows)


def events_table(log: EventLog, time_ns: int) -> str:
    """Return the newest events up to a time: when, which joints, what, how long."""
    begun = [event for event in log.events() if event.begin_ns <= time_ns]
    rows = [_event_row(event, time_ns) for event in begun[:EVENTS_SHOWN]]
    head = ("begin (UTC)", "joints", "what", "lasted")
    if not rows:
        return f'<div id="events" style="{INSET};font-size:12px">no events since the page was started</div>'
    left_out = f"{log.left_out} older events are left out" if log.left_out else ""
    table = _table("events", head, rows)
    return f'<div style="max-height:190px;overflow-y:auto;{INSET}">{table}<small>{left_out}</small></div>'


def _event_row(event: Event, time_ns: int) -> str:
    cause = event.cause
    ends_later = event.end_ns is not None and event.end_ns > time_ns  # in a replay
    is_present = event.end_ns is None or ends_later
    lasted_s = (time_ns - event.begin_ns) / NS if ends_later else event.lasted_s(time_ns)
    lasted = "" if cause.state == NOTE else f'<span style="white-space:nowrap">{duration_text(lasted_s)}</span>'
    times = f", {event.count} times" if event.count > 1 and not ends_later else ""
    lasted = f"{lasted}{times}{', lasts' if is_present else ''}"
    what = f"{_state(cause.state)} {escape(cause.text)}"
    begin = f'<span style="white-space:nowrap">{utc(event.begin_ns, "%Y-%m-%d %H:%M:%S")}</span>'
    return _row((begin, escape(", ".join(cause.joints)), what, lasted), "event")


def _state(state: str) -> str:
    return f'<b style="color:rgb{colour_of(state)};white-space:nowrap">{escape(state)}</b>'


def _table(name: str, head: Sequence[str], rows: Sequence[str]) -> str:
    cells = "".join(f"<th>{title}</th>" for title in head)
    return f'<table id="{name}" class="posor"><tr>{cells}</tr>{"".join(rows)}</table>'


def _row(cells: Sequence[str], kind: str) -> str:
    return f'<tr class="{kind}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _number(text: str, unit: str) -> str:
    shown = {"nan": "-", "inf": "&infin;"}.get(text, f"{text} {unit}")
    return f'<span style="white-space:nowrap">{shown}</span>'


def _two_digits(value: float) -> str:
    return f"{value:.{decimals(value, 2) if value > 0.0 else 0}f}"


def _pose_text(value: float, uncertainty: float) -> str:
    """Return a pose [mm, mrad] with the digits that its uncertainty, in the same unit, allows; unknown: four."""
    is_known = np.isfinite(uncertainty) and uncertainty > 0.0
    return f"{value:.{decimals(uncertainty, 2) if is_known else 4}f}"
