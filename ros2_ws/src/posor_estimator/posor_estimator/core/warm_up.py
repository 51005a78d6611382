"""Compile every kernel once, so that no node has to: ``python -m posor_estimator.core.warm_up``.

Numba keeps the compiled code on disk beside the sources. Without numba there is nothing to do.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, get_args

import numpy as np

from posor_estimator.core.abreast import LEAST, Abreast, design_of
from posor_estimator.core.chain import Chain
from posor_estimator.core.chain_records import ChainRecords, JointColumns, read_records
from posor_estimator.core.columns import Columns
from posor_estimator.core.compiled import COMPILING
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels.moments import FIGURES, figures_of
from posor_estimator.core.kernels.stamps import NS
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import Records

if TYPE_CHECKING:
    from posor_estimator.core.chain_lane import ChainLane
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import ByteArray

ARM = """<robot name="arm"><link name="base"/><link name="plate"/><link name="endpoint"/>
<joint name="joint" type="floating"><parent link="base"/><child link="plate"/></joint>
<joint name="beam" type="fixed"><parent link="plate"/><child link="endpoint"/></joint></robot>"""


def warm_up() -> None:
    """Run each design over two scans, and an arm over one: that compiles every kernel with the types that nodes use."""
    lane = Chain(ARM, "endpoint").lane()
    if not lane.run():
        message = "an arm of one joint has no endpoint"
        raise AssertionError(message)
    lane.find_relative_to(lane.pose)
    for name in get_args(DesignName):
        posor = Posor(design(name))
        rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
        scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64))
        if State.LOST in [posor.locate(scans[n]).state for n in range(len(scans))]:
            message = f"design {name} does not locate its own scans"
            raise AssertionError(message)
    warm_up_records(lane)
    warm_up_abreast()
    figures_of(np.array([1, 2]), 3, np.empty(FIGURES))


def rows_of(scans: Scans) -> tuple[ByteArray, Columns]:
    """Return scans as rows of bytes (n, 192), and where these and rows of poses, see ``OF_A_POSE``, have what."""
    count, (gaps, rings) = len(scans), (scans.gap_voltages.shape[1], scans.ring_voltages.shape[1])
    currents, lit = scans.diode_currents.reshape(count, -1), scans.lit_sources.shape[1]
    raw = np.zeros((count, 24))
    raw.view(np.int32)[:, 0], raw.view(np.int32)[:, 1] = scans.stamps_ns // NS, scans.stamps_ns % NS
    raw[:, 3 : 3 + gaps], raw[:, 6 : 6 + rings] = scans.gap_voltages, scans.ring_voltages
    raw[:, 10 : 10 + currents.shape[1]] = currents
    raw[:, 18], raw[:, 19] = scans.supply_voltages, scans.temperatures
    raw.view(np.uint8)[:, 160 : 160 + lit] = scans.lit_sources
    columns = Columns(
        seconds=0,
        number=8,
        status=16,
        gaps=(24, gaps),
        rings=(48, rings),
        currents=(80, currents.shape[1]),
        supply=144,
        temperature=152,
        lit=(160, lit),
        home=1,
        to_stamp=0,
        to_number=8,
        to_status=16,
        to_redundancy=20,
        to_faults=24,
        to_pose=32,
        to_native=88,
        to_residual=136,
        to_covariance=144,
        kind=2,
    )
    return raw.view(np.uint8), columns


OF_A_POSE = JointColumns(pose=32, theta=128, covariance=144, state=21, size=448)
"""Where the rows of poses have what, for the chain."""


def warm_up_records(lane: ChainLane) -> None:
    """Run a design over two scans that are rows, one by one and both at once, and an arm over the first one's pose."""
    posor = Posor(design("triad_diodes"))
    rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (2, 1))
    raw, columns = rows_of(scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64)))
    out = np.zeros((2, OF_A_POSE.size), dtype=np.uint8)
    records = Records(posor, columns, out[0].copy())
    records.locate(raw, out)
    row, pose = raw[:1].copy(), out[:1].copy()
    one_by_one = records.lane(row, pose, np.zeros((2, row.shape[1]), dtype=np.uint8))
    posor.reset()
    for scan in raw:
        row[0] = scan
        one_by_one.run()
    chain = ChainRecords(lane, [OF_A_POSE])
    chain.rows[0] = out[0]
    read_records(out, OF_A_POSE, 0, np.empty((2, 1, 7)), np.empty((2, 1, 6, 6)), np.empty((2, 1)))
    if pose.tobytes() != out[1].tobytes() or chain.run(0) != State.OK:
        message = "scans in rows are not located, one by one as at once, or give no endpoint"
        raise AssertionError(message)


def warm_up_abreast() -> None:
    """Run three POSORs of a design over some scans at once, where that is possible."""
    scans, of_posors = 4, [Posor(design("triad_diodes")) for _ in range(LEAST)]
    rotations, translations = np.tile(np.eye(3), (scans, 1, 1)), np.tile([0.0, 0.0, 0.7e-3], (scans, 1))
    raw, columns = rows_of(scans_at(of_posors[0].stack, rotations, translations, np.arange(1, scans + 1)))
    out = np.zeros((LEAST + 1, scans, OF_A_POSE.size), dtype=np.uint8)
    records = [Records(posor, columns, out[0, 0].copy()) for posor in of_posors]
    if design_of(records[0]) is None:
        return
    Abreast(records).locate([raw] * LEAST, list(out[:LEAST]))
    of_posors[0].reset()
    records[0].locate(raw, out[LEAST])
    if any(poses.tobytes() != out[LEAST].tobytes() for poses in out):
        message = "scans are not located abreast as alone"
        raise AssertionError(message)


def main() -> int:
    """Compile and say so."""
    warm_up()
    print("kernels compiled" if COMPILING else "numba is not installed: kernels run uncompiled")
    return 0


if __name__ == "__main__":
    sys.exit(main())
