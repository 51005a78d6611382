"""What a procedure puts into a calibration file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posor_estimator.core.calibration.quantity import Nested
    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class Replacement:
    """A new value of one quantity of a calibration file; its unit stays.

    Attributes:
        key: Where the quantity stands, as complaints print it: ``sensors[0].probes[1].volts_to_gap``.
        value: In the quantity's unit; a number, a list or a table, as the file has it.
        sigma: Standard uncertainty, one number or one for each component.

    """

    key: str
    value: Nested
    sigma: Nested


@dataclass(frozen=True)
class Part:
    """A part of a calibration file that is put in whole, such as a new map of a diode, or the name of the one in use.

    Attributes:
        key: Where it goes: ``sensors[1].maps.fitted``. What stands there already is replaced.
        content: Mappings, lists, numbers and texts, as the file shall have them.

    """

    key: str
    content: Any


@dataclass(frozen=True)
class JointCovariance:
    """How the components of some replaced quantities vary together.

    Attributes:
        entries: Key of each component, an index after it where the quantity has several:
            ``sensors[0].probes[1].volts_to_gap[2]``, ``sensors[0].target_plane.tilt[0]``; (p,).
        matrix: Covariance in the units of the quantities, (p, p) (JCGM 102, 3.11).

    """

    entries: tuple[str, ...]
    matrix: FloatArray
