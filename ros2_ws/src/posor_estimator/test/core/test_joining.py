from __future__ import annotations

import math

import numpy as np
import pytest
from posor_estimator.core.joining import MOST_OPEN, ScanJoiner, join_all
from posor_estimator.errors import ChainError

JOINTS = ("shoulder", "elbow", "wrist")


@pytest.fixture
def joiner() -> ScanJoiner[str]:
    return ScanJoiner(JOINTS)


def whole(stamp: int) -> dict[str, str]:
    return {joint: f"{joint} at {stamp}" for joint in JOINTS}


def add(joiner: ScanJoiner[str], joint: str, stamp: int) -> dict[str, str] | None:
    return joiner.add(joint, stamp, f"{joint} at {stamp}", 0.0)


def test_a_scan_is_handed_out_once_when_its_last_item_comes(joiner: ScanJoiner[str]) -> None:
    assert add(joiner, "wrist", 7) is None
    assert add(joiner, "shoulder", 7) is None
    assert add(joiner, "elbow", 7) == whole(7)
    assert joiner.take_given_up() == {}


def test_one_joint_needs_no_others() -> None:
    joiner: ScanJoiner[str] = ScanJoiner(("only",))
    assert joiner.add("only", 5, "item", 0.0) == {"only": "item"}


def test_the_same_item_twice_does_not_stand_for_another_joint(joiner: ScanJoiner[str]) -> None:
    for _ in range(len(JOINTS) + 1):
        assert add(joiner, "shoulder", 7) is None
    add(joiner, "elbow", 7)
    assert add(joiner, "wrist", 7) == whole(7)


def test_stamps_one_nanosecond_apart_are_never_mixed(joiner: ScanJoiner[str]) -> None:
    add(joiner, "shoulder", 1_000)
    add(joiner, "elbow", 1_000)
    assert add(joiner, "wrist", 1_001) is None
    assert add(joiner, "shoulder", 1_001) is None
    assert add(joiner, "elbow", 1_001) == whole(1_001)


def test_whatever_the_order_a_scan_holds_one_stamp_and_scans_come_in_order(rng: np.random.Generator) -> None:
    """Each joint sends in order and loses a tenth; the network mixes the joints as it likes."""
    for _ in range(50):
        joiner: ScanJoiner[str] = ScanJoiner(JOINTS)
        queues = {joint: [stamp for stamp in range(1, 60) if rng.random() > 0.1] for joint in JOINTS}
        complete = set.intersection(*(set(queue) for queue in queues.values()))
        handed_out = []
        given_up: dict[int, tuple[str, ...]] = {}
        sent = {joint: set(queue) for joint, queue in queues.items()}
        while any(queues.values()):
            joint = JOINTS[rng.integers(len(JOINTS))]
            if queues[joint]:
                stamp = queues[joint].pop(0)
                scan = add(joiner, joint, stamp)
                given_up |= joiner.take_given_up()
                if scan is not None:
                    assert scan == whole(stamp)
                    handed_out.append(stamp)
        assert handed_out == sorted(handed_out)
        assert set(handed_out) == complete  # as each joint is in order, no complete scan can be overtaken
        for stamp, missing in given_up.items():
            assert missing == tuple(joint for joint in JOINTS if stamp not in sent[joint])


def test_an_older_scan_is_given_up_when_a_newer_one_is_complete(joiner: ScanJoiner[str]) -> None:
    add(joiner, "shoulder", 1)
    add(joiner, "elbow", 2)
    add(joiner, "wrist", 2)
    for joint in JOINTS:
        add(joiner, joint, 3)
    assert joiner.take_given_up() == {1: ("elbow", "wrist"), 2: ("shoulder",)}
    assert joiner.take_given_up() == {}


def test_a_newer_incomplete_scan_stays_open(joiner: ScanJoiner[str]) -> None:
    add(joiner, "wrist", 8)
    add(joiner, "wrist", 9)
    add(joiner, "shoulder", 8)
    assert add(joiner, "elbow", 8) == whole(8)
    assert joiner.take_given_up() == {}
    add(joiner, "shoulder", 9)
    assert add(joiner, "elbow", 9) == whole(9)


