# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Judges how a generated bag is read and recovered, by the record of what was written into it."""

from __future__ import annotations

import re
from collections import Counter
from enum import Enum
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from mcap.reader import make_reader
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import file_name_of
from posor.bags.block_reader import read_messages
from posor.bags.recover_command import recover
from posor.errors import PosorError

from posor_lab.foreign_bags.generated_bag import STATES_MORE

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor_lab.foreign_bags.generated_bag import GeneratedBag

LEFT_OUT = re.compile(r"topic (\S+) is left out: (\d+) messages ")


class Outcome(Enum):
    """What became of a bag."""

    READ = "read whole"
    LISTED = "read, with notes"
    REFUSED = "refused in one sentence"
    RECOVERED = "recovered whole"
    WRONG = "wrong"


class Judgement(NamedTuple):
    """The outcome of a bag, and the sentence of a refusal, the notes, or what is wrong."""

    outcome: Outcome
    reason: str = ""


def judge_reading(bag: GeneratedBag) -> Judgement:
    """Read all messages of a bag and compare them with those that were written."""
    try:
        with opened_bag(bag.path, log_notes=False) as reader:
            notes = reader.notes()
            topics = sorted({each.topic for each in reader.connections})
            found = [(each.topic, time_ns, data) for each, time_ns, data in read_messages(reader, topics, "bag")]
    except PosorError as error:
        may_refuse = (bag.fault or not bag.read) and "\n" not in str(error)
        return Judgement(Outcome.REFUSED if may_refuse else Outcome.WRONG, str(error))
    except Exception as error:  # noqa: BLE001  whatever it is, it is a finding
        return Judgement(Outcome.WRONG, f"{type(error).__name__}: {error}")
    if problem := _difference(bag, found, notes):
        return Judgement(Outcome.WRONG, problem)
    return Judgement(Outcome.LISTED if notes else Outcome.READ, "; ".join(notes))


def _difference(bag: GeneratedBag, found: Sequence[tuple[str, int, bytes]], notes: Sequence[str]) -> str:
    """Return how messages that were read, and notes, differ from what was written; empty: they do not."""
    missing, more = (bag.read - Counter(found)).total(), (Counter(found) - bag.read).total()
    if missing or more:
        return f"{missing} messages are missing, {more} were not written"
    if any(first[1] > second[1] for first, second in pairwise(found)):
        return "messages are not in the order of their log times"
    matches = [match for note in notes if (match := LEFT_OUT.match(note))]
    listed = Counter({match[1]: int(match[2]) for match in matches})
    if listed != bag.left_out:
        return f"{listed} is listed, {bag.left_out} left out"
    if bag.fault == STATES_MORE and len(matches) == len(notes):
        return "the messages that metadata.yaml states are missing without a note"
    return ""


def judge_recovery(bag: GeneratedBag, output: Path) -> Judgement:
    """Recover a bag of whole MCAP files; every message must be copied, whatever its encoding."""
    try:
        rescues = recover(bag.path, output)
    except PosorError as error:
        return Judgement(Outcome.WRONG, f"not recovered: {error}")
    if damages := [damage.what for rescue in rescues for damage in rescue.damages]:
        return Judgement(Outcome.WRONG, f"recover finds damage: {damages[0]}")
    with (output / file_name_of(output)).open("rb") as file:
        messages = make_reader(file).iter_messages()
        copied = Counter((channel.topic, message.log_time, message.data) for _, channel, message in messages)
    wanted = Counter((each.topic.name, each.time_ns, each.data) for each in bag.messages)
    if copied == wanted and sum(rescue.messages for rescue in rescues) == wanted.total():
        return Judgement(Outcome.RECOVERED)
    return Judgement(Outcome.WRONG, f"recover copies {copied.total()} of {wanted.total()} messages")
