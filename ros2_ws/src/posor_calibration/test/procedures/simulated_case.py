# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A procedure with a recording whose true parameters are known, and changes of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import Calibration
from posor.calibration.designs import STANDOFF
from posor.errors import PosorError
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor_calibration.procedure import Outcome, Procedure
from posor_lab.harness.simulated_recordings import diode_calibration, simulated_recording


@dataclass(frozen=True)
class SimulatedCase:
    """Input of a procedure with one reference, and the truth."""

    procedure: Procedure[Any]
    calibration: Calibration
    recording: Recording
    truth: Any = None

    @classmethod
    def at_rest(
        cls, procedure: Procedure[Any], calibration: Calibration, count: int, seed: int = 0, **environment: Any
    ) -> SimulatedCase:
        """Return scans of a resting target in an environment, as for ``simulated_recording``, by the true calibration.

        The design is the input of the procedure.
        """
        recording = simulated_recording(
            calibration,
            np.tile(np.eye(3), (count, 1, 1)),
            np.tile([0.0, 0.0, STANDOFF], (count, 1)),
            np.zeros((count, 1)),
            np.random.default_rng(seed),
            **environment,
        )
        return cls(procedure, diode_calibration(), recording)

    def identify(self, **options: Any) -> Outcome:
        return self.procedure.identify(self.recording, self.calibration, self.procedure.options(**options))

    def check_refusal(self, kind: type[PosorError], sentence: str, /, **options: Any) -> None:
        with pytest.raises(kind, match=sentence):
            self.identify(**options)

    @property
    def reference(self) -> Track:
        [track] = self.recording.tracks.values()
        return track

    def with_reference(self, **changes: Any) -> SimulatedCase:
        [topic] = self.recording.tracks
        return self.with_recording(tracks={topic: replace(self.reference, **changes)})

    def with_values(self, change: Callable[[FloatArray], FloatArray]) -> SimulatedCase:
        """Return the case with other values of its reference, (n, k)."""
        return self.with_reference(values=change(self.reference.values.copy()))

    def with_recording(self, **changes: Any) -> SimulatedCase:
        return replace(self, recording=replace(self.recording, **changes))

    def with_scans(self, scans: Scans) -> SimulatedCase:
        return self.with_recording(scans=scans)

    def with_readings(
        self, kind: str, new: float | Callable[[FloatArray], FloatArray], where: Any = slice(None)
    ) -> SimulatedCase:
        """Return the case with some readings of a kind replaced by a number or by a function of themselves."""
        values = getattr(self.recording.scans, kind).copy()
        values[where] = new(values[where]) if callable(new) else new
        return self.with_scans(self.recording.scans.with_fields({kind: values}))


def check_coverage(normalised: Any, coverage: float, scatter: float) -> None:
    """Check errors over their standard uncertainties: 95 % within 1.96, standard deviation 1, within tolerances."""
    assert np.mean(np.abs(normalised) < 1.96) == pytest.approx(0.95, abs=coverage)
    assert np.std(normalised) == pytest.approx(1.0, abs=scatter)
