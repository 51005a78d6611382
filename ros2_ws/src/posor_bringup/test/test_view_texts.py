# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from posor.numerics.stamps import NS
from posor_bringup.view_events import NOTE, Cause, EventLog
from posor_bringup.view_observation import SILENT_NODE, EndpointView, Observation
from posor_bringup.view_record import ArmRecord
from posor_bringup.view_texts import causes_table, events_table, numbers_table, statement

POSE = np.array([1.23456789, -0.5, 0.0, 0.0, 0.0, 0.0, 1.0])
SIGMAS = np.array([1e-6, 2e-6, 5.7e-6, 1e-6, 2e-6, 3e-6])
ENDPOINT = EndpointView(
    NS,
    NS,
    0.0,
    0.0,
    "base",
    POSE,
    np.diag(SIGMAS**2),
    np.array([1e-4, 2.001e-4, 1e-4, *[np.inf] * 3]),
    ("elbow: spot",) * 6,
)
SEEN = Observation(NS, is_fresh=True, state="OK", endpoint=ENDPOINT, joints={"elbow": "OK"})
LOST = Cause("LOST", "a reading is missing", ("elbow",))


def banner(**changes: Any) -> str:
    return statement("arm", replace(SEEN, **changes), ArmRecord(["elbow"], (30.0,)))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "The endpoint is at x 1234.568, y -500.000, z 0.000 mm in base, to within U = 11 um and 6.0 urad"),
        ({}, "With an undetected fault of one cause the error is at most 201 um along Y (elbow: spot)."),
        ({}, "The protection level is not bounded about X, about Y, about Z (elbow: spot)."),
        ({}, "Believe it because 1 of 1 joints are OK."),
        ({"endpoint": None, "causes": (LOST,)}, "The endpoint is not known."),
        ({"state": "LOST", "causes": (LOST,)}, "The endpoint is not known: elbow: a reading is missing."),
        (
            {
                "state": "LOST",
                "causes": (LOST,),
                "details": {"elbow": (f"driver_node{SILENT_NODE}7 s", "posor_node: waits")},
            },
            "elbow: a reading is missing; driver_node has ended or hangs: no diagnostics for 7 s.",
        ),
        ({"state": "LOST", "causes": (LOST, LOST)}, "a reading is missing, and 1 more cause."),
        (
            {"endpoint": replace(ENDPOINT, covariance=np.full((6, 6), np.nan))},
            "mm in base, with an unknown uncertainty.",
        ),
    ],
)
def test_the_sentence_on_the_endpoint(changes: dict[str, Any], text: str) -> None:
    assert text in banner(**changes)


@pytest.mark.parametrize(("pause_s", "run"), [(1.0, 0), (4.0, 1)])
def test_points_after_a_silence_belong_to_another_run(pause_s: float, run: int) -> None:
    record = ArmRecord(["elbow"], (30.0,))
    for time_ns, is_fresh in ((NS, True), (2 * NS, False), (round((1.0 + pause_s) * NS), True)):
        endpoint = replace(ENDPOINT, received_ns=time_ns if is_fresh else NS)
        record.add(replace(SEEN, time_ns=time_ns, is_fresh=is_fresh, endpoint=endpoint), None)
    assert record.history.run == run


def test_numbers_end_where_their_uncertainty_ends() -> None:
    table = numbers_table(SEEN, None)
    for text in ("1234.5679 mm", "-500.0000 mm", "0.000 mm", "11.4 um", "&infin;"):
        assert f">{text}<" in table


def test_a_cause_has_one_line_with_its_joints_and_the_time_since_which_it_is_present() -> None:
    log, causes = EventLog(), (LOST._replace(joints=("elbow", "wrist")), Cause(NOTE, "no encoder"))
    log.update("state", NS, causes[:1])
    table = causes_table(replace(SEEN, time_ns=5 * NS, causes=causes[:1], reports=causes[1:]), log)
    assert table.count('class="cause"') == 2
    assert "<b>elbow, wrist</b> a reading is missing</td><td>00:00:01</td>" in table
    assert "no encoder</td><td></td>" in table


def test_a_replay_shows_the_events_up_to_its_position() -> None:
    log = EventLog()
    for second, causes in ((1, [LOST]), (4, []), (8, [LOST]), (9, [])):
        log.update("state", second * NS, causes)
    shown = {second: events_table(log, second * NS) for second in (0, 2, 6, 9)}
    assert "no events" in shown[0]
    assert [table.count('class="event"') for table in shown.values()] == [0, 1, 1, 2]
    assert ">1.0 s</span>, lasts" in shown[2]
    assert ">3.0 s</span></td>" in shown[6]
