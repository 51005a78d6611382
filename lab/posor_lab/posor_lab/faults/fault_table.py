"""Rows of the fault table and their results."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    from collections.abc import Mapping

FaultKind = Literal["off", "stuck", "garbage", "wrong", "slow", "clock", "network"]
"""Failure types of PX4's fault injection, and faults of clock and network."""
Arm = Literal["six_axis", "five_axis", "test_rig"]
"""Installed arms: light rings and four gap probes; bumpy rings and three; fixed diodes and three."""
ARMS: tuple[Arm, ...] = get_args(Arm)

NAMING_LIMITS_S: Mapping[FaultKind, float] = {
    "off": 0.5,
    "slow": 0.5,
    "network": 0.5,
    "stuck": 0.2,
    "garbage": 0.2,
    "wrong": 0.2,
    "clock": 0.2,
}
"""Longest time from the first faulted message, or the loss of the input, to the first message that names it [s]."""
COVERED_SHARE = 0.99
"""Least share of cases in which the protection level covers a fault that is not observable."""


@dataclass(frozen=True)
class FaultRow:
    """One fault of the table.

    Attributes:
        name: Name, unique in the table.
        kind: Kind of the failure.
        arm: Arm that it is injected into.
        expected: Sentence on the expected behaviour.
        named_by: Names of fault flags, or words of a sentence, of which one must be published; none where the fault
            cannot be seen.
        may_hide: Whether a reading of the fault may by chance be so close to the right one that nothing shows it.

    """

    name: str
    kind: FaultKind
    arm: Arm
    expected: str
    named_by: tuple[str, ...] = ()
    may_hide: bool = False

    @property
    def is_observable(self) -> bool:
        """Whether each scan with the fault shows it: then no pose may be wrong, else the protection level covers it."""
        return bool(self.named_by) and not self.may_hide


@dataclass(frozen=True)
class RowResult:
    """What a run shows of a fault.

    Attributes:
        row: The fault.
        seen: Sentence on what was published.
        naming_s: Time from the fault to the first message that names it [s]; None: not named.
        wrong_ok: Number of poses published as valid that are beyond 5 standard deviations of the truth.
        covered: Share of cases within the protection level, of a fault that is not observable.
        problem: Why the run does not count, such as a joint that had no pose before the fault; empty: it counts.

    """

    row: FaultRow
    seen: str
    naming_s: float | None
    wrong_ok: int
    covered: float = math.nan
    problem: str = ""

    @property
    def failures(self) -> list[str]:
        """Sentences on the aims that are missed; empty: the row holds."""
        found = [self.problem] if self.problem else []
        if not self.row.is_observable:
            if not self.covered >= COVERED_SHARE:
                found.append(f"the protection level covers {100.0 * self.covered:.1f} % of the cases")
        elif self.wrong_ok:
            found.append(f"{self.wrong_ok} wrong poses published as valid")
        limit = NAMING_LIMITS_S[self.row.kind]
        if not self.row.named_by:
            return found
        if self.naming_s is None:
            found.append("not named")
        elif self.naming_s > limit:
            found.append(f"named after {self.naming_s:.2f} s, limit {limit:g} s")
        return found

    def as_json(self) -> dict[str, Any]:
        """Return the row of ``faults.json``."""
        return {
            "fault": f"{self.row.arm}: {self.row.name}",
            "kind": self.row.kind,
            "observable": self.row.is_observable,
            "expected": self.row.expected,
            "seen": self.seen,
            "naming_s": None if self.naming_s is None else round(self.naming_s, 4),
            "wrong_ok": self.wrong_ok,
            "covered": None if math.isnan(self.covered) else round(self.covered, 4),
            "failures": self.failures,
        }
