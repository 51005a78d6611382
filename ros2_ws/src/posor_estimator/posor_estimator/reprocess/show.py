"""Tells on the terminal what came of a bag."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from rich.console import Console

    from posor_estimator.reprocess.task import Summary


def show(summary: Summary, console: Console) -> None:
    """Print what came of a bag."""
    chain = summary.endpoint is not None
    table = Table(title=escape(str(summary.bag)), title_justify="left")
    table.add_column("joint", no_wrap=True)
    for column in ("scans", "lost", *(("missing", "no endpoint") if chain else ())):
        table.add_column(column, justify="right")
    table.add_column("faults of the lost")
    for name, joint in summary.joints.items():
        of_chain = (f"{joint.missing:,}", f"{joint.refused:,}") if chain else ()
        faults = ", ".join(f"{fault.lower()} {count:,}" for fault, count in joint.faults.items()) or "none"
        table.add_row(name, f"{joint.scans:,}", f"{joint.lost:,}", *of_chain, faults)
    console.print(table)
    if summary.endpoint is not None:
        end = summary.endpoint
        console.print(
            f"endpoint: {end.poses:,} poses, {end.degraded:,} of them degraded; no pose at {end.refused:,} complete "
            f"stamps, and {end.incomplete:,} incomplete ones"
        )
    if summary.left_out:
        console.print(f"left out, of no joint named: {', '.join(summary.left_out)}", markup=False)
    speed = summary.scans / summary.cpu_s if summary.cpu_s else 0.0
    console.print(
        f"{summary.scans:,} scans in {summary.wall_s:.1f} s, {summary.cpu_s:.1f} s of processor time: "
        f"{speed:,.0f} scans/s per core"
    )
    where = "no --output: nothing is written" if summary.output is None else f"written to {summary.output}"
    console.print(where, markup=False, soft_wrap=True)
