"""Noise-free closure: forward, then inverse, over the full range of each design; the closed form beside it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.accuracy.poses import count_known, errors_in_parent, readable_poses, thetas_of
from posor_estimator.core.closed_form import closed_form
from posor_estimator.core.designs import BUMPS, DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class LargestError:
    """Largest errors over all poses; infinite where a pose was not found at all."""

    translation_m: float
    rotation_rad: float

    def as_dict(self) -> dict[str, float]:
        """Return the figures by name."""
        return asdict(self)


def _largest(errors: FloatArray) -> LargestError:
    sizes = [float(np.max(np.linalg.norm(part, axis=1))) for part in (errors[:, :3], errors[:, 3:])]
    return LargestError(*sizes)


def closure(stack: DesignName, count: int, seed: int) -> tuple[LargestError, LargestError]:
    """Return the largest error of the estimator and of the closed form over ``count`` random poses of a design."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack))
    rotations, translations = readable_poses(posor, stack, count, random)
    scans = scans_at(posor.stack, rotations, translations, np.arange(count, dtype=np.int64))
    thetas = thetas_of(rotations)
    counts = count_known(posor, rotations)
    found = posor.locate_each(scans, counts)
    if np.any(found.states != State.OK):
        exact = LargestError(float("inf"), float("inf"))
    else:
        exact = _largest(errors_in_parent(found.rotations, found.translations, rotations, translations))
    batch = posor.stack.linearise(scans)[1]
    pool = posor.stack.pool
    simple = [
        closed_form(
            pool.kinds[chosen],
            pool.rows[chosen],
            values,
            BUMPS,
            thetas[n],
        )
        for n, (chosen, values) in enumerate(zip(batch.chosen, batch.values, strict=True))
    ]
    errors = errors_in_parent(
        np.array([rotation for rotation, _ in simple]),
        np.array([translation for _, translation in simple]),
        rotations,
        translations,
    )
    return exact, _largest(errors)
