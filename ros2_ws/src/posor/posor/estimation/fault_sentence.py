# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sentence on the faults of an estimate: what is wrong with a scan, and what would be right."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.calibration.plausible_range import ANY_FINITE
from posor.estimation.ambient import LIGHT_LEFT, NO_DARK_SCAN, NO_POSE
from posor.estimation.clocks import CONTRADICTORY, LATE, SCATTER_LIMIT
from posor.estimation.estimate import NO_STAMP, OTHER_FRAME
from posor.estimation.frozen import ALL
from posor.estimation.linearise import INVALID_TIME, REFERENCE_MEASURED
from posor.estimation.time_errors import LONGEST_OFFSET_S
from posor.model.fault import Fault
from posor.model.scan import NO_SOURCE
from posor.numerics.stamps import NO_TIME

if TYPE_CHECKING:
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scan

RELEASE = (  # what releases a latch
    "until the earlier motion is regained, the readings agree again where they contradicted one another, a reference "
    "confirms theta, or ~/acknowledge is called"
)


def fault_sentence(stack: Stack, settings: Any, tracker: Any, scan: Scan, estimate: Any) -> str:
    """Return the sentence on the faults of a scan's estimate, empty where it has none.

    ``stack``: sensors of the POSOR; ``settings``: record of dtype ``workspace.SETTINGS``; ``tracker``: record of dtype
    ``workspace.TRACKER``; ``estimate``: record of dtype ESTIMATE.
    """
    faults = int(estimate["faults"])
    if faults == 0:
        return ""
    if estimate["sensor"] >= 0:
        return str(stack.sensors[estimate["sensor"]].explain(scan, int(estimate["code"])))
    code = int(estimate["code"])
    refusals = {
        NO_STAMP: f"the stamp {NO_TIME}; expected the time of exposure",
        OTHER_FRAME: "comes from another frame than that of the calibration",
        LATE: "its number does not come after that of a scan before; expected scans in the order of their numbers",
        CONTRADICTORY: "its stamp contradicts its number, given the scans before; expected the time of exposure",
        NO_DARK_SCAN: "the ambient light is unknown; expected a dark scan before, or STATUS_DARK_SUBTRACTED",
        LIGHT_LEFT: "light of the sources is left in the dark scans, whose currents change as the spots move; expected "
        "more time without light before, then two dark scans at different spots, or ~/acknowledge and one",
        NO_POSE: "no light source is lit (a dark scan) while no pose is known; expected lit scans around it",
        INVALID_TIME: "its exposures or its stamp's uncertainty are invalid; expected no offset or one for each "
        f"channel, at most {LONGEST_OFFSET_S:g} s or NaN, and times that are not negative",
    }
    if code in refusals:
        return f"scan {scan.number}: {refusals[code]}."
    frozen = "every reading" if code == ALL else stack.reading_names[code]
    sentences = {
        Fault.BAD_READING: "a reading is invalid",
        Fault.NOT_CONVERGED: "the estimate did not converge",
        Fault.ILL_CONDITIONED: "the readings do not determine all six freedoms",
        Fault.RESIDUAL: f"the redundant readings contradict one another, chi-square {estimate['residual']:.3g}; "
        f"expected at most {settings['residual_limit']:.3g}",
        Fault.INNOVATION: "the pose is further from the previous pose than the target can have moved",
        Fault.TRAVEL: _travel_sentence(settings, tracker),
        Fault.COUNT: "the count of theta is in doubt, or a home mark disagrees with it",
        Fault.ENVIRONMENT: _environment_sentence(settings, int(tracker["measured"]), scan),
        Fault.FLAGGED: "the driver marked a reading as saturated or filled in",
        Fault.FROZEN: f"{frozen} repeats to the last bit although it has noise",
        Fault.ENCODER: "theta disagrees with the encoder",
        Fault.ACKNOWLEDGED: "a latch was released by ~/acknowledge; expected an encoder or home marks to confirm it",
        Fault.TIME: "the target moves while the times of the readings are uncertain; expected stated exposures and "
        "stamps at the time of exposure",
        Fault.AMBIENT: _ambient_sentence(settings, scan),
    }
    found = [sentence for fault, sentence in sentences.items() if faults & fault]
    if faults & Fault.LATCHED:
        found = [f"latched after {Fault(faults & ~Fault.LATCHED).name}, {RELEASE}"]
        if faults & Fault.TRAVEL:
            found.append(sentences[Fault.TRAVEL])
    clocks, offset = tracker["clocks"], tracker["offset"]
    scatter_s = math.sqrt(clocks["variance"])
    if faults & Fault.INNOVATION and scatter_s > SCATTER_LIMIT * clocks["period"]:
        found.append(
            f"the stamps scatter by {1e3 * scatter_s:.3g} ms beside the scan numbers; expected the time of exposure"
        )
    if faults & Fault.ENCODER and offset["disagreeing"] != 0.0:
        uncertainty = 1e3 * math.sqrt(offset["variance"])
        found.append(
            f"the time offset of the scans from the encoder is {1e3 * offset['seconds']:.3g} ms (positive: the "
            f"readings are older than their stamps), standard uncertainty {uncertainty:.2g} ms; expected at most "
            f"{1e3 * scan.stamp_limit:.3g} ms, the stated stamp_limit"
        )
    return f"scan {scan.number}: {'; '.join(found)}." if found else ""


