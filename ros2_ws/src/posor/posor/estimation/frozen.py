# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings that repeat to the last bit although they have noise: electronics that no longer measure.

They repeat from scan to scan, or all of them in a loop, as from a buffer that nobody fills any more.

Two readings of a channel at rest are equal with the probability p that the noise stays within a step of the converter.
The evidence of n repetitions is ``-n log10 p``: a channel is frozen where its own is FROZEN_EVIDENCE, a sensor where
all its channels repeat at once and the sum of theirs is, and everything where all channels repeat and the sum is
ALL_FROZEN_EVIDENCE. A channel without noise above its step has no evidence.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from posor.estimation.workspace import LONGEST_LOOP
from posor.model.readings import DIODE_CURRENTS, GAP_VOLTAGES, PYTHON
from posor.model.scan import CONTACTS, DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from posor.estimation.workspace import Model

FROZEN_EVIDENCE = 6.0  # evidence of a channel or a sensor that it is frozen: by chance once in a million scans
ALL_FROZEN_EVIDENCE = 3.5  # the same of all channels: the first repeated scan is seen; a wrong alarm costs one scan
LOOP_EVIDENCE = 8.0  # evidence of all channels together that scans repeat in a loop of two or more
LOOP_SCANS = 2  # fewest scans in a row that repeat earlier ones; a recording played back and forth has one at each end
LOOP_WEIGHT = 0.7390851332151607
"""Weight of a reading in the signature of a scan: no polynomial with whole coefficients is zero there, so that readings
which are whole multiples of a step give equal signatures only where all of them are equal."""
ALL = -1  # frozen reading where it is all of them together
NOT_FROZEN = -2
_CELLS = 200  # converter steps on either side of a reading that are summed


def evidence_of_repetition(step: float, noise: float) -> float:
    """Return ``-log10`` of the probability that a reading repeats by chance, at most FROZEN_EVIDENCE.

    ``step``: of the converter; zero: readings are not rounded; ``noise``: standard deviation of one reading, same unit.
    """
    if step <= 0.0 or step < 0.1 * noise:
        likely = 0.5 * max(step, 0.0) / (noise * math.sqrt(math.pi))
        return min(FROZEN_EVIDENCE, -math.log10(likely)) if likely > 0.0 else FROZEN_EVIDENCE
    edges = [0.5 * math.erf((cell - 0.5) * step / noise * math.sqrt(0.5)) for cell in range(-_CELLS, _CELLS + 2)]
    likely = sum((high - low) ** 2 for low, high in pairwise(edges))
    return min(FROZEN_EVIDENCE, max(0.0, -math.log10(likely)))


@in_place
def count_repetitions(model: Model, scan: Any) -> int:  # noqa: C901  loops over plain numbers
    """Count how often each raw reading has repeated; return a reading that is frozen, ALL or NOT_FROZEN.

    Readings that the driver has filled in count as new ones.
    """
    workspace = model.workspace[0]
    tracker, frozen, fewest = workspace.tracker, NOT_FROZEN, 1 << 30
    if workspace.settings.all_evidence <= 0.0:
        return frozen
    filled_in = scan.status & (PROBES_ESTIMATED | DIODES_ESTIMATED) != 0
    signature = math.nan if filled_in else 0.0  # NaN equals nothing
    for s in range(model.sensors.shape[0]):
        sensor = model.sensors[s]
        if sensor.source == PYTHON:
            continue
        of_diodes = sensor.source == DIODE_CURRENTS
        measured = scan.status & (DIODES_ESTIMATED if of_diodes else PROBES_ESTIMATED) == 0
        fewest_of_sensor, evidence_of_sensor = 1 << 30, 0.0
        for i in range(2 * sensor.count if of_diodes else sensor.count):
            r = sensor.first_reading + i
            if of_diodes:
                contact = CONTACTS * (i // 2) + i % 2
                one, other = scan.diode_currents[contact], scan.diode_currents[contact + 2]
            else:
                one = scan.gap_voltages[i] if sensor.source == GAP_VOLTAGES else scan.ring_voltages[i]
                other = 0.0
            repeated = measured and one == tracker.last_raw[r, 0] and other == tracker.last_raw[r, 1]
            tracker.repeats[r] = tracker.repeats[r] + 1 if repeated else 0
            tracker.last_raw[r, 0], tracker.last_raw[r, 1] = one, other
            signature = (signature * LOOP_WEIGHT + one) * LOOP_WEIGHT + other
            if workspace.evidence[r] > 0.0:
                fewest_of_sensor = min(fewest_of_sensor, tracker.repeats[r])
                evidence_of_sensor += workspace.evidence[r]
                if tracker.repeats[r] * workspace.evidence[r] >= FROZEN_EVIDENCE:
                    frozen = r
        if evidence_of_sensor > 0.0:
            fewest = min(fewest, fewest_of_sensor)
            if fewest_of_sensor * evidence_of_sensor >= FROZEN_EVIDENCE:
                frozen = sensor.first_reading
    if fewest > 0 and fewest * workspace.settings.all_evidence >= ALL_FROZEN_EVIDENCE:
        frozen = ALL
    if _repeats_in_a_loop(tracker, signature, workspace.settings.all_evidence):
        frozen = ALL
    return frozen


@in_place
def _repeats_in_a_loop(tracker: Any, signature: float, evidence: float) -> bool:
    """Return whether the readings repeat those of some scans before; their weighted sum differs where one does."""
    count, longest = tracker.signature_count, 0
    for lag in range(1, LONGEST_LOOP):
        same = lag <= count and tracker.signatures[(count - lag) % LONGEST_LOOP] == signature
        tracker.loop_repeats[lag] = tracker.loop_repeats[lag] + 1 if same else 0
        if lag > 1:
            longest = max(longest, tracker.loop_repeats[lag])
    tracker.signatures[count % LONGEST_LOOP] = signature
    tracker.signature_count = count + 1
    return longest * evidence >= LOOP_EVIDENCE and longest >= LOOP_SCANS
