# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest
from posor.chain.time_synchroniser import MAX_OPEN_SCANS, TimeSynchroniser, synchronise_stamps
from posor.errors import ChainError
from posor_lab.harness.case_tables import cases, refusal

JOINTS = ("shoulder", "elbow", "wrist")


@pytest.fixture
def synchroniser() -> TimeSynchroniser[str]:
    return TimeSynchroniser(JOINTS)


def whole(stamp: int) -> dict[str, str]:
    return {joint: f"{joint} at {stamp}" for joint in JOINTS}


def add(synchroniser: TimeSynchroniser[str], joint: str, stamp: int) -> dict[str, str] | None:
    return synchroniser.add(joint, stamp, f"{joint} at {stamp}", 0.0)


def send(synchroniser: TimeSynchroniser[str], stamps: Iterable[int], joints: Iterable[str] = JOINTS) -> None:
    for stamp in stamps:
        for joint in joints:
            add(synchroniser, joint, stamp)


def replay(events: str) -> tuple[str, dict[int, str]]:
    """Return the complete scans of these items, and the missing members by stamp.

    ``s7 e7 w7'`` are items of shoulder, elbow and wrist with stamp 7; a quote marks the second epoch. A complete scan
    is shown by the stamp and quote that all its items have in common.
    """
    synchroniser: TimeSynchroniser[str] = TimeSynchroniser(JOINTS)
    members = {joint[0]: joint for joint in JOINTS}
    complete: list[str] = []
    incomplete: dict[int, str] = {}
    for event in events.split():
        name, item = event[0], event[1:]
        scan = synchroniser.add(members[name], int(item.rstrip("'")), item, 0.0)
        if scan is not None:
            assert scan == dict.fromkeys(JOINTS, item)
            complete.append(item)
        for stamp, missing in synchroniser.take_incomplete().items():
            incomplete[stamp] = "".join(joint[0] for joint in missing)
    return " ".join(complete), incomplete


def test_of_two_items_of_one_stamp_the_first_counts(synchroniser: TimeSynchroniser[str]) -> None:
    for item in ("sound", "lost, because it was sent twice"):
        assert synchroniser.add("shoulder", 7, item, 0.0) is None
    add(synchroniser, "elbow", 7)
    assert add(synchroniser, "wrist", 7) == whole(7) | {"shoulder": "sound"}


@pytest.mark.parametrize(**cases(__file__, "synchronised_items.yaml"))
def test_items_are_combined_by_stamp_and_epoch(events: str, complete: str, incomplete: dict[int, str]) -> None:
    assert replay(events) == (complete, incomplete)


def test_one_joint_alone() -> None:
    synchroniser: TimeSynchroniser[str] = TimeSynchroniser(("only",))
    assert synchroniser.add("only", 5, "item", 0.0) == {"only": "item"}


def test_any_order_of_arrival_gives_scans_of_one_stamp_in_order(rng: np.random.Generator) -> None:
    """Each joint sends in order and loses a tenth of its items; the network mixes the joints."""
    for _ in range(50):
        synchroniser: TimeSynchroniser[str] = TimeSynchroniser(JOINTS)
        queues = {joint: [stamp for stamp in range(1, 60) if rng.random() > 0.1] for joint in JOINTS}
        complete = set.intersection(*(set(queue) for queue in queues.values()))
        complete_scans = []
        incomplete: dict[int, tuple[str, ...]] = {}
        sent = {joint: set(queue) for joint, queue in queues.items()}
        while any(queues.values()):
            joint = JOINTS[rng.integers(len(JOINTS))]
            if queues[joint]:
                stamp = queues[joint].pop(0)
                scan = add(synchroniser, joint, stamp)
                incomplete |= synchroniser.take_incomplete()
                if scan is not None:
                    assert scan == whole(stamp)
                    complete_scans.append(stamp)
        assert complete_scans == sorted(complete_scans)
        assert set(complete_scans) == complete  # each joint is in order, so no complete scan is overtaken
        for stamp, missing in incomplete.items():
            assert missing == tuple(joint for joint in JOINTS if stamp not in sent[joint])


@pytest.mark.parametrize("first_joint_back", JOINTS)
def test_a_restarted_replay_is_followed_from_its_first_scan(
    first_joint_back: str, synchroniser: TimeSynchroniser[str]
) -> None:
    others = [joint for joint in JOINTS if joint != first_joint_back]
    send(synchroniser, (100, 200, 300))
    for round_ in range(2):
        for stamp in (100, 200, 300):
            add(synchroniser, first_joint_back, stamp)
            assert add(synchroniser, others[0], stamp) is None
            assert add(synchroniser, others[1], stamp) == whole(stamp), f"round {round_}"