def test_items_of_a_scan_that_is_done_come_too_late(joiner: ScanJoiner[str]) -> None:
    for joint in ("shoulder", "elbow"):
        add(joiner, joint, 5)
        add(joiner, joint, 6)
    assert add(joiner, "wrist", 6) == whole(6)
    for joint in JOINTS:
        assert add(joiner, joint, 6) is None
    assert joiner.take_given_up() == {5: ("wrist",)}


@pytest.mark.parametrize("first_joint_back", JOINTS)
def test_a_replay_that_starts_over_is_followed_from_its_first_scan(
    first_joint_back: str, joiner: ScanJoiner[str]
) -> None:
    others = [joint for joint in JOINTS if joint != first_joint_back]
    for stamp in (100, 200, 300):
        for joint in JOINTS:
            add(joiner, joint, stamp)
    for round_ in range(2):
        for stamp in (100, 200, 300):
            add(joiner, first_joint_back, stamp)
            assert add(joiner, others[0], stamp) is None
            assert add(joiner, others[1], stamp) == whole(stamp), f"round {round_}"


def test_a_replay_that_starts_over_is_followed(joiner: ScanJoiner[str]) -> None:
    for _ in range(3):
        for stamp in (100, 200, 300):
            scans = [add(joiner, joint, stamp) for joint in JOINTS]
        assert scans[-1] == whole(300)


def test_a_replay_that_starts_over_is_not_joined_with_its_past(joiner: ScanJoiner[str]) -> None:
    """Two joints' items of a scan before the jump must not be completed by the third's after it."""
    add(joiner, "shoulder", 100)
    add(joiner, "elbow", 100)
    add(joiner, "wrist", 200)
    assert joiner.add("wrist", 100, "wrist of the second round", 0.0) is None
    assert joiner.add("shoulder", 100, "shoulder of the second round", 0.0) is None
    assert joiner.add("elbow", 100, "elbow of the second round", 0.0) == {
        joint: f"{joint} of the second round" for joint in JOINTS
    }


def test_items_of_the_round_before_are_never_joined_with_those_of_the_next(joiner: ScanJoiner[str]) -> None:
    """The wrist has started over and is ahead again; the others' last items of the old round have its stamps."""

    def second(joint: str, stamp: int) -> dict[str, str] | None:
        return joiner.add(joint, stamp, f"{joint} at {stamp} of the second round", 0.0)

    for stamp in (100, 200):
        for joint in JOINTS:
            add(joiner, joint, stamp)
    for stamp in (100, 200, 300):
        assert second("wrist", stamp) is None
    for joint in ("shoulder", "elbow"):
        assert add(joiner, joint, 300) is None
    for stamp in (100, 200, 300):
        second("shoulder", stamp)
        assert second("elbow", stamp) == {joint: f"{joint} at {stamp} of the second round" for joint in JOINTS}


def test_a_joint_that_was_silent_while_the_others_started_over_is_taken_back(joiner: ScanJoiner[str]) -> None:
    for stamp in range(1, 10):
        for joint in JOINTS:
            add(joiner, joint, stamp)
    for stamp in range(1, 20):
        add(joiner, "shoulder", stamp)
        add(joiner, "elbow", stamp)
    scans = [add(joiner, joint, stamp) for stamp in range(20, 20 + 2 * MOST_OPEN) for joint in JOINTS]
    assert scans[-1] == whole(19 + 2 * MOST_OPEN)


@pytest.mark.parametrize("wrong", [1, 7, 9_000])
@pytest.mark.parametrize("joint", JOINTS)
def test_a_wrong_stamp_costs_its_own_scan_only(joint: str, wrong: int, joiner: ScanJoiner[str]) -> None:
    complete = []
    given_up: dict[int, tuple[str, ...]] = {}
    others = tuple(other for other in JOINTS if other != joint)
    for stamp in range(10, 30):
        for each in JOINTS:
            said = wrong if (each, stamp) == (joint, 20) else stamp
            scan = add(joiner, each, said)
            given_up |= joiner.take_given_up()
            if scan is not None:
                assert scan == whole(stamp)
                complete.append(stamp)
    assert complete == [stamp for stamp in range(10, 30) if stamp != 20]
    assert given_up == {20: (joint,), wrong: others}


