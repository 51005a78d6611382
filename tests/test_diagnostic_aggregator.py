# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The configuration of diagnostic_aggregator: each entry that the nodes publish belongs to one group."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import get_package_share_path
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program

from tests.composed_rig import COMPOSE, RIG, write_composition

FILE = get_package_share_path("posor_bringup") / "config" / "diagnostic_aggregator.yaml"
ENTRIES = {"endpoint", "estimate", "input", "lifecycle", "listeners", "process", "source", "timing"}
"""Some of the entries, by the part of their names after the node."""


@pytest.mark.usefixtures("ros_domain")
def test_every_entry_of_the_nodes_belongs_to_one_group_and_names_its_hardware(tmp_path: Path) -> None:
    with Program([*COMPOSE, str(write_composition(tmp_path, RIG))]) as program, Graph() as graph:
        graph.watch_diagnostics()

        def entries() -> set[str]:
            return {status.name.rpartition(": ")[2] for status in graph.diagnostics}

        graph.wait_until(lambda: entries() >= ENTRIES, "entries")
        assert program.end() == 0
    parameters: dict[str, Any] = yaml.safe_load(FILE.read_text(encoding="utf-8"))["analyzers"]["ros__parameters"]
    groups = [group["contains"] for group in parameters.values() if isinstance(group, dict)]
    for status in graph.diagnostics:
        assert sum(any(text in status.name for text in group) for group in groups) == 1, status.name
        assert status.hardware_id