def _travel_sentence(settings: Any, tracker: Any) -> str:
    gap = settings["travel_gap"]
    return (
        f"a pose is beyond the travel of the bearing, by 'motion' of the calibration (the last one: gap "
        f"{tracker['beyond_gap']:.4g} m, lean {tracker['beyond_lean']:.3g} rad); expected a gap of {gap[0]:g} to "
        f"{gap[1]:g} m and a lean of at most {settings['travel_lean']:g} rad"
    )


def _ambient_sentence(settings: Any, scan: Scan) -> str:
    if all(lit == NO_SOURCE for lit in scan.lit_sources):
        return "no light source is lit (a dark scan), so x, y and theta are extrapolated"
    return (
        "the ambient light may have changed since the last dark scan; expected one at least every "
        f"{settings['dark_age']:g} s, or STATUS_DARK_SUBTRACTED"
    )


def _environment_sentence(settings: Any, measured: int, scan: Scan) -> str:
    parts = (("supply voltage", scan.supply_voltage, "V"), ("temperature", scan.temperature, "K"))
    found = []
    for k, (name, value, unit) in enumerate(parts):
        low, high = settings["environment"][k]
        if math.isnan(value) and measured & 1 << k:
            spread = settings["spreads"][k]
            found.append(
                f"{name} is no longer measured, and is taken as that of the calibration with the standard uncertainty "
                f"{spread:g} {unit}; expected a measurement"
            )
        elif not (math.isnan(value) or low <= value <= high):
            range_text = "a finite number or NaN" if (low, high) == ANY_FINITE else f"{low:g} to {high:g} {unit}"
            found.append(f"{name} {value:g} {unit} is outside the calibration's range; expected {range_text}")
    known, most = float(settings["reference_voltage"]), float(settings["gain_limit"])
    if known > 0.0 and math.isnan(scan.reference_voltage) and measured & REFERENCE_MEASURED:
        found.append(
            "reference voltage is no longer measured, and the gain of the converter is taken as 1 with the standard "
            f"uncertainty {settings['gain_spread']:g}; expected a measurement"
        )
    elif known > 0.0 and abs(scan.reference_voltage - known) > most * known:
        found.append(
            f"reference voltage {scan.reference_voltage:g} V is outside the calibration's range; expected "
            f"{known * (1.0 - most):g} to {known * (1.0 + most):g} V"
        )
    return "; ".join(found)
