"""Random numbers that are the same whichever process asks for them, and in whatever order.

Counter-based (Philox): the key is told by the scenario's seed and by what the numbers are for, the counter by the tick.
"""

from __future__ import annotations

import hashlib

import numpy as np


class Stream:
    """The random numbers of one purpose, such as ``"readings", "elbow"``."""

    def __init__(self, seed: int, *purpose: str) -> None:
        """Make the key."""
        name = "\0".join([str(seed), *purpose])
        self._key = np.frombuffer(hashlib.blake2b(name.encode(), digest_size=16).digest(), dtype="<u8")

    def at(self, tick: int = 0) -> np.random.Generator:
        """Return the generator of a tick; without one, that of what is drawn once."""
        # The lowest word of the counter counts the draws; the tick stands where no number of draws gets to.
        counter = np.array([0, 0, tick, 0], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))
