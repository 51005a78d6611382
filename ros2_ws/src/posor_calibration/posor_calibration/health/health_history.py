# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The history of an arm's health tests: a Parquet file with a row for each number, rewritten with each test."""

from __future__ import annotations

import fcntl
import json
import os
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.chain.identity import ArmIdentity
from posor.errors import DataFileError, OutputError
from posor.numerics.vector import wrapped_angles
from posor.optional_library import optional_library
from posor.output_files import write_files, writing

from posor_calibration.health.health_test import HealthTest, Number, date_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

FORMAT, VERSION = "posor_health", 1
UNIT = 1e-6  # by which the norm of a quaternion may differ from 1
SAME_POSTURE = 0.02  # largest difference of a joint's angle from that of the first test [rad]
SAME_SEAT = 5e-4  # largest difference of a place or residual from that of the first test [m]
FIRST_YEAR = np.datetime64("2000-01-01", "ns").astype(int)  # an earlier stamp is that of a clock that was not set
COLUMNS = ("stamp_ns", *Number._fields)


@dataclass(frozen=True)
class HealthHistory:
    """All tests of an arm, the oldest first."""

    arm: str
    identity: ArmIdentity  # of the files of all tests
    T_artefact_base: pin.SE3  # of the first test
    balls: Mapping[str, list[float]]  # place of each ball in the endpoint [m], x, y, z
    tests: tuple[HealthTest, ...] = ()

    def with_test(self, test: HealthTest, where: str) -> HealthHistory:
        """Return the history with one more test.

        Raises DataFileError: the test is older than the last one, has other dwells, readings or postures, or numbers
        that no change of an arm explains.
        """
        if not (np.isfinite(test.values).all() and (test.sigmas > 0.0).all()):
            what = f"the test of {date_text(test.stamp_ns)} has a number that is not finite, or no noise"
            raise DataFileError(what, where=where)
        if test.stamp_ns < FIRST_YEAR:
            what, expected = f"the test is of {date_text(test.stamp_ns)}", "a clock that was set when it was recorded"
            raise DataFileError(what, where=where, expected=expected)
        if self.tests:
            last, first = self.tests[-1], self.tests[0]
            if test.stamp_ns <= last.stamp_ns:
                expected = f"a test after the last one, {date_text(last.stamp_ns)}"
                raise DataFileError(f"the test is of {date_text(test.stamp_ns)}", where=where, expected=expected)
            if test.keys != first.keys:
                other = next((key for key in test.keys if key not in set(first.keys)), None)
                missing = next((key for key in first.keys if key not in set(test.keys)), None)
                pose, part, quantity = other or missing or test.keys[0]
                what = f"{quantity} of {part} at dwell {pose} is {'new' if other else 'missing'}"
                raise DataFileError(what, where=where, expected="dwells, balls and readings of the first test")
            shift = np.abs(wrapped_angles(test.angles - first.angles))
            if shift.max() > SAME_POSTURE:
                dwell, joint = divmod(int(shift.argmax()), shift.shape[1])
                name = list(self.identity.calibrations)[joint]
                what = f"joint '{name}' is at {test.angles[dwell, joint]:.3f} rad at dwell {dwell + 1}"
                expected = f"{first.angles[dwell, joint]:.3f} within {SAME_POSTURE:g}, the posture of the first test"
                raise DataFileError(what, where=where, expected=expected)
            moved = np.abs(test.values - first.values)
            if moved.max() > SAME_SEAT:
                pose, part, quantity = test.keys[int(moved.argmax())]
                what = f"{quantity} of {part} at dwell {pose} is {1e3 * moved.max():.3g} mm from the first test"
                expected = f"at most {1e3 * SAME_SEAT:g} mm: did the ball rest in its seat?"
                raise DataFileError(what, where=where, expected=expected)
        return replace(self, tests=(*self.tests, test))


def read_history(path: Path) -> HealthHistory:
    """Return the history in a file. Raises DataFileError: it is not a whole history; ParameterError: no pyarrow."""
    pyarrow, parquet = (optional_library(name, "tables", path) for name in ("pyarrow", "pyarrow.parquet"))
    tests: dict[int, list[Number]] = {}
    try:
        table = parquet.read_table(pyarrow.BufferReader(path.read_bytes()))
        about: dict[str, Any] = json.loads(table.schema.metadata[FORMAT.encode()])
        if about["version"] != VERSION:
            what = f"has version {about['version']}"
            raise DataFileError(what, where=str(path), expected=f"a history of version {VERSION}, made by posor health")
        for stamp_ns, *number in zip(*(table.column(name).to_pylist() for name in COLUMNS), strict=True):
            tests.setdefault(int(stamp_ns), []).append(Number(*number))
        pose, balls = np.array(about["T_artefact_base"], dtype=float), dict(about["balls"])
        places = np.array(list(balls.values()), dtype=float)
        sound = pose.shape == (7,) and places.shape == (len(balls), 3) and np.isfinite(places).all()
        if not (tests and sound and abs(np.linalg.norm(pose[3:]) - 1.0) < UNIT):
            raise ValueError  # noqa: TRY301  as if it were missing
        history = HealthHistory(about["arm"], ArmIdentity(**about["identity"]), pin.XYZQUATToSE3(pose), balls)
        for stamp_ns, numbers in sorted(tests.items()):
            history = history.with_test(HealthTest(stamp_ns, tuple(numbers)), str(path))
    except (OSError, ValueError, KeyError, TypeError, IndexError, pyarrow.ArrowException) as error:
        raise DataFileError("is not a whole history of health tests", where=str(path)) from error
    return history


def write_history(path: Path, history: HealthHistory, replaces: bytes | None = None) -> None:
    """Replace a file by a history, atomically.

    ``replaces``: content of the file when the history was read, empty: there was no file; None: not compared. Raises
    OutputError: it cannot be written, or has another content; ParameterError: no pyarrow.
    """
    pyarrow, parquet = (optional_library(name, "tables", path) for name in ("pyarrow", "pyarrow.parquet"))
    about = {
        "version": VERSION,
        "arm": history.arm,
        "identity": asdict(history.identity),
        "T_artefact_base": pin.SE3ToXYZQUAT(history.T_artefact_base).tolist(),
        "balls": dict(history.balls),
    }
    rows = [(test.stamp_ns, *number) for test in history.tests for number in test.numbers]
    columns = dict(zip(COLUMNS, map(list, zip(*rows, strict=True)), strict=True))
    table = pyarrow.table(columns).replace_schema_metadata({FORMAT: json.dumps(about)})
    file = BytesIO()
    parquet.write_table(table, file, compression="zstd")
    with writing(path), _locked(path.resolve().parent):
        if replaces is not None and content_of(path) != replaces:
            what = "has been changed by another program since it was read"
            raise OutputError(what, where=str(path), expected="one program at a time: run this test again")
        write_files({path: file.getvalue()})


def content_of(path: Path) -> bytes:
    """Return the content of a file; empty: there is no file. Raises DataFileError: it cannot be read."""
    try:
        return path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise DataFileError(f"cannot be read: {error.strerror}", where=str(path)) from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let no other program replace a history of a folder meanwhile."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
