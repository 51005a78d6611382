# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""commissioning: whether 'posor commission' finds exchanged plugs, signs and wrong files, and passes sound arms.

Writes ``commissioning.json``. The exit code is 0 only if every fault is found by a check of the stated kind, and every
arm without a fault passes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from posor.chain.kinematic_chain import load_chain
from posor_calibration.commissioning.commissioning_report import check_commissioning

from posor_lab.commissioning.simulated_commissioning import SimulatedCommissioning, WiringFault
from posor_lab.reports.findings import Finding, Findings
from posor_lab.reports.trial_program import Option, TrialProgram

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_calibration.commissioning.commissioning_report import CommissioningReport

    from posor_lab.reports.trial_program import Trial

DATE = "none"
EXCHANGED = ("exchanged",)  # kind of check that finds a plug, if the table does not state others
GROUPS = {
    "plugs": "exchanged plugs",
    "signs": "wrong signs",
    "files": "wrong files",
    "unseen": "faults beyond any check",
}


@dataclass(frozen=True)
class FaultRow:
    """A fault of the table."""

    arm: str
    group: str  # a key of ``GROUPS``
    fault: WiringFault


@dataclass(frozen=True)
class FaultResult:
    """What the checks said about a fault."""

    row: FaultRow
    kinds: Mapping[str, str] = field(default_factory=dict)  # first failed check of each kind, and what it found

    @property
    def holds(self) -> bool:
        """Whether a check of the stated kind failed; where no check can find the fault, whether all passed."""
        wanted = self.row.fault.found_by
        return bool(set(wanted) & set(self.kinds)) if wanted else not self.kinds


def load_table() -> tuple[FaultRow, ...]:
    """Return the rows of ``wiring_faults.yaml``."""
    content = yaml.safe_load(Path(__file__).with_name("wiring_faults.yaml").read_text(encoding="utf-8"))
    rows = []
    for arm, groups in content.items():
        for group, entries in groups.items():
            for entry in entries:
                stated = {"name": _title(entry), "found_by": EXCHANGED, **entry}
                names = {each.name for each in fields(WiringFault)}
                assert set(stated) <= names, f"unknown keys {set(stated) - names}"  # noqa: S101  our own table
                rows.append(FaultRow(arm, group, WiringFault(**stated)))
    return tuple(rows)


def _title(entry: Mapping[str, Any]) -> str:
    return "; ".join(f"{key} {value}" for key, value in entry.items() if key != "found_by")


TABLE = load_table()


def judge_fault(simulated: SimulatedCommissioning, row: FaultRow, folder: Path) -> FaultResult:
    """Return the result of a fault; ``folder`` does not exist yet."""
    report = report_with(simulated, row.fault, folder)
    kinds: dict[str, str] = {}
    for check in report.failed:
        kinds.setdefault(check.kind, f"{check.check}: {check.found}")
    return FaultResult(row, kinds)


def report_with(simulated: SimulatedCommissioning, fault: WiringFault, folder: Path) -> CommissioningReport:
    """Return the report on an arm with a fault; ``folder`` does not exist yet."""
    arm, calibrations = simulated.files_with(fault, folder)
    chain = load_chain(arm.urdf, arm.endpoint_frame, arm.beams)
    settings = replace(simulated.settings, serial=fault.serial or simulated.settings.serial)
    recording = simulated.recording_with(fault)
    return check_commissioning(arm, chain, calibrations, recording, settings, date=DATE)


def run_commissioning(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Run all rows and the arms without a fault."""
    options, findings, results = trial.options, [], list[FaultResult]()
    for arm in sorted({row.arm for row in TABLE}):
        rows = [row for row in TABLE if row.arm == arm]
        with trial.progress.stage(arm, options.arms + len(rows)) as on_done:
            wrong = []
            for seed in range(options.seed, options.seed + options.arms):
                simulated = SimulatedCommissioning(arm, trial.folder / f"{arm}_{seed}", seed)
                report = report_with(simulated, WiringFault("none", ()), trial.folder / f"{arm}_{seed}_sound")
                wrong += [f"seed {seed}, {check.check}: {check.found}" for check in report.failed]
                on_done()
            findings.append(
                Finding.none_of(
                    f"{arm}: failed checks of {options.arms} arms without a fault", len(wrong), remark="; ".join(wrong)
                )
            )
            for number, row in enumerate(rows):
                results.append(judge_fault(simulated, row, trial.folder / f"{arm}_fault_{number}"))
                on_done()
        findings += [_finding(arm, group, [each for each in results if each.row.arm == arm]) for group in GROUPS]
    return Findings(tuple(findings)), {"faults": [_as_json(each) for each in results]}


def _finding(arm: str, group: str, results: list[FaultResult]) -> Finding:
    own = [each for each in results if each.row.group == group]
    missed = [each.row.fault.name for each in own if not each.holds]
    text = "reported as such" if group == "unseen" else "found"
    figure = f"{len(own) - len(missed)} of {len(own)} {text}"
    return Finding.judged(
        f"{arm}: {GROUPS[group]}", figure, f"{len(own)}", holds=not missed, if_fails=f"not so: {'; '.join(missed)}"
    )


def _as_json(result: FaultResult) -> dict[str, Any]:
    row = result.row
    return {
        "arm": row.arm,
        "group": row.group,
        "fault": row.fault.name,
        "holds": result.holds,
        "found": dict(result.kinds),
    }


PROGRAM = TrialProgram(
    "commissioning",
    "Exchange plugs, signs and files of simulated arms; count what the commissioning check finds.",
    (Option("--arms", 5, "arms without a fault", 1, 1000), Option("--seed", 1, "seed of the first arm", 0)),
    run_commissioning,
    "commissioning check",
    "build/commissioning.json",
)
main = PROGRAM.main