def test_a_joint_that_was_silent_during_the_restart_of_the_others_joins_their_epoch(
    synchroniser: TimeSynchroniser[str],
) -> None:
    send(synchroniser, range(1, 10))
    send(synchroniser, range(1, 20), ("shoulder", "elbow"))
    scans = [add(synchroniser, joint, stamp) for stamp in range(20, 20 + 2 * MAX_OPEN_SCANS) for joint in JOINTS]
    assert scans[-1] == whole(19 + 2 * MAX_OPEN_SCANS)


@pytest.mark.parametrize("wrong", [1, 7, 9_000])
@pytest.mark.parametrize("joint", JOINTS)
def test_a_wrong_stamp_costs_only_its_own_scan(joint: str, wrong: int, synchroniser: TimeSynchroniser[str]) -> None:
    complete = []
    incomplete: dict[int, tuple[str, ...]] = {}
    others = tuple(other for other in JOINTS if other != joint)
    for stamp in range(10, 30):
        for each in JOINTS:
            sent_stamp = wrong if (each, stamp) == (joint, 20) else stamp
            scan = add(synchroniser, each, sent_stamp)
            incomplete |= synchroniser.take_incomplete()
            if scan is not None:
                assert scan == whole(stamp)
                complete.append(stamp)
    assert complete == [stamp for stamp in range(10, 30) if stamp != 20]
    assert incomplete == {20: (joint,), wrong: others}


