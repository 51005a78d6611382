"""What a run of a simulated arm found, and what must hold: endpoint, controller, coverage, sag, budget."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from posor_bringup.arm_record import REGION, rms
from posor_bringup.drawing import MICRON
from posor_bringup.findings import Finding, Findings, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor_estimator.core.types import FloatArray

    from posor_bringup.arm_accounts import Accounts
    from posor_bringup.arm_coverage import Coverage
    from posor_bringup.arm_record import ArmRecord

COVERAGE_WITHIN = 0.02
"""How far from 95 % the coverage may be."""
SAG_WITHIN = 0.02
"""How far the displacement that an uncorrected sag leaves may be from the predicted one, relative."""
BUDGET_WITHIN = 0.02
SURE = 3.0
"""Where few arms are drawn, the limit of a figure is this many of its standard uncertainties, if that is more."""


@dataclass(frozen=True)
class ArmOutcome:
    """What a run gave; None where it was not asked for.

    Attributes:
        before: One cycle without a controller.
        after: One cycle with it.
        accounts: What became of every tick of both.
        coverage: What many arms say.
        budget: The endpoint's error budget, see ``arm_budget``.

    """

    before: ArmRecord | None = None
    after: ArmRecord | None = None
    accounts: Accounts | None = None
    coverage: Coverage | None = None
    budget: Mapping[str, Any] | None = None

    def with_computed(self, coverage: Coverage | None, budget: Mapping[str, Any]) -> ArmOutcome:
        """Return the outcome with what needs no node."""
        return replace(self, coverage=coverage, budget=budget)


def findings(outcome: ArmOutcome) -> Findings:
    """Return every figure of a run and whether it holds."""
    found: list[Finding] = []
    if outcome.before is not None and outcome.accounts is not None:
        found += _errors(outcome.before, outcome.accounts)
        if outcome.after is not None:
            found += _control(outcome.before, outcome.after)
    if outcome.coverage is not None:
        found += _coverage(outcome.coverage)
    if outcome.budget is not None:
        found += _budget(outcome.budget)
    return Findings(tuple(found))


def _errors(record: ArmRecord, accounts: Accounts) -> Iterator[Finding]:
    yield Finding(
        "ticks",
        f"{accounts.ticks}",
        "",
        "none unaccounted for",
        "",
        Verdict.of(holds=accounts.unaccounted == 0 and accounts.ticks > 0),
        accounts.sentence,
    )
    posor, encoders = rms(record.posor_errors[:, :3]), rms(record.encoder_errors[:, :3])
    published = rms(np.sqrt(np.trace(record.covariances[:, :3, :3], axis1=1, axis2=2)))
    promised = published < encoders
    yield Finding(
        "endpoint minus truth, POSORs",
        f"{posor / MICRON:.2f} um rms, {_largest(record.posor_errors[:, :3]):.2f} um at most",
        f"{published / MICRON:.2f} um rms, as published",
        f"less than {encoders / MICRON:.0f} um, the encoders alone" if promised else "",
        "",
        Verdict.of(holds=posor < encoders) if promised else Verdict.SHOWN,
        f"over {np.count_nonzero(record.has_pose)} poses; orientation {rms(record.posor_errors[:, 3:]) / MICRON:.2f} "
        "urad rms"
        + ("" if promised else "; by its published uncertainty this arm does not promise more than its encoders"),
    )
    yield Finding(
        "endpoint minus truth, encoders alone",
        f"{encoders / MICRON:.1f} um rms, {_largest(record.encoder_errors[:, :3]):.0f} um at most",
        "",
        "",
        "",
        Verdict.SHOWN,
        f"nominal kinematics; orientation {rms(record.encoder_errors[:, 3:]) / MICRON:.0f} urad rms",
    )
    yield Finding(
        "this arm's poses inside their 95 % region",
        f"{100.0 * record.inside:.1f} %",
        "",
        "",
        "",
        Verdict.SHOWN,
        f"one arm, one draw of its calibration: not 95 % of its own poses, but of those of many arms; mean NEES "
        f"{np.nanmean(record.normalised):.2f}",
    )


def _control(before: ArmRecord, after: ArmRecord) -> Iterator[Finding]:
    was, now = rms(before.off_target), rms(after.off_target)
    yield Finding(
        "true endpoint minus target, with the controller",
        f"{now / MICRON:.2f} um rms, {np.nanmax(after.off_target) / MICRON:.1f} um at most",
        "",
        f"less than {was / MICRON:.0f} um, without it",
        "",
        Verdict.of(holds=now < was),
        f"a stage moves the endpoint by what the POSORs see; {was / now:.0f} times closer",
    )


def _coverage(coverage: Coverage) -> Iterator[Finding]:
    inside = coverage.inside
    drawn = f"{coverage.arms} arms, {coverage.poses} poses of each"
    binomial = float(np.sqrt(REGION * (1.0 - REGION) / (coverage.arms * coverage.poses)))
    allowed = max(COVERAGE_WITHIN, SURE * max(inside.sigma, binomial))
    yield Finding(
        "poses inside their published 95 % region",
        f"{100.0 * inside.value:.2f} % (standard uncertainty {100.0 * inside.sigma:.2f} %)",
        f"{100.0 * REGION:.0f} %",
        f"{100.0 * (REGION - allowed):.3g} to {min(100.0, 100.0 * (REGION + allowed)):.3g} %",
        "",
        Verdict.of(holds=abs(inside.value - REGION) <= allowed),
        f"{drawn}; mean NEES {coverage.nees.value:.2f} of 6; {coverage.lost} poses lost",
    )
    ratio = coverage.shift_ratio
    allowed = max(SAG_WITHIN, SURE * ratio.sigma)
    yield Finding(
        "displacement left by an uncorrected sag, found over predicted",
        f"{ratio.value:.4f} (standard uncertainty {ratio.sigma:.4f})",
        "1",
        f"{1.0 - allowed:.3g} to {1.0 + allowed:.3g}",
        "",
        Verdict.of(holds=abs(ratio.value - 1.0) <= allowed),
        f"mean displacement {_lengths(coverage.shift_found_m)} um, predicted {_lengths(coverage.shift_predicted_m)} um",
    )
    yield Finding(
        "endpoint minus truth without the correction of the sag",
        f"{coverage.rms_without_sag_m / MICRON:.1f} um rms",
        f"{_expected_without(coverage) / MICRON:.1f} um",
        "",
        "",
        Verdict.SHOWN,
        f"with the correction {coverage.rms_m / MICRON:.2f} um rms; {drawn}",
    )


def _budget(budget: Mapping[str, Any]) -> Iterator[Finding]:
    for configuration, made in budget.items():
        printed = made.get("printed", {})
        judged = configuration == "extended"  # how the thesis reckoned the bent arm's components stays open
        for key, what in (
            ("alpha_x_urad", "about X"),
            ("alpha_y_urad", "about Y"),
            ("alpha_z_urad", "about Z"),
            ("displacement_uin", "displacement"),
        ):
            unit = "urad" if key.endswith("urad") else "uin"
            stated = printed.get(key)
            yield Finding(
                f"budget, {configuration}: {what}",
                f"{made[key]:.2f} {unit}",
                "" if stated is None else f"{stated:g} {unit}",
                f"within {100.0 * BUDGET_WITHIN:.0f} %" if stated and judged else "",
                "thesis 9.3.1" if stated else "",
                Verdict.of(holds=abs(made[key] / stated - 1.0) <= BUDGET_WITHIN)
                if stated and judged
                else Verdict.SHOWN,
                "one standard uncertainty",
            )


def _largest(vectors: FloatArray) -> float:
    return float(np.nanmax(np.linalg.norm(vectors, axis=1))) / MICRON


def _lengths(vectors: FloatArray) -> str:
    lengths = np.linalg.norm(vectors, axis=1) / MICRON
    return f"{lengths.min():.1f} to {lengths.max():.1f}"


def _expected_without(coverage: Coverage) -> float:
    """Return the error that must come out without the correction: the other errors, and the predicted sag [m]."""
    return float(np.hypot(coverage.rms_m, rms(coverage.shift_predicted_m)))
