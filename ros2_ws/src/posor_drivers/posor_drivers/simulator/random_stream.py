"""Counter-based random numbers (Philox): equal in every process and independent of the order of the calls."""

from __future__ import annotations

import hashlib

import numpy as np


class RandomStream:
    """Random numbers for one purpose, such as ``"readings", "elbow"``; seed and purpose form the Philox key."""

    def __init__(self, seed: int, *purpose: str) -> None:
        """Derive the key from seed and purpose."""
        name = "\0".join([str(seed), *purpose])
        self._key = np.frombuffer(hashlib.blake2b(name.encode(), digest_size=16).digest(), dtype="<u8")

    def generator(self, tick: int = 0) -> np.random.Generator:
        """Return the generator of a tick; the default is for values drawn once."""
        # The lowest counter word counts the draws, so the tick uses a word that draws never reach.
        counter = np.array([0, 0, tick, 0], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))
