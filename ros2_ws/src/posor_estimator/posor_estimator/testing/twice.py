"""Some POSORs with their scans, located both abreast and alone: what comes out must be the same bytes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.abreast import AT_ONCE, Abreast
from posor_estimator.core.designs import sized_design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels.tables import MEMORY
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import Records
from posor_estimator.core.warm_up import OF_A_POSE, rows_of

if TYPE_CHECKING:
    import pytest

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.columns import Columns
    from posor_estimator.core.types import ByteArray, FloatArray

TICK_NS = 1_000_000
COUNT = 2 * AT_ONCE + 90
FRAMES = ("plate", "target")
GAPS, CURRENTS, LIT = 3, 10, 160
"""Where the rows of ``rows_of`` have them: gaps and currents in floats, sources lit in bytes."""


@dataclass
class Joints:
    """Some POSORs with their scans, to be located abreast and alone.

    Attributes:
        calibrations: Of each POSOR.
        raw: Rows of readings of each, (n, w).
        columns: Of each, where the rows have what.
        limits: Numbers of the first POSOR to be set: table, row, column, number.

    """

    calibrations: list[Calibration]
    raw: list[ByteArray] = field(default_factory=list)
    columns: list[Columns] = field(default_factory=list)
    limits: list[tuple[int, int, int, float]] = field(default_factory=list)

    def records(self) -> list[Records]:
        """Return each POSOR's way, anew."""
        template = np.zeros(OF_A_POSE.size, dtype=np.uint8)
        made = [
            Records(Posor(calibration), columns, template)
            for calibration, columns in zip(self.calibrations, self.columns, strict=True)
        ]
        for which, row, column, number in self.limits:
            made[0].tables.of_floats(which)[row, column] = number
        return made

    def located(self, monkeypatch: pytest.MonkeyPatch, counts: tuple[int, ...] = (COUNT,)) -> tuple[FloatArray, int]:
        """Locate all scans abreast, so many at a time, and alone; both must come out alike.

        Returns:
            States by POSOR and scan, (k, n), and how many scans of each were located one by one.

        """
        alone, abreast = self.records(), self.records()
        rooms = np.zeros((2, len(alone), len(self.raw[0]), OF_A_POSE.size), dtype=np.uint8)
        for records, raw, out in zip(alone, self.raw, rooms[0], strict=True):
            records.locate(raw, out)
        one_by_one = 0
        locate = Records.locate

        def counted(records: Records, raw: ByteArray, out: ByteArray) -> None:
            nonlocal one_by_one
            one_by_one += len(raw)
            locate(records, raw, out)

        together, begin = Abreast(abreast), 0
        with monkeypatch.context() as patched:
            patched.setattr(Records, "locate", counted)
            while begin < len(self.raw[0]):
                for count in counts:
                    end = begin + count
                    together.locate([raw[begin:end] for raw in self.raw], [out[begin:end] for out in rooms[1]])
                    begin = end
        np.testing.assert_array_equal(rooms[1], rooms[0])
        for one_alone, one_abreast in zip(alone, abreast, strict=True):
            found, expected = (each.tables.of_floats(MEMORY).view(np.uint64) for each in (one_abreast, one_alone))
            np.testing.assert_array_equal(found, expected)
        return rooms[0][:, :, OF_A_POSE.state], one_by_one // len(alone)


def joints(calibrations: list[Calibration], count: int = COUNT, spin: float = 0.4) -> Joints:
    """Return POSORs whose targets turn, each at its own speed [rad/s], with noise in their readings."""
    made = Joints(calibrations)
    times = np.arange(1, count + 1) * TICK_NS * 1e-9
    for number, calibration in enumerate(calibrations):
        thetas = 0.005 * number + 0.05 * np.sin(spin / 0.05 * (0.5 + 0.2 * number) * times)
        rotations = np.array([rotation_from_native(1e-4, -2e-4, theta) for theta in thetas])
        across = 1e-5 * np.sin((3.0 + number) * times)
        translations = np.stack([across, 2e-5 - across, 0.7e-3 + across], axis=1)
        stamps = np.arange(1, count + 1, dtype=np.int64) * TICK_NS + 10**9
        stack = Posor(calibration).stack
        scans = scans_at(stack, rotations, translations, stamps, noise=np.random.default_rng(number))
        raw, columns = rows_of(scans)
        made.raw.append(raw)
        made.columns.append(columns)
    return made


def sized(diameters: tuple[float, ...] = (8.0, 6.0, 5.0, 4.0)) -> list[Calibration]:
    """Return POSORs of some outside diameters [in], with as many light sources as each needs."""
    return [
        sized_design("triad_light_ring", diameter * 0.0254, frames=FRAMES, title=f"{diameter} in")
        for diameter in diameters
    ]
