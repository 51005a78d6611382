"""Judges how a generated bag is read and recovered, by the record of what was written into it."""

from __future__ import annotations

import re
from collections import Counter
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from mcap.reader import make_reader
from posor.bags.bag_reader import opened_bag
from posor.bags.block_reader import read_messages
from posor.bags.recover_command import recover
from posor.errors import PosorError

if TYPE_CHECKING:
    from pathlib import Path

    from posor_lab.foreign_bags.generated_bag import GeneratedBag

LEFT_OUT = re.compile(r"topic (\S+) is left out: (\d+) messages ")


class Outcome(Enum):
    """What became of a bag."""

    READ = "read whole"
    LISTED = "read, the rest listed"
    REFUSED = "refused in one sentence"
    WRONG = "wrong"


class Judgement(NamedTuple):
    """The outcome of a bag, and the sentence of a refusal or what is wrong."""

    outcome: Outcome
    reason: str


def judge_reading(bag: GeneratedBag) -> Judgement:
    """Read all messages of a bag and compare them with those that were written."""
    try:
        with opened_bag(bag.path, log_notes=False) as reader:
            notes = reader.notes()
            topics = sorted({each.topic for each in reader.connections})
            found = [(each.topic, time_ns, data) for each, time_ns, data in read_messages(reader, topics, "bag")]
    except PosorError as error:
        if "\n" in str(error):
            return Judgement(Outcome.WRONG, f"more than one line: {error}")
        if bag.fault or not bag.read:
            return Judgement(Outcome.REFUSED, str(error))
        return Judgement(Outcome.WRONG, f"refused: {error}")
    except Exception as error:  # noqa: BLE001  whatever it is, it is a finding
        return Judgement(Outcome.WRONG, f"{type(error).__name__}: {error}")
    missing, more = (bag.read - Counter(found)).total(), (Counter(found) - bag.read).total()
    if more or (missing and not (bag.fault and notes)):
        return Judgement(Outcome.WRONG, f"{missing} messages are missing, {more} were not written")
    unlisted = [topic for topic, count in bag.left_out.items() if not _is_listed(topic, count, notes)]
    if missing and not bag.fault:
        return Judgement(Outcome.WRONG, f"{missing} of {written.total()} messages are missing")
    if missing and not notes:
        return Judgement(Outcome.WRONG, f"{missing} of {written.total()} messages are missing in silence")
    if unlisted:
        return Judgement(Outcome.WRONG, f"not listed: {', '.join(unlisted)}")
    if any(first[1] > second[1] for first, second in zip(found, found[1:], strict=False)):
        return Judgement(Outcome.WRONG, "messages not in the order of their log times")
    return Judgement(Outcome.LISTED if notes else Outcome.READ, "; ".join(notes))


def _is_listed(topic: str, count: int, notes: list[str]) -> bool:
    return sum(int(match[2]) for note in notes if (match := LEFT_OUT.match(note)) and match[1] == topic) == count


def judge_recovery(bag: GeneratedBag, output: Path) -> Judgement:
    """Recover a bag of whole MCAP files; every message must be copied, whatever its encoding."""
    try:
        rescues = recover(bag.path, output)
    except PosorError as error:
        return Judgement(Outcome.WRONG, f"not recovered: {error}")
    if damages := [damage.what for rescue in rescues for damage in rescue.damages]:
        return Judgement(Outcome.WRONG, f"recover finds damage: {damages[0]}")
    with (output / f"{output.name}.mcap").open("rb") as file:
        copied = Counter(
            (channel.topic, each.log_time, each.data) for _, channel, each in make_reader(file).iter_messages()
        )
    wanted = Counter((each.topic.name, each.time_ns, each.data) for each in bag.messages)
    if copied == wanted and sum(rescue.messages for rescue in rescues) == wanted.total():
        return Judgement(Outcome.READ, "")
    return Judgement(Outcome.WRONG, f"recover copies {copied.total()} of {wanted.total()} messages")
