# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bad data from bag to exit code: a fault is named in one sentence and writes no file, or does no harm."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.bags.recording import POSE, SCALAR, Recording, Track
from posor.calibration.calibration_file import load_calibration
from posor.numerics.array_types import FloatArray
from posor_calibration.calibrate_command import main
from posor_lab.campaign.campaign_run import step_arguments
from posor_lab.campaign.campaign_steps import CampaignStep, campaign_steps
from posor_lab.campaign.ground_truth import GroundTruth, PosorName
from posor_lab.campaign.parameter_coverage import compare_with_truth
from posor_lab.harness.calibration_bag import entries, write_bag
from posor_lab.harness.case_tables import cases
from posor_lab.harness.program import installed
from scipy.spatial.transform import Rotation

SEED = 5000
SOUND = 4.5  # standard uncertainties by which no number of a result is off; there are some dozen in each case
GAPS, CURRENTS = "gap_voltages", "diode_currents"


@cache
def plant(name: PosorName) -> GroundTruth:
    return GroundTruth.draw(name, SEED)


@cache
def recorded(step: str) -> tuple[GroundTruth, CampaignStep, Recording]:
    own = plant("triad_bumpy_ring" if step == "4_ring" else "triad_diodes")
    [found] = [one for one in campaign_steps(own.name) if one.name == step]
    return own, found, found.record(own)


def with_track(change: Callable[[Track], Track]) -> Callable[[Recording], Recording]:
    return lambda taken: replace(taken, tracks={name: change(track) for name, track in taken.tracks.items()})


def with_readings(kind: str, change: Callable[[FloatArray], None]) -> Callable[[Recording], Recording]:
    """Return what changes the readings of a kind, (n, channels), in place."""

    def changed(taken: Recording) -> Recording:
        shape = getattr(taken.scans, kind).shape
        values = getattr(taken.scans, kind).reshape(len(taken.scans), -1).copy()
        change(values)
        return replace(taken, scans=taken.scans.with_fields({kind: values.reshape(shape)}))

    return changed


def scaled(factor: float) -> Callable[[Recording], Recording]:
    """The reference in another unit: numbers and lengths, and the angles of a pose."""

    def change(track: Track) -> Track:
        values = track.values * factor
        if values.shape[1] == POSE:
            turns = factor * Rotation.from_quat(track.values[:, 3:]).as_rotvec()
            values = np.column_stack([values[:, :3], Rotation.from_rotvec(turns).as_quat()])
        return replace(track, values=values)

    return with_track(change)


def exchanged(track: Track) -> Track:
    """X and Y exchanged; of a single number, its sign."""
    if track.values.shape[1] == SCALAR:
        return replace(track, values=-track.values)
    order = [1, 0, 2, 4, 3, 5, 6][: track.values.shape[1]]
    return replace(track, values=track.values[:, order], sigmas=track.sigmas[order])


def begin(share: float) -> Callable[[Recording], Recording]:
    def cut(taken: Recording) -> Recording:
        count = int(share * len(taken.scans))
        assert taken.statuses is not None
        short = replace(taken, scans=taken.scans.part(0, count), statuses=taken.statuses[:count])
        return lost(share)(short)

    return cut


def lost(share: float) -> Callable[[Recording], Recording]:
    """The reference was recorded at the beginning only."""

    def cut(track: Track) -> Track:
        count = int(share * len(track.stamps_ns))
        return replace(track, stamps_ns=track.stamps_ns[:count], values=track.values[:count])

    return with_track(cut)


def late(seconds: float) -> Callable[[Recording], Recording]:
    return with_track(lambda track: replace(track, stamps_ns=track.stamps_ns + round(seconds * 1e9)))


def standing(track: Track) -> Track:
    return replace(track, values=np.tile(track.values[0], (len(track.values), 1)))


def stuck(kind: str, channel: int, since: float = 0.0) -> Callable[[Recording], Recording]:
    def change(values: FloatArray) -> None:
        first = int(since * len(values))
        values[first:, channel] = values[first, channel]

    return with_readings(kind, change)


def outliers(kind: str) -> Callable[[Recording], Recording]:
    """Five per cent of the readings off by as much as all readings of the channel scatter."""

    def change(values: FloatArray) -> None:
        random = np.random.default_rng(3)
        which = random.random(values.shape) < 0.05
        values += which * np.std(values, axis=0) * random.choice([-1.0, 1.0], values.shape)

    return with_readings(kind, change)


def missing(kind: str, channel: int, share: float) -> Callable[[Recording], Recording]:
    def change(values: FloatArray) -> None:
        values[np.random.default_rng(4).random(len(values)) < share, channel] = np.nan

    return with_readings(kind, change)


def dark(values: FloatArray) -> None:
    values[:] = 1e-7


def at_rest(taken: Recording) -> Recording:
    """The scans of another joint, which stands still."""
    random, fields = np.random.default_rng(5), {}
    for kind, step in ((GAPS, 3e-4), (CURRENTS, 3e-9)):
        values = getattr(taken.scans, kind)
        fields[kind] = step * np.round(values[:1] / step + random.normal(size=values.shape))
    return replace(taken, scans=taken.scans.with_fields(fields))


