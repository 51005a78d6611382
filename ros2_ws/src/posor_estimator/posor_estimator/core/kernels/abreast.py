"""A scan of each of eight POSORs of one design at once, as long as every one of them is ordinary.

Ordinary: the pose before is known and the motion goes on from it, the readings are in their ranges, and nothing is
wrong with the pose that they give. Then the steps are those of ``kernels.locate`` in their order, with numbers as
``kernels.eight`` has them. Where one of the eight is not ordinary nothing is kept of any of them: each is located alone
then, which says what is wrong.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined, without_lock
from posor_estimator.core.kernels.abreast_read import TIME, read_abreast
from posor_estimator.core.kernels.abreast_solve import by_parameters_abreast, newton_abreast
from posor_estimator.core.kernels.effects import reading_covariance
from posor_estimator.core.kernels.eight import chosen, eights, everywhere
from posor_estimator.core.kernels.judge import chi_square, covariances
from posor_estimator.core.kernels.locate import SINGULAR, WEAK
from posor_estimator.core.kernels.memory import (
    INTERVAL,
    LIMIT,
    MOTION_TRANSLATION,
    STAMP,
    THETA,
    carry_on,
    goes_on,
    recall,
    remember,
    remember_motion,
    theta_of,
    wrapped,
)
from posor_estimator.core.kernels.motion import share_moved
from posor_estimator.core.kernels.records import write_covariance
from posor_estimator.core.kernels.reshaped import part
from posor_estimator.core.kernels.tables import (
    HERE,
    LINES,
    MEMORY,
    RANDOM,
    READINGS,
    ROTATION,
    SETTINGS,
    SYSTEMATIC,
    TRANSLATION,
    VARIANCES,
    WEIGHTS,
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

# What is found of a scan, eights.
FOUND_ROTATION, FOUND_TRANSLATION, FOUND_COVARIANCE, FOUND_RESIDUAL, FOUND_THETA = 0, 9, 12, 48, 49
FOUND = 50


@inlined
def locate_eight(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    trial: FloatArray,
    readings: FloatArray,
    found: FloatArray,
    kind: int,
) -> bool:
    """Locate a scan of each from the pose before on; return whether all are ordinary, else nothing is remembered.

    Args:
        places: See ``kernels.tables``.
        ints: Of any of the POSORs: all read alike.
        floats: The tables that are ``COMMON``, eights.
        trial: Room, see ``newton_abreast``, eights.
        readings: See ``kernels.abreast_read``, eights.
        found: What is found to write, see FOUND, eights.
        kind: Which covariance is wanted, see ``kernels.records``.

    """
    settings, memory = line(places, floats, SETTINGS, 0), line(places, floats, MEMORY, 0)
    rotation, translation = part(found, FOUND_ROTATION, 3, 3), found[FOUND_TRANSLATION:FOUND_COVARIANCE]
    random, systematic = table(places, floats, RANDOM), table(places, floats, SYSTEMATIC)
    m = line(places, ints, HERE, 0).shape[0]
    elapsed = readings[TIME] - memory[STAMP]
    ordinary = (elapsed > 0.0) & goes_on(elapsed, memory) & read_abreast(places, ints, floats, readings)
    if not everywhere(ordinary):
        return False
    weights, variances = line(places, floats, LINES, WEIGHTS), line(places, floats, LINES, VARIANCES)
    for r in range(m):
        weights[r] = 1.0 / variances[r]
    trial_rotation, trial_translation = table(places, floats, ROTATION), line(places, floats, TRANSLATION, 0)
    recall(memory, trial_rotation, trial_translation)
    carry_on(elapsed, settings, memory, trial_rotation, trial_translation)
    limited = settings[MOTION_TRANSLATION] < math.inf
    least_share = chosen(limited, WEAK, SINGULAR)
    if not newton_abreast(places, ints, floats, m, least_share, trial, rotation, translation):
        return False
    by_parameters_abreast(places, ints, floats, m, rotation, translation)
    whole = table(places, floats, READINGS)
    for i in range(m):
        for j in range(m):
            whole[i, j] = 0.0
    reading_covariance(places, ints, floats)
    covariances(places, ints, floats, m, rotation, random, systematic)
    found[FOUND_RESIDUAL] = 0.0
    if m > 6:  # noqa: PLR2004  six unknowns
        found[FOUND_RESIDUAL] = chi_square(places, ints, floats, m)
    theta = theta_of(rotation)
    moved = chosen(limited, share_moved(settings, elapsed, random, rotation, translation, theta, memory), 0.0)
    if not everywhere((found[FOUND_RESIDUAL] <= settings[LIMIT]) & (moved <= 1.0)):
        return False
    write_covariance(kind, random, systematic, part(found, FOUND_COVARIANCE, 6, 6))
    theta = memory[THETA] + wrapped(theta - memory[THETA])
    found[FOUND_THETA] = theta
    remember_motion(elapsed, theta, translation, memory)
    memory[INTERVAL] = elapsed
    memory[STAMP] = readings[TIME]
    memory[THETA] = theta
    remember(memory, rotation, translation)
    return True


@without_lock
def locate_abreast(
    places: IntArray,
    ints: IntArray,
    numbers: FloatArray,
    trial: FloatArray,
    readings: FloatArray,
    found: FloatArray,
    width: int,
    kind: int,
    count: int,
) -> int:
    """Locate scan after scan of eight POSORs, as long as all are ordinary; return how many.

    Args:
        places: See ``locate_eight``.
        ints: See ``locate_eight``.
        numbers: The POSORs' tables that are ``COMMON``, taking turns number by number, as in all that follow.
        trial: See ``locate_eight``.
        readings: See ``kernels.abreast_read``.
        found: What is found to write, see FOUND.
        width: How many numbers are read of a scan.
        kind: See ``locate_eight``.
        count: How many scans there are of each.

    """
    floats, room, reads, out = eights(numbers), eights(trial), eights(readings), eights(found)
    for n in range(count):
        read, to_find = reads[n * width : n * width + width], out[n * FOUND : n * FOUND + FOUND]
        if not locate_eight(places, ints, floats, room, read, to_find, kind):
            return n
    return count
