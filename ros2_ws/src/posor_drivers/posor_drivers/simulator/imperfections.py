# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Switches for the simulated imperfections, and their random numbers; magnitudes are in scenario and arm files."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.numerics.array_types import FloatArray


class Imperfections(BaseModel):
    """One switch for each imperfection. The mechanics of the arm always follow the scenario."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noise: bool = Field(default=True, description="noise of the readings, as large as the calibration says")
    quantisation: bool = Field(default=True, description="steps of the analogue-to-digital converter")
    zero_drift: bool = Field(default=True, description="slow drift of the probes' zeros")
    supply_drift: bool = Field(default=True, description="slow drift of the probes' supply voltage")
    ambient_light: bool = Field(default=True, description="ambient light on the diodes, and dark scans that measure it")
    contamination: bool = Field(default=True, description="dirt on single channels, part of the time")
    dropouts: bool = Field(default=True, description="scans that are never published")
    latency: bool = Field(default=True, description="delay between exposure and publication")
    calibration_errors: bool = Field(
        default=True, description="POSORs differ from their calibrations, by as much as those say is uncertain"
    )
    beam_errors: bool = Field(
        default=True, description="measuring beams differ from the beams file, by as much as it says is uncertain"
    )
    temperature: bool = Field(
        default=True, description="temperatures and gradients of the measuring beams, errors of their thermometers"
    )
    sag: bool = Field(default=True, description="sag of the measuring beams")
    inertia: bool = Field(default=True, description="change of the sag while the beams accelerate")
    vibration: bool = Field(default=True, description="vibration of links, of which the scenario states it, and beams")

    @classmethod
    def only(cls, *names: str) -> Self:
        """Return the model with only the named switches on."""
        return cls(**{name: name in names for name in cls.model_fields})


class RandomStream:
    """Random numbers for one purpose, such as ``"readings", "elbow"``; seed and purpose form the Philox key.

    They are counter-based: equal in every process and independent of the order of the calls.
    """

    def __init__(self, seed: int, *purpose: str) -> None:
        """Derive the key from seed and purpose."""
        name = "\0".join([str(seed), *purpose])
        self._key = np.frombuffer(hashlib.blake2b(name.encode(), digest_size=16).digest(), dtype="<u8")

    def generator(self, tick: int = 0) -> np.random.Generator:
        """Return the generator of a tick; the default is for values drawn once."""
        # The lowest counter word counts the draws, so the tick uses a word that draws never reach.
        counter = np.array([0, 0, tick % 2**64, 0], dtype=np.uint64)  # ticks before time zero are negative
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))


def shared_errors(seed: int, terms: Iterable[str]) -> FloatArray:
    """Return the errors of an arm's shared terms over their standard uncertainties, (terms,): the same in all parts."""
    return np.array([RandomStream(seed, "shared", name).generator().normal() for name in terms])
