"""Joints together: each gets the transforms that it would get alone, in order, whatever the others have."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.bulk.layout import TableLayout
from posor_estimator.bulk.pieces import Piece
from posor_estimator.core.abreast import Abreast
from posor_estimator.core.compiled import COMPILING, EIGHT
from posor_estimator.core.designs import design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.reprocess.joint import JointReprocessor
from posor_estimator.reprocess.joints import Joints
from posor_msgs.msg import RawScan

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.types import ByteArray

NS = 1_000_000_000


def joint(name: DesignName) -> tuple[Calibration, JointReprocessor]:
    calibration = design(name)
    return calibration, JointReprocessor(calibration, "total", 1e-4)


def piece(calibration: Calibration, begin: int, count: int) -> Piece:
    """Return scans of a target that turns, recorded a millisecond apart."""
    ticks = np.arange(begin + 1, begin + count + 1)
    rotations = np.array([rotation_from_native(1e-4, -2e-4, 1e-4 * tick) for tick in ticks])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (count, 1))
    scans = scans_at(Posor(calibration).stack, rotations, translations, ticks * 1_000_000)
    message = RawScan(
        gap_voltages=[0.0] * scans.gap_voltages.shape[1],
        ring_voltages=[0.0] * scans.ring_voltages.shape[1],
        diode_currents=[0.0] * scans.diode_currents[0].size,
        lit_sources=[0] * scans.lit_sources.shape[1],
        supply_voltage=float("nan"),
        temperature=float("nan"),
    )
    message.header.frame_id = calibration.frames.parent
    table = TableLayout.like(message).new(count)
    table["header.stamp.sec"], table["header.stamp.nanosec"] = scans.stamps_ns // NS, scans.stamps_ns % NS
    table["scan"] = ticks
    table["gap_voltages"], table["ring_voltages"] = scans.gap_voltages, scans.ring_voltages
    table["diode_currents"] = scans.diode_currents.reshape(count, -1)
    table["lit_sources"] = scans.lit_sources
    return Piece(scans.stamps_ns, ticks, table)


@pytest.mark.parametrize("number", [2, 5, EIGHT + 4])
def test_each_joint_gets_what_it_would_get_alone(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    made = {f"joint_{n}": joint("triad_bumpy_ring" if n == 1 else "triad_diodes") for n in range(number)}
    blocks = []
    for block in range(3):
        pieces: dict[str, list[Piece]] = {}
        for n, (name, (calibration, _)) in enumerate(made.items()):
            begin = 80 * block
            # One joint has fewer scans than the others, one in pieces, one none at all for a while.
            cuts = [begin, begin + 80 - 3 * (n == 0)] if n != 4 else [begin, begin + 30, begin + 31, begin + 80]
            pieces[name] = [piece(calibration, a, b - a) for a, b in pairwise(cuts)]
            if n == 3 and block == 1:
                pieces[name] = []
        blocks.append(pieces)

    abreast = 0
    locate = Abreast.locate

    def counted(together: Abreast, raw: list[ByteArray], out: list[ByteArray]) -> None:
        nonlocal abreast
        abreast += len(raw) * len(raw[0])
        locate(together, raw, out)

    monkeypatch.setattr(Abreast, "locate", counted)
    together = Joints({name: reprocessor for name, (_, reprocessor) in made.items()})
    alone = {name: JointReprocessor(calibration, "total", 1e-4) for name, (calibration, _) in made.items()}
    for pieces in blocks:
        found = together.transforms(pieces)
        assert list(found) == list(made)
        for name, reprocessor in alone.items():
            works = [reprocessor.work(each) for each in pieces[name]]
            for work in works:
                work.locate()
            expected = reprocessor.transforms(works)
            assert found[name].table.rows.tobytes() == expected.table.rows.tobytes()
            assert found[name].stamps_ns.tolist() == expected.stamps_ns.tolist()
            assert found[name].places.tolist() == expected.places.tolist()
            assert len(expected) == 0 or (expected.table["state"] != State.LOST).mean() > 0.9
    for name, (_, reprocessor) in made.items():
        assert (reprocessor.scans, reprocessor.lost) == (alone[name].scans, alone[name].lost)
    assert (abreast > 0) == (COMPILING and number > 2)


def test_joints_keep_no_room_for_layouts_that_are_gone() -> None:
    made = {f"joint_{n}": joint("triad_diodes") for n in range(3)}
    together = Joints({name: reprocessor for name, (_, reprocessor) in made.items()})
    for block in range(4):
        # Each piece has a layout of its own, as where readings come and go.
        pieces = {name: [piece(calibration, 20 * block, 20)] for name, (calibration, _) in made.items()}
        together.transforms(pieces)
    assert len(together._abreast) == int(COMPILING)
