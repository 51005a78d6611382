# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What calibration files say, and what identifies a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.calibration.calibration_file import TiltAngle, calibration_from, load_calibration, parse_calibration
from posor.calibration.edit import edit_document
from posor.calibration.yaml_document import StrictDumper

from .calibration_content import PROBE, at, write

RIG = ("printed", "section84")


@pytest.mark.parametrize("name", RIG)
def test_the_files_of_the_1985_rig_are_calibrations(name: str, rig_calibrations: dict[str, Path]) -> None:
    calibration = load_calibration(rig_calibrations[name])
    assert calibration.name == f"slocum1985_{name}"
    assert (calibration.frames.parent, calibration.frames.child) == ("posor_receiving", "posor_target")
    assert calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN
    assert [sensor.type for sensor in calibration.sensors] == ["gap_probes", "diodes"]  # type: ignore[attr-defined]
    assert set(calibration.sessions) == {"ymo", "yzmo", "zmo"}
    assert "MIT, 1985" in calibration.provenance.source
    assert len(calibration.provenance.notes) > 1


def test_quantities_keep_value_unit_and_uncertainty(rig_calibrations: dict[str, Path], content: Any) -> None:
    calibration = load_calibration(rig_calibrations["printed"])
    tip = calibration.sensors[0].probes[0].tip  # type: ignore[attr-defined]
    said = at(content, f"{PROBE}.tip")
    assert (tip.array.tolist(), tip.sigmas.tolist(), tip.unit) == (said["value"], said["sigma"], said["unit"])
    axis = calibration.sensors[0].probes[0].axis  # type: ignore[attr-defined]
    assert axis.sigmas.tolist() == [0.0, 0.0, 0.0]


def test_arrays_of_a_calibration_are_read_only(rig_calibrations: dict[str, Path]) -> None:
    tip = load_calibration(rig_calibrations["printed"]).sensors[0].probes[0].tip  # type: ignore[attr-defined]
    for array in (tip.array, tip.sigmas):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_single_sigma_applies_to_each_component(content: Any, file: Path) -> None:
    at(content, f"{PROBE}.tip")["sigma"] = 2e-6
    write(file, content)
    tip = load_calibration(file).sensors[0].probes[0].tip  # type: ignore[attr-defined]
    assert tip.sigmas.tolist() == [2e-6, 2e-6, 2e-6]


# What identifies a calibration.


def test_the_content_hash_ignores_layout_comments_and_order(
    rig_calibrations: dict[str, Path], content: dict[str, Any], file: Path
) -> None:
    original = load_calibration(rig_calibrations["printed"]).content_hash
    assert len(original) == 64
    assert set(original) <= set("0123456789abcdef")
    text = yaml.safe_dump(content, sort_keys=True, default_flow_style=True, width=40)
    file.write_text(f"# another layout\n{text}\n# the end\n", encoding="utf-8")
    assert load_calibration(file).content_hash == original
    file.write_text(rig_calibrations["printed"].read_text(encoding="utf-8").replace("\n", "\r\n"), encoding="utf-8")
    assert load_calibration(file).content_hash == original
    at(content, f"{PROBE}.axis")["value"] = [0, 0, 1]  # whole numbers are numbers
    write(file, content)
    assert load_calibration(file).content_hash == original


def test_the_files_of_the_1985_rig_have_different_hashes(rig_calibrations: dict[str, Path]) -> None:
    assert len({load_calibration(rig_calibrations[name]).content_hash for name in RIG}) == len(RIG)


def numbers(content: Any) -> list[tuple[Any, Any]]:
    """Return the place of every number in the content: what holds the number, and its key there."""
    entries = list(content.items() if isinstance(content, dict) else enumerate(content))
    own = [(content, key) for key, value in entries if isinstance(value, float)]
    return own + [place for _, value in entries if isinstance(value, dict | list) for place in numbers(value)]


def test_the_content_hash_depends_on_every_number(content: Any) -> None:
    seen = {calibration_from(content).content_hash}
    every = numbers(content)
    assert len(every) > 150
    for holder, key in every[::4]:
        value = holder[key]
        # One part in 1e9, which unit vectors and limits forgive.
        holder[key] = value * (1.0 + 1e-9) if value else 1e-12
        digest = calibration_from(content).content_hash
        holder[key] = value
        assert digest not in seen, (holder, key)
        seen.add(digest)


@pytest.mark.parametrize("key", ["name", "provenance.source", "provenance.notes[0]", "frames.child", f"{PROBE}.name"])
def test_the_content_hash_depends_on_every_text(key: str, content: Any) -> None:
    before, text = calibration_from(content).content_hash, at(content, key)
    changed = edit_document(yaml.dump(content, Dumper=StrictDumper), "rig", {key: f"{text} x"})
    assert parse_calibration(changed, "rig").content_hash != before