def test_repeated_wrong_stamps_cost_only_their_own_scans(
    synchroniser: TimeSynchroniser[str], rng: np.random.Generator
) -> None:
    complete = []
    for stamp in range(101, 1100):
        scan = None
        for joint in rng.permutation(JOINTS).tolist():
            wrong = int(rng.integers(1, 5000)) if stamp % 10 == 0 and joint == JOINTS[stamp // 10 % 3] else stamp
            scan = add(synchroniser, joint, wrong)
        complete += [stamp] if scan == whole(stamp) else []
    assert complete == [stamp for stamp in range(101, 1100) if stamp % 10]


def test_any_number_of_consecutive_wrong_stamps(synchroniser: TimeSynchroniser[str]) -> None:
    complete = []
    for stamp in range(100, 100 + 4 * MAX_OPEN_SCANS):
        scans = [add(synchroniser, joint, 1 if joint == "wrist" and stamp % 2 else stamp) for joint in JOINTS]
        complete += [stamp] if scans[-1] == whole(stamp) else []
    assert complete == list(range(100, 100 + 4 * MAX_OPEN_SCANS, 2))
    assert sorted(synchroniser._keys) == sorted(synchroniser._open)  # no keys are left behind


def test_the_same_wrong_stamp_of_two_joints_begins_a_new_epoch(synchroniser: TimeSynchroniser[str]) -> None:
    incomplete: dict[int, tuple[str, ...]] = {}
    for stamp in range(10, 30 + 2 * MAX_OPEN_SCANS):
        scans = [add(synchroniser, joint, 9_000 if joint != "wrist" and stamp == 20 else stamp) for joint in JOINTS]
        incomplete |= synchroniser.take_incomplete()
    assert scans[-1] == whole(29 + 2 * MAX_OPEN_SCANS)
    assert incomplete[9_000] == ("wrist",)


def test_the_number_of_open_scans_is_bounded(synchroniser: TimeSynchroniser[str]) -> None:
    """A silent joint must not let memory grow; each closed scan names it."""
    send(synchroniser, range(1, MAX_OPEN_SCANS + 1), ("shoulder", "elbow"))
    assert synchroniser.take_incomplete() == {}
    send(synchroniser, range(MAX_OPEN_SCANS + 1, 3 * MAX_OPEN_SCANS + 1), ("shoulder", "elbow"))
    assert synchroniser.take_incomplete() == dict.fromkeys(range(1, 2 * MAX_OPEN_SCANS + 1), ("wrist",))


def test_an_unbounded_synchroniser_keeps_every_scan_open() -> None:
    synchroniser: TimeSynchroniser[str] = TimeSynchroniser(JOINTS, math.inf)
    stamps = range(1, 5 * MAX_OPEN_SCANS)
    for joint in JOINTS[:-1]:
        assert not any(add(synchroniser, joint, stamp) for stamp in stamps)
    assert [add(synchroniser, JOINTS[-1], stamp) for stamp in stamps] == [whole(stamp) for stamp in stamps]
    assert synchroniser.take_incomplete() == {}


def test_a_joint_far_behind_is_named(synchroniser: TimeSynchroniser[str]) -> None:
    """The wrist is so late that its scans have been closed: only the wrist is missing."""
    send(synchroniser, range(1, MAX_OPEN_SCANS + 11), ("shoulder", "elbow"))
    send(synchroniser, range(1, MAX_OPEN_SCANS + 11), ("wrist",))
    assert synchroniser.take_incomplete() == dict.fromkeys(range(1, 11), ("wrist",))


def test_an_item_later_than_max_wait_completes_nothing() -> None:
    synchroniser: TimeSynchroniser[str] = TimeSynchroniser(("a", "b"), max_wait=2.0)
    assert synchroniser.add("a", 1, "a1", 10.0) is None
    assert synchroniser.add("a", 2, "a2", 11.0) is None
    assert synchroniser.add("b", 1, "b1", 12.5) is None
    assert synchroniser.take_incomplete() == {1: ("b",)}
    assert synchroniser.add("b", 2, "b2", 13.0) == {"a": "a2", "b": "b2"}


def test_close_before_closes_late_scans_and_all_older_ones(synchroniser: TimeSynchroniser[str]) -> None:
    synchroniser.add("shoulder", 1, "shoulder", 20.0)  # an older scan whose first item came later
    synchroniser.add("shoulder", 2, "shoulder", 10.0)
    synchroniser.add("elbow", 2, "elbow", 19.0)
    synchroniser.add("elbow", 3, "elbow", 19.5)
    synchroniser.close_before(10.0)
    assert synchroniser.take_incomplete() == {}
    synchroniser.close_before(10.5)
    assert synchroniser.take_incomplete() == {1: ("elbow", "wrist"), 2: ("wrist",)}
    assert synchroniser.add("wrist", 2, "too late", 20.0) is None
    assert synchroniser.take_incomplete() == {}
    assert synchroniser.add("shoulder", 3, "shoulder", 20.0) is None
    assert synchroniser.add("wrist", 3, "wrist", 20.0) == {"wrist": "wrist", "shoulder": "shoulder", "elbow": "elbow"}
    synchroniser.close_before(1e9)
    assert synchroniser.take_incomplete() == {}


def test_items_added_together_give_the_scans_of_single_items(rng: np.random.Generator) -> None:
    together, single = (TimeSynchroniser[str](JOINTS, 3, 2.0) for _ in range(2))
    stamp, complete = 0, 0
    for step in range(3000):
        stamp = max(1, stamp + int(rng.choice([1, 1, 1, 1, 1, 0, -1, -40])))  # a repeated, a wrong stamp, a new epoch
        joints = [str(joint) for joint in rng.permutation(JOINTS)[: rng.choice([3, 3, 3, 2, 1])]]
        items = {joint: f"{joint} {step}" for joint in joints}
        if rng.random() < 0.05:
            wrong = joints[0], stamp + int(rng.choice([-5, 1000])), "wrong", float(step)
            assert together.add(*wrong) == single.add(*wrong)
        expected = None
        for joint, item in items.items():
            expected = single.add(joint, stamp, item, float(step)) or expected
        assert together.add_together(stamp, items, float(step)) == expected
        assert together.take_incomplete() == single.take_incomplete()
        complete += expected is not None
    assert 500 < complete < 2500


def replay_items(
    stamps: list[list[int]], rng: np.random.Generator
) -> tuple[list[dict[str, int]], dict[int, tuple[str, ...]]]:
    """Return complete and incomplete scans of a TimeSynchroniser; the items are indices."""
    synchroniser: TimeSynchroniser[int] = TimeSynchroniser(JOINTS, math.inf)
    order = rng.permutation(np.repeat(np.arange(len(JOINTS)), [len(own) for own in stamps]))
    indices = [0] * len(JOINTS)
    complete_scans = []
    for joint in order.tolist():
        scan = synchroniser.add(JOINTS[joint], stamps[joint][indices[joint]], indices[joint], 0.0)
        indices[joint] += 1
        if scan is not None:
            complete_scans.append(scan)
    return complete_scans, synchroniser.take_incomplete()


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.9, 1.0])
def test_synchronise_stamps_agrees_with_the_synchroniser(loss: float, rng: np.random.Generator) -> None:
    for _ in range(20):
        stamps = [[stamp for stamp in range(60) if rng.random() >= loss] for _ in JOINTS]
        complete_scans, incomplete = replay_items(stamps, rng)
        arrays = [np.array(own, dtype=np.int64) for own in stamps]
        joined = synchronise_stamps(arrays)
        assert [dict(zip(JOINTS, row, strict=True)) for row in joined.index.tolist()] == complete_scans
        for column, own in enumerate(arrays):
            np.testing.assert_array_equal(own[joined.index[:, column]], joined.stamps)
            assert all(own[joined.first_open[column] :] > joined.stamps.max(initial=-1))
            assert all(own[: joined.first_open[column]] <= joined.stamps.max(initial=-1))
        missing = [tuple(name for name, is_ in zip(JOINTS, row, strict=True) if is_) for row in joined.missing]
        assert dict(zip(joined.incomplete.tolist(), missing, strict=True)) == incomplete


@pytest.mark.parametrize("stamps", [[5, 7, 7], [5, 7, 6]])
def test_synchronise_stamps_refuses_stamps_that_do_not_increase(stamps: list[int]) -> None:
    error = refusal(ChainError, synchronise_stamps, [np.arange(9), np.array(stamps)])
    assert str(error) == f"member 1: stamp {stamps[2]} after 7; expected stamps that increase."
