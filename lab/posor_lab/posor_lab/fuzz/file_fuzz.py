"""Damaged files: every reader gives a result or one sentence, soon."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import load_chain
from posor.errors import PosorError
from posor_bringup.installed import share
from posor_drivers.simulator.scenario import load_scenario
from posor_drivers.sources.table_source import read_table

from posor_lab.fuzz.mutation import mutate
from posor_lab.thesis_data import data_path

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LONGEST_S = 5.0
"""Time that a reader may take."""


@dataclass
class FileCount:
    """Numbers of damaged files."""

    refused: int = 0  # with one sentence
    read: int = 0
    slowest_s: float = 0.0


class FileFailureError(Exception):
    """A reader raised another error than one for the user, or took too long."""


def readers() -> dict[str, tuple[Path, Callable[[Path], object]]]:
    """Return a file of each format and its reader, by name."""
    arm = share() / "arms" / "five_axis"
    return {
        "calibration": (arm / "calibrations" / "elbow.yaml", load_calibration),
        "beams": (arm / "beams.yaml", load_beams),
        "arm": (arm / "arm.yaml", load_arm_file),
        "scenario": (arm / "scenario.yaml", load_scenario),
        "urdf": (arm / "five_axis.urdf", lambda path: load_chain(path, "endpoint")),
        "table": (data_path("ymo_output.csv"), read_table),
    }


def fuzz_files(name: str, mutations: int, seed: int, folder: Path) -> FileCount:
    """Damage a file several times and read it.

    Args:
        name: Format, a key of ``readers``.
        mutations: How often.
        seed: Of the damage.
        folder: Existing folder for the damaged file.

    Raises:
        FileFailureError: The reader failed; names the format and keeps the file.

    """
    (source, read), count = readers()[name], FileCount()
    content, path = source.read_bytes(), folder / f"damaged{source.suffix}"
    chance = random.Random(f"{name} {seed}")  # noqa: S311  damage
    for _ in range(mutations):
        data = content
        for _ in range(chance.randint(1, 4)):
            data = mutate(data, chance)
        path.write_bytes(data)
        began, where = time.monotonic(), f"{path}: {name}"
        try:
            read(path)
            count.read += 1
        except PosorError as error:
            if "\n" in str(error):
                raise FileFailureError(f"{where}: more than one line: {error}") from error
            count.refused += 1
        except Exception as error:
            raise FileFailureError(f"{where}: {type(error).__name__}: {error}") from error
        took_s = time.monotonic() - began
        if took_s > LONGEST_S:
            raise FileFailureError(f"{where}: took {took_s:.1f} s; expected at most {LONGEST_S:g} s")
        count.slowest_s = max(count.slowest_s, took_s)
    return count
