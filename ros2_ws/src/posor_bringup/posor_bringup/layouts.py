"""Which nodes of an arm share a process: a list of programs, each of one node, becomes one of fewer programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import yaml

from posor_bringup.supervisor import Program

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Layout = Literal["separate", "drivers_apart", "composed"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
"""A process for each node; one for all drivers and one for all else; one for everything."""


def laid_out(programs: Sequence[Program], layout: Layout, folder: Path) -> list[Program]:
    """Return programs that run the same nodes in fewer processes.

    Args:
        programs: Programs of one node each, those that listen first.
        layout: Which nodes share a process.
        folder: Existing folder for the composition files.

    """
    if layout == "separate":
        return list(programs)
    groups = {"nodes": programs}
    if layout == "drivers_apart":
        groups = {
            "nodes": [program for program in programs if not program.ends],
            "drivers": [program for program in programs if program.ends],
        }
    return [_composed(name, group, folder / f"{name}.yaml") for name, group in groups.items() if group]


def _composed(name: str, programs: Sequence[Program], path: Path) -> Program:
    nodes = [
        {"node": program.executable, "namespace": program.namespace or "/", "parameters": dict(program.parameters)}
        for program in programs
    ]
    content = {"format": "posor_composition", "version": 1, "nodes": nodes}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    ends = all(program.ends for program in programs)
    return Program(name, "posor_estimator", "compose", (str(path),), ends=ends)
