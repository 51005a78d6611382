# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""make arm: what the command refuses before it starts anything."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from posor_lab.arm_study.arm_command import main
from posor_lab.harness.rig_files import share


def test_coverage_alone_of_an_arm_without_beams_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = shutil.copytree(share() / "arms" / "test_rig", tmp_path / "rig") / "arm.yaml"
    lines = arm.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith("beams:")]
    assert len(kept) == len(lines) - 1
    arm.write_text("".join(kept), encoding="utf-8")
    output = tmp_path / "report"
    assert main(["arm", "--arm", str(arm), "--coverage-only", "--output", str(output)]) == 2
    assert capsys.readouterr().err.startswith(f"{arm}: has no beams file, without which no arms are drawn; expected")
    assert not output.exists()