def test_wrong_stamps_now_and_then_cost_their_own_scans(joiner: ScanJoiner[str], rng: np.random.Generator) -> None:
    complete = []
    for stamp in range(101, 1100):
        scan = None
        for joint in rng.permutation(JOINTS).tolist():
            wrong = int(rng.integers(1, 5000)) if stamp % 10 == 0 and joint == JOINTS[stamp // 10 % 3] else stamp
            scan = add(joiner, joint, wrong)
        complete += [stamp] if scan == whole(stamp) else []
    assert complete == [stamp for stamp in range(101, 1100) if stamp % 10]


def test_any_number_of_wrong_stamps_may_come_after_one_another(joiner: ScanJoiner[str]) -> None:
    complete = []
    for stamp in range(100, 100 + 4 * MOST_OPEN):
        scans = [add(joiner, joint, 1 if joint == "wrist" and stamp % 2 else stamp) for joint in JOINTS]
        complete += [stamp] if scans[-1] == whole(stamp) else []
    assert complete == list(range(100, 100 + 4 * MOST_OPEN, 2))
    assert sorted(joiner._keys) == sorted(joiner._open)  # nothing of them stays


def test_what_came_before_a_wrong_stamp_is_remembered(joiner: ScanJoiner[str]) -> None:
    for stamp in (19, 20):
        for joint in JOINTS:
            add(joiner, joint, stamp)
    for stamp in (7, 21, 15):  # a wrong one, the next one, and a second round
        add(joiner, "shoulder", stamp)
    add(joiner, "elbow", 21)
    assert add(joiner, "wrist", 21) == whole(21)
    add(joiner, "elbow", 15)
    assert add(joiner, "wrist", 15) == whole(15)


def test_the_same_wrong_stamp_of_two_joints_ends_with_a_new_round(joiner: ScanJoiner[str]) -> None:
    given_up: dict[int, tuple[str, ...]] = {}
    for stamp in range(10, 30 + 2 * MOST_OPEN):
        scans = [add(joiner, joint, 9_000 if joint != "wrist" and stamp == 20 else stamp) for joint in JOINTS]
        given_up |= joiner.take_given_up()
    assert scans[-1] == whole(29 + 2 * MOST_OPEN)
    assert given_up[9_000] == ("wrist",)


def test_a_joint_that_starts_over_alone_and_comes_farther_than_before_stays_in_its_round(
    joiner: ScanJoiner[str],
) -> None:
    for stamp in (100, 200):
        for joint in JOINTS:
            add(joiner, joint, stamp)
    for stamp in (100, 300):
        add(joiner, "wrist", stamp)  # a wrong stamp: what goes on is the first round
    for stamp in (100, 200, 400):
        add(joiner, "wrist", stamp)  # a second round
    assert joiner.take_given_up() == {100: ("shoulder", "elbow")}
    for stamp in (300, 400):  # of the first round, where the wrist has sent no 400
        assert add(joiner, "shoulder", stamp) is None
        assert add(joiner, "elbow", stamp) == (whole(300) if stamp == 300 else None)
    for stamp in (100, 200, 400):
        assert add(joiner, "shoulder", stamp) is None
        assert add(joiner, "elbow", stamp) == whole(stamp)


def test_no_more_than_so_many_scans_are_open(joiner: ScanJoiner[str]) -> None:
    """A joint that is off must not make the memory grow; each scan is given up with its name."""
    for stamp in range(1, MOST_OPEN + 1):
        add(joiner, "shoulder", stamp)
        add(joiner, "elbow", stamp)
    assert joiner.take_given_up() == {}
    for stamp in range(MOST_OPEN + 1, 3 * MOST_OPEN + 1):
        add(joiner, "shoulder", stamp)
        add(joiner, "elbow", stamp)
    given_up = joiner.take_given_up()
    assert given_up == dict.fromkeys(range(1, 2 * MOST_OPEN + 1), ("wrist",))


def test_a_replay_without_loss_keeps_every_scan_open() -> None:
    joiner: ScanJoiner[str] = ScanJoiner(JOINTS, math.inf)
    stamps = range(1, 5 * MOST_OPEN)
    for joint in JOINTS[:-1]:
        assert not any(add(joiner, joint, stamp) for stamp in stamps)
    assert [add(joiner, JOINTS[-1], stamp) for stamp in stamps] == [whole(stamp) for stamp in stamps]
    assert joiner.take_given_up() == {}


def test_a_joint_that_lags_far_behind_is_the_one_that_is_named(joiner: ScanJoiner[str]) -> None:
    """The wrist is so late that its scans have been given up: it is missing, the other two are not."""
    for stamp in range(1, MOST_OPEN + 11):
        add(joiner, "shoulder", stamp)
        add(joiner, "elbow", stamp)
    for stamp in range(1, MOST_OPEN + 11):
        add(joiner, "wrist", stamp)
    assert joiner.take_given_up() == dict.fromkeys(range(1, 11), ("wrist",))


def test_an_item_that_comes_too_long_after_the_first_completes_nothing() -> None:
    joiner: ScanJoiner[str] = ScanJoiner(("a", "b"), max_wait=2.0)
    assert joiner.add("a", 1, "a1", 10.0) is None
    assert joiner.add("a", 2, "a2", 11.0) is None
    assert joiner.add("b", 1, "b1", 12.5) is None
    assert joiner.take_given_up() == {1: ("b",)}
    assert joiner.add("b", 2, "b2", 13.0) == {"a": "a2", "b": "b2"}


def test_a_scan_that_waits_too_long_is_given_up_with_all_older_ones(joiner: ScanJoiner[str]) -> None:
    joiner.add("shoulder", 1, "shoulder", 20.0)  # an older scan whose first item came later
    joiner.add("shoulder", 2, "shoulder", 10.0)
    joiner.add("elbow", 2, "elbow", 19.0)
    joiner.add("elbow", 3, "elbow", 19.5)
    joiner.give_up_before(10.0)
    assert joiner.take_given_up() == {}
    joiner.give_up_before(10.5)
    assert joiner.take_given_up() == {1: ("elbow", "wrist"), 2: ("wrist",)}
    assert joiner.add("wrist", 2, "too late", 20.0) is None
    assert joiner.take_given_up() == {}
    assert joiner.add("shoulder", 3, "shoulder", 20.0) is None
    assert joiner.add("wrist", 3, "wrist", 20.0) == {"wrist": "wrist", "shoulder": "shoulder", "elbow": "elbow"}
    joiner.give_up_before(1e9)
    assert joiner.take_given_up() == {}


def live_decisions(
    stamps: list[list[int]], rng: np.random.Generator
) -> tuple[list[dict[str, int]], dict[int, tuple[str, ...]]]:
    """Return what a ScanJoiner hands out and gives up of these stamps; items are places."""
    joiner: ScanJoiner[int] = ScanJoiner(JOINTS, math.inf)
    order = rng.permutation(np.repeat(np.arange(len(JOINTS)), [len(own) for own in stamps]))
    places = [0] * len(JOINTS)
    handed_out = []
    for joint in order.tolist():
        scan = joiner.add(JOINTS[joint], stamps[joint][places[joint]], places[joint], 0.0)
        places[joint] += 1
        if scan is not None:
            handed_out.append(scan)
    return handed_out, joiner.take_given_up()


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.9, 1.0])
def test_all_at_once_joins_what_one_after_the_other_does(loss: float, rng: np.random.Generator) -> None:
    for _ in range(20):
        stamps = [[stamp for stamp in range(60) if rng.random() >= loss] for _ in JOINTS]
        handed_out, given_up = live_decisions(stamps, rng)
        arrays = [np.array(own, dtype=np.int64) for own in stamps]
        joined = join_all(arrays)
        assert [dict(zip(JOINTS, row, strict=True)) for row in joined.index.tolist()] == handed_out
        for column, own in enumerate(arrays):
            np.testing.assert_array_equal(own[joined.index[:, column]], joined.stamps)
            assert all(own[joined.still_open[column] :] > joined.stamps.max(initial=-1))
            assert all(own[: joined.still_open[column]] <= joined.stamps.max(initial=-1))
        missing = [tuple(name for name, is_ in zip(JOINTS, row, strict=True) if is_) for row in joined.missing]
        assert dict(zip(joined.given_up.tolist(), missing, strict=True)) == given_up


@pytest.mark.parametrize("stamps", [[5, 7, 7], [5, 7, 6]])
def test_stamps_that_do_not_increase_cannot_be_joined_all_at_once(stamps: list[int]) -> None:
    with pytest.raises(ChainError) as caught:
        join_all([np.arange(9), np.array(stamps)])
    assert str(caught.value) == f"member 1: stamp {stamps[2]} after 7; expected stamps that increase."
