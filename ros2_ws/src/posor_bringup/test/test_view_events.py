# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import io

import pytest
from posor.model.fault import Fault
from posor.numerics.stamps import NS
from posor.reporting.fault_texts import FAULT_TEXTS
from posor_bringup.view_events import EVENTS, MERGE_S, Cause, EventLog, causes_of_state, duration_text, merge_causes
from posor_estimator.endpoint_verdict import JointStatus, degraded_verdict, unusable_verdict

JOINTS = ("base", "elbow", "wrist_roll")
T0_NS = 1_767_225_600 * NS
LOST = Cause("LOST", "dark", ("elbow",))


def verdict_causes(*joints: JointStatus) -> list[tuple[str, tuple[str, ...], str]]:
    make = degraded_verdict if max(joint.state for joint in joints) == 1 else unusable_verdict
    verdict = make(joints)
    state = ("OK", "DEGRADED", "LOST", "UNCOUNTED")[verdict.state]
    found = causes_of_state(state, verdict.reason, verdict.joint, JOINTS)
    return [(cause.state, cause.joints, cause.text.rpartition(" (")[0] or cause.text) for cause in found]


def test_causes_are_those_of_the_verdicts_of_chain_node() -> None:
    faults = int(Fault.RESIDUAL | Fault.LATCHED)
    sound = JointStatus("base", 0, 0)
    text = f"{FAULT_TEXTS['RESIDUAL']}, {FAULT_TEXTS['LATCHED']}"
    assert verdict_causes(sound, JointStatus("elbow", 2, faults), JointStatus("wrist_roll", 2, faults)) == [
        ("LOST", ("elbow", "wrist_roll"), text)
    ]
    assert verdict_causes(sound, JointStatus("elbow", 2, faults), JointStatus("wrist_roll", 3, 0)) == [
        ("LOST", ("elbow",), text),
        ("LOST", ("wrist_roll",), "waiting for the home mark or another reference"),
    ]
    time = FAULT_TEXTS["TIME"]
    degraded = [JointStatus(name, 1, int(Fault.TIME)) for name in ("base", "elbow")]
    assert verdict_causes(*degraded, JointStatus("wrist_roll", 1, int(Fault.ENCODER))) == [
        ("DEGRADED", ("base", "elbow"), time),
        ("DEGRADED", ("wrist_roll",), FAULT_TEXTS["ENCODER"]),
    ]


@pytest.mark.parametrize(
    ("reason", "joint", "cause"),
    [
        ("no input on /arm/elbow/transform for 0.3 s", "elbow", ("elbow",)),
        ("elbow, base: transform missing from a scan that the other joints sent", "elbow", ("elbow", "base")),
        ("not as commissioned: the URDF differs", "", ()),
        ("elbow: the stamp is 1.2 s old; expected at most 1 s, or the parameter 'max_age'", "elbow", ("elbow",)),
        ("", "base", ("base",)),
    ],
)
def test_any_other_reason_is_one_cause(reason: str, joint: str, cause: tuple[str, ...]) -> None:
    (found,) = causes_of_state("LOST", reason, joint, JOINTS)
    assert found.joints == cause


def test_every_fault_has_words() -> None:
    assert set(FAULT_TEXTS) == {str(fault.name) for fault in Fault if fault}


def test_one_cause_on_several_joints_is_one_cause_although_numbers_differ() -> None:
    causes = [Cause("WARNING", f"late: {number} ticks", (name,)) for number, name in enumerate(JOINTS)]
    assert merge_causes(causes) == [Cause("WARNING", "late: 0 ticks", JOINTS)]


def test_event_has_begin_end_joints_and_goes_on_after_a_short_pause() -> None:
    log = EventLog()
    pause = round(MERGE_S * NS)
    for time_ns, causes in ((0, [LOST]), (1, []), (pause, [LOST._replace(joints=("base",))]), (pause + 5, [])):
        log.update("state", T0_NS + time_ns, causes)
    (event,) = log.events()
    assert (event.begin_ns, event.end_ns, event.count) == (T0_NS, T0_NS + pause + 5, 2)
    assert event.cause.joints == ("elbow", "base")
    log.update("state", T0_NS + 3 * pause, [LOST])
    newest, _ = log.events()
    assert (newest.begin_ns, newest.end_ns, newest.count) == (T0_NS + 3 * pause, None, 1)
    assert log.begin_ns(LOST, T0_NS + 4 * pause) == T0_NS + 3 * pause
    assert log.begin_ns(LOST, T0_NS + pause) == T0_NS + pause
    assert log.begin_ns(LOST, T0_NS + 1) == T0_NS


def test_sources_do_not_end_the_events_of_others() -> None:
    log = EventLog()
    log.update("state", T0_NS, [LOST])
    log.update("report", T0_NS + 1, [])
    assert next(log.events()).end_ns is None


def test_log_is_bounded_and_says_what_it_leaves_out() -> None:
    log = EventLog()
    for number in range(EVENTS + 5):
        log.update("state", T0_NS + 10 * number * NS, [LOST] if number % 2 else [Cause("LOST", "frozen")])
    assert len(list(log.events())) == EVENTS
    assert log.left_out == 5
    rows = list(csv.DictReader(io.StringIO(log.to_csv(T0_NS).decode())))
    assert (rows[0]["times"], rows[0]["what"]) == ("5", "older events are left out")
    assert len(rows) == EVENTS + 1
    assert rows[-1]["end_utc"] == ""


def test_a_cause_that_lasts_all_night_keeps_its_begin() -> None:
    log = EventLog()
    log.update("report", T0_NS, [LOST])
    for number in range(EVENTS + 5):
        log.note(T0_NS + number * NS, f"note {number}")
    end_ns = T0_NS + EVENTS * NS
    assert log.begin_ns(LOST, end_ns) == T0_NS
    log.update("report", end_ns, [])
    assert [event.end_ns for event in log.events() if event.cause == LOST] == [end_ns]
    assert (len(list(log.events())), log.left_out) == (EVENTS, 6)


def test_table_of_events_can_be_read_back() -> None:
    log = EventLog()
    log.update("state", T0_NS, [Cause("LOST", 'a "text", with signs', ("base", "elbow"))])
    log.update("state", T0_NS + 1_500_000_000, [])
    (row,) = csv.DictReader(io.StringIO(log.to_csv(T0_NS).decode()))
    assert row == {
        "begin_utc": "2026-01-01T00:00:00.000",
        "end_utc": "2026-01-01T00:00:01.500",
        "duration_s": "1.500",
        "times": "1",
        "state": "LOST",
        "joints": "base elbow",
        "what": 'a "text", with signs',
    }


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.26, "0.3 s"), (200.0, "3 min 20 s"), (3600.0, "1 h 0 min"), (90_061.0, "1 d 1 h")]
)
def test_duration(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
