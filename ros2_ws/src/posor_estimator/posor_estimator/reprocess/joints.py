"""All joints of an arm, block after block: those whose POSORs are of one design are located abreast."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING

from posor_estimator.core.abreast import LEAST, WORTH, Abreast, design_of
from posor_estimator.core.compiled import EIGHT

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from posor_estimator.bulk.pieces import Piece
    from posor_estimator.core.abreast import Design
    from posor_estimator.core.records import Records
    from posor_estimator.reprocess.joint import JointReprocessor, Work
    from posor_estimator.reprocess.transforms import Transforms


class Joints:
    """Turns the recorded scans of all joints into transforms."""

    def __init__(self, joints: Mapping[str, JointReprocessor]) -> None:
        """Begin with joints that have done nothing yet."""
        self._joints = joints
        self._abreast: dict[tuple[Records, ...], Abreast] = {}

    def transforms(self, pieces: Mapping[str, Iterable[Piece]]) -> dict[str, Transforms]:
        """Return the transforms of a block's scans, by joint; every number is NaN where a scan gives no pose."""
        works = {name: [self._joints[name].work(piece) for piece in pieces[name]] for name in pieces}
        for side_by_side in zip_longest(*works.values()):
            self._locate([work for work in side_by_side if work is not None])
        return {name: self._joints[name].transforms(done) for name, done in works.items()}

    def _locate(self, works: Sequence[Work]) -> None:
        """Locate the scans of some joints: together with others as long as these have any, then alone.

        Of the rooms that were made for the pieces before only those are kept that are used again.
        """
        former, self._abreast = self._abreast, {}
        done: dict[Records, int] = {}
        for group in _groups(works):
            count, records = min(len(work.out) for work in group), tuple(work.records for work in group)
            if count < WORTH:
                continue
            abreast = self._abreast[records] = former.get(records) or Abreast(records)
            raw, out = [work.piece.table.rows[:count] for work in group], [work.out.rows[:count] for work in group]
            abreast.locate(raw, out)
            done |= dict.fromkeys(records, count)
        for work in works:
            work.locate(done.get(work.records, 0))


def _groups(works: Iterable[Work]) -> Iterator[list[Work]]:
    """Yield pieces whose scans can be located abreast, and are worth it."""
    designs: dict[Design, list[Work]] = {}
    for work in works:
        if (design := design_of(work.records)) is not None:
            designs.setdefault(design, []).append(work)
    for alike in designs.values():
        for begin in range(0, len(alike), EIGHT):
            group = alike[begin : begin + EIGHT]
            if len(group) >= LEAST:
                yield group
