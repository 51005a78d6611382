"""What the calibration's parameters do to the readings: their systematic covariance.

Each parameter is a sum of standard normal deviates, independent of one another: one of its own where the calibration
states only its standard uncertainty, all those of its block where it states a covariance (``PARTS``, ``ROOT``). Then
S = B B', with B the readings' derivatives with respect to the deviates (JCGM 100, 5.2). A deviate that reaches only one
reading adds to that reading's variance and needs no column of B. What is to be multiplied by what, and added to what,
is found out once for the rows that a scan reads, and holds as long as it reads the same; it is written down as places
in ``floats``.

Shares (3 numbers): place of a derivative, and of what it adds to, how many factors; negative where it is the first to
come there, and does not add. The factors stand in the same order in TAKEN_ROOT. A share of a single reading adds its
square to the reading's variance: those come first. Blocks (4): first column of B, how many, first and last reading that
they reach.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.tables import (
    BLOCKS,
    BY_READOUT,
    BY_ROW,
    DEVIATES,
    EFFECTS,
    HERE,
    PARTS,
    POOL_IDS,
    REACH,
    READINGS,
    READOUT_IDS,
    ROOT,
    SHARES,
    TAKEN_ROOT,
    TALLY,
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

USES, COLUMN, LAST = 0, 1, 2
"""Of a deviate: how many shares it has a part in; its column of B, negative for none; its last reading."""
ALONE, TOGETHER, COLUMNS = 0, 1, 2
"""Of the tally: shares of a single reading, all shares, blocks."""


@in_place
def find_shares(  # noqa: C901, PLR0912  loops over plain numbers, to be compiled
    places: IntArray, ints: IntArray, floats: FloatArray
) -> None:
    """Find out which derivatives count for the rows in HERE, and what each of them adds to.

    What of EFFECTS none of them reaches is zero from here on; REACH says which readings they correlate.
    """
    effects = table(places, floats, EFFECTS)
    pool_ids, here = table(places, ints, POOL_IDS), line(places, ints, HERE, 0)
    readout_ids, parts = table(places, ints, READOUT_IDS), table(places, ints, PARTS)
    shares, blocks = table(places, ints, SHARES), table(places, ints, BLOCKS)
    deviates, tally = table(places, ints, DEVIATES), line(places, ints, TALLY, 0)
    reach, root, taken = table(places, ints, REACH), line(places, floats, ROOT, 0), line(places, floats, TAKEN_ROOT, 0)
    m, width, length = here.shape[0], pool_ids.shape[1], readout_ids.shape[1]
    for d in range(deviates.shape[0]):
        deviates[d, USES], deviates[d, COLUMN] = 0, -1
    for r in range(m):
        for k in range(width + length):
            p = pool_ids[here[r], k] if k < width else readout_ids[r, k - width]
            if p >= 0 and parts[p, 1] > 0:
                deviates[parts[p, 0], USES] += 1
                deviates[parts[p, 0], LAST] = r
    for r in range(m):
        for d in range(effects.shape[1]):
            effects[r, d] = 0.0
    count, columns, found, next_factor = 0, 0, 0, 0
    for together in range(2):
        for r in range(m):
            for k in range(width + length):
                p = pool_ids[here[r], k] if k < width else readout_ids[r, k - width]
                if p < 0 or parts[p, 1] == 0:
                    continue
                deviate = parts[p, 0]
                alone = parts[p, 1] == 1 and deviates[deviate, USES] == 1
                if alone == (together == 1):
                    continue
                to = places[READINGS, 0] + r * (places[READINGS, 2] + 1)
                if not alone:
                    if deviates[deviate, COLUMN] < 0:
                        deviates[deviate, COLUMN] = columns
                        last = deviates[deviate, LAST]
                        if found == 0 or blocks[found - 1, 2] != r or blocks[found - 1, 3] != last:
                            blocks[found, 0], blocks[found, 1] = columns, 0
                            blocks[found, 2], blocks[found, 3] = r, last
                            found += 1
                        blocks[found - 1, 1] += parts[p, 1]
                        columns += parts[p, 1]
                    to = places[EFFECTS, 0] + r * places[EFFECTS, 2] + deviates[deviate, COLUMN]
                shares[count, 0] = places[BY_ROW, 0] + r * width + k
                if k >= width:
                    shares[count, 0] = places[BY_READOUT, 0] + r * length + k - width
                shares[count, 1], shares[count, 2] = to, parts[p, 1]
                if not alone and floats[to] == 0.0:
                    shares[count, 2] = -parts[p, 1]
                    floats[to] = 1.0
                for f in range(parts[p, 1]):
                    taken[next_factor + f] = root[parts[p, 2] + f]
                next_factor += parts[p, 1]
                count += 1
        tally[together] = count
    tally[COLUMNS] = found
    for r in range(m):
        reach[r, 0], reach[r, 1] = r, r + 1
        for b in range(found):
            if blocks[b, 2] <= r <= blocks[b, 3]:
                reach[r, 0] = min(reach[r, 0], blocks[b, 2])
                reach[r, 1] = max(reach[r, 1], blocks[b, 3] + 1)


@inlined
def reading_covariance(  # noqa: C901, PLR0912  loops over plain numbers, to be compiled
    places: IntArray, ints: IntArray, floats: FloatArray
) -> None:
    """Add the readings' covariance from the calibration's parameters to READINGS [m^2].

    BY_ROW and BY_READOUT hold the derivatives of the predictions less the readings at the pose.
    """
    shares, blocks, tally = table(places, ints, SHARES), table(places, ints, BLOCKS), line(places, ints, TALLY, 0)
    effects, out = table(places, floats, EFFECTS), table(places, floats, READINGS)
    factors = line(places, floats, TAKEN_ROOT, 0)
    total, to = 0.0, -1
    for s in range(tally[ALONE]):
        if shares[s, 1] != to:
            if to >= 0:
                floats[to] += total
            total, to = 0.0, shares[s, 1]
        effect = floats[shares[s, 0]] * factors[s]
        total += effect * effect
    if to >= 0:
        floats[to] += total
    first = tally[ALONE]
    for s in range(tally[ALONE], tally[TOGETHER]):
        derivative, to, count = floats[shares[s, 0]], shares[s, 1], shares[s, 2]
        if count == -1:
            floats[to] = derivative * factors[first]
            first += 1
        elif count < 0:
            cells, row = floats[to : to - count], factors[first : first - count]
            for c in range(-count):
                cells[c] = derivative * row[c]
            first -= count
        else:
            cells, row = floats[to : to + count], factors[first : first + count]
            for c in range(count):
                cells[c] += derivative * row[c]
            first += count
    for b in range(tally[COLUMNS]):
        for i in range(blocks[b, 2], blocks[b, 3] + 1):
            for j in range(blocks[b, 2], i + 1):
                total = _product(effects, i, j, blocks[b, 0], blocks[b, 1])
                out[i, j] += total
                if i != j:
                    out[j, i] += total


@inlined
def _product(effects: FloatArray, i: int, j: int, first: int, count: int) -> float:
    """Return the scalar product of parts of two rows; four sums side by side, since each waits for its last term."""
    one, other = effects[i, first : first + count], effects[j, first : first + count]
    a = b = c = d = 0.0
    whole = count - count % 4
    for k in range(0, whole, 4):
        a += one[k] * other[k]
        b += one[k + 1] * other[k + 1]
        c += one[k + 2] * other[k + 2]
        d += one[k + 3] * other[k + 3]
    for k in range(whole, count):
        a += one[k] * other[k]
    return (a + b) + (c + d)