def jumped(track: Track) -> Track:
    """The instrument lost its count half-way: 2 mrad, or 20 um."""
    values, half = track.values.copy(), len(track.values) // 2
    if values.shape[1] == POSE:
        off = Rotation.from_rotvec([2e-3, 0.0, 0.0])
        values[half:, 3:] = (off * Rotation.from_quat(values[half:, 3:])).as_quat()
    else:
        values[half:] += 2e-5
    return replace(track, values=values)


def run(step: str, fault: Callable[[Recording], Recording], folder: Path) -> tuple[int, str, str, Path]:
    """Write the bag, calibrate from it as the command line does; return exit code, both outputs, and the result."""
    own, found, taken = recorded(step)
    bag, known, output = write_bag(folder / "bag", entries(fault(taken))), folder / "in.yaml", folder / "out.yaml"
    content = own.as_built.model_dump(mode="json", exclude_defaults=True)
    known.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        code = main(step_arguments(found, bag, known, output))
    errors = [line for line in err.getvalue().splitlines(keepends=True) if ": fitting: " not in line]  # on slow hosts
    return code, " ".join(out.getvalue().split()), "".join(errors).lstrip(), output


FAULTS: dict[str, Callable[..., Callable[[Recording], Recording]]] = {
    **{made.__name__: made for made in (begin, late, lost, missing, scaled, stuck)},
    "at_rest": lambda: at_rest,
    "dark": lambda: with_readings(CURRENTS, dark),
    "exchanged": lambda: with_track(exchanged),
    "jumped": lambda: with_track(jumped),
    "standing": lambda: with_track(standing),
}


@pytest.mark.parametrize(**cases(__file__, "bad_data.yaml"))
def test_fault_is_named_and_nothing_is_written(
    step: str, fault: str, arguments: list[Any], sentence: str, tmp_path: Path
) -> None:
    code, out, err, output = run(step, FAULTS[fault](*arguments), tmp_path)
    assert (code, out) == (1, "")
    assert re.search(sentence, err), err
    assert err.count("\n") == 1, "one sentence"
    assert not output.exists()


@pytest.mark.parametrize(
    ("step", "fault", "named"),
    [
        ("1_gaps", outliers(GAPS), r"left out \d+ of \d+ readings of gap voltage 1 that disagree with their dwell"),
        ("1_gaps", missing(GAPS, 1, 0.03), r"left out \d+ of \d+ readings of gap voltage 2"),
        (
            "1_gaps",
            lost(0.5),
            r"313 of 625 scans were taken before its first or after its last value, which is 6\.22 s",
        ),
        ("2_supply", outliers(GAPS), r"left out \d+ of \d+ readings of gap voltage 3"),
        ("4_map_1", outliers(CURRENTS), r"left out \d+ of \d+ readings of current D of diode 1"),
        ("6_rays", outliers(CURRENTS), r"left out \d+ of \d+ readings of current A of diode 2"),
        pytest.param("8_drift", lost(0.5), r"100 of 200 scans are not used", marks=pytest.mark.long),
    ],
)
def test_harmless_fault_is_reported(
    step: str, fault: Callable[[Recording], Recording], named: str, tmp_path: Path
) -> None:
    code, out, err, output = run(step, fault, tmp_path)
    assert (code, err) == (0, ""), err
    notes = json.loads(output.with_suffix(".json").read_text(encoding="utf-8"))["notes"]
    assert re.search(named, " ".join(notes)), notes
    assert f"of {len(notes)}, shortened; in full in out.html" in out
    numbers = compare_with_truth(recorded(step)[0], load_calibration(output), last_procedure=True)
    assert len(numbers) >= 3
    assert max(abs(number.normalised_error) for number in numbers) < SOUND


def calibrate_from(bag: Path, step: str, frame: str = "receiving") -> str:
    """Run the program on a bag that it refuses, the receiving plate having this name; return the error."""
    own, found, _ = recorded(step)
    frames = own.as_built.frames.model_copy(update={"parent": frame})
    content = own.as_built.model_copy(update={"frames": frames}).model_dump(mode="json", exclude_defaults=True)
    known, output = bag.with_name("in.yaml"), bag.with_name("out.yaml")
    known.write_text(yaml.safe_dump(content), encoding="utf-8")
    command = [*installed("posor_calibration", "calibrate"), *step_arguments(found, bag, known, output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert not output.exists()
    return done.stderr


@pytest.mark.long
def test_scans_of_another_joint_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", entries(recorded("1_gaps")[2]))
    said = calibrate_from(bag, "1_gaps", "elbow_receiving")
    assert ": the scans are of the receiving plate 'receiving'; expected 'elbow_receiving', " in said


@pytest.mark.long
def test_a_file_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", entries(recorded("8_drift")[2]))
    [file] = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    said = calibrate_from(bag, "8_drift")
    assert re.search(r"mcap, byte \d+: the file was not closed or is cut short; .*'recover'", said), said
