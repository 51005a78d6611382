"""The loop over scans: compiled where it can do all, a plain one beside it, and starts where they are wanted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.fault import State
from posor_estimator.core.kernels import memory as layout
from posor_estimator.core.kernels.locate import SINGULAR, deserves_retry
from posor_estimator.core.kernels.readout import FAULTS
from posor_estimator.core.kernels.scan import write_lost
from posor_estimator.core.kernels.scans import locate_many
from posor_estimator.core.kernels.solve import CONVERGED, gauss_newton
from posor_estimator.core.kernels.tables import EPOCH, MEMORY, SETTINGS
from posor_estimator.core.native import native_from_rotation
from posor_estimator.core.plain_rows import PlainRows
from posor_estimator.core.start import start_poses
from posor_estimator.core.tables import Tables

if TYPE_CHECKING:
    from typing import Any

    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.root import Root
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray

PHASE_GUESSES = 8
"""Starts within one bump that are tried where theta is not known at all."""
LIKELY_RUNOUT = 1e-4
"""Of starts that fit alike, as three ring probes have several, the one of least runout is taken; scale [m]."""
COUNT_WINDOW = 0.52
"""How far from a theta that is known to half a bump a solution may be, in bumps."""


class Loop:
    """Locates the scans of one stack one after the other; it holds what is remembered from scan to scan.

    Attributes:
        settings: See ``kernels.memory``.
        memory: See ``kernels.memory``.
        tables: What the kernels work on.
        epoch: 1 where it is known, and from which time the memory counts [ns].
        plain: The stack's plain sensors.
        known_theta: For a counted theta: what it is to half a bump in the next start [rad]; None: not known.

    """

    def __init__(self, stack: Stack, root: Root, settings: FloatArray) -> None:
        """Make the loop for a stack whose parameters are made of ``root``; ``settings`` as in ``kernels.memory``."""
        self._stack = stack
        self.tables = Tables(stack, root)
        self.settings = self.tables.of_floats(SETTINGS)[0]
        self.settings[:] = settings
        self.memory = self.tables.of_floats(MEMORY)[0]
        self.epoch = self.tables.of_ints(EPOCH)[0]
        self.plain = PlainRows(stack)
        self.known_theta: float | None = None

    @property
    def counting(self) -> bool:
        """Whether theta is counted."""
        return bool(self.settings[layout.BUMP] > 0.0)

    @property
    def compiled(self) -> bool:
        """Whether the compiled loop can do all; else scans are located in Python, one by one."""
        return self.tables.complete

    def arguments(self, scans: Scans, out: Estimates, begin: int, end: int) -> tuple[Any, ...]:
        """Return what ``kernels.scans.locate_scans`` is called with."""
        return (
            *self.tables.arrays,
            scans.stamps_ns,
            scans.gap_voltages,
            scans.ring_voltages,
            scans.diode_currents.reshape(scans.diode_currents.shape[0], math.prod(scans.diode_currents.shape[1:])),
            scans.lit_sources,
            scans.supply_voltages,
            scans.temperatures,
            scans.at_home,
            begin,
            end,
            out.outcomes,
            out.rotations,
            out.translations,
            out.covariances_random,
            out.covariances_systematic,
            out.figures,
        )

    def run(self, scans: Scans, out: Estimates) -> None:
        """Locate all scans into room for their estimates; the arrays of ``scans`` must be contiguous and writeable."""
        self.finish(scans, out, self._step(scans, out, 0, len(scans)))

    def finish(self, scans: Scans, out: Estimates, stopped: int) -> None:
        """Go on where the loop has stopped, with a start wherever it asks for one; then name the sensors' faults."""
        count = len(scans)
        while stopped != count:
            failed = stopped < 0
            n = -1 - stopped if failed else stopped
            if not (failed and self.counting):
                # Not known yet, or settled in a wrong place from afar: this one scan starts from a closed form.
                before = self.memory.copy()
                self._start(scans, n)
                self._step(scans, out, n, n + 1)
                if failed and out.states[n] == State.LOST:
                    self.memory[:] = before
            stopped = self._step(scans, out, n + 1, count)
        for n in np.flatnonzero(out.codes.any(axis=1)).tolist():
            for sensor, code in zip(self._stack.sensors, out.codes[n], strict=True):
                if code != 0:
                    out.outcomes[n, FAULTS] = int(sensor.explain(scans[n], int(code)).fault)
                    break

    def _step(self, scans: Scans, out: Estimates, begin: int, end: int) -> int:
        """Locate scans ``begin`` to ``end`` as far as no start is wanted; see ``kernels.scans.locate_scans``."""
        if self.compiled:
            return locate_many(*self.arguments(scans, out, begin, end))
        for n in range(begin, end):
            if self.epoch[0] == 0:
                self.epoch[:] = 1, scans.stamps_ns[n]
            codes, batch = self._stack.linearise(scans.part(n, n + 1))
            out.outcomes[n] = State.LOST, 0, *codes[0]
            out.figures[n] = np.nan
            _lose(out, n)
            if codes.any():
                continue
            stamp = float((scans.stamps_ns[n] - self.epoch[1]) * 1e-9)
            layout.restart_if_back(stamp, self.memory)
            if self.memory[layout.KNOWN] == 0.0:
                return n
            warm = self.memory[layout.GIVEN] == 0.0
            self.plain.locate(scans, batch, n, stamp, self.tables, out)
            if out.states[n] == State.LOST:
                _lose(out, n)
            if deserves_retry(int(out.states[n]), int(out.faults[n]), warm):
                return -1 - n
        return end

    def _give(self, rotation: FloatArray, translation: FloatArray) -> None:
        """Put a start into the memory; the motion to it says nothing."""
        layout.remember(self.memory, rotation, translation)
        self.memory[layout.KNOWN] = self.memory[layout.GIVEN] = 1.0
        self.memory[layout.RATE] = self.memory[layout.COUNTED] = self.memory[layout.INTERVAL] = 0.0
        self.memory[layout.THETA] = native_from_rotation(rotation)[2]
        if not self.counting:
            self.memory[layout.COUNTED] = 1.0

    def _start(self, scans: Scans, n: int) -> None:
        """Put the best closed-form start for scan n into the memory."""
        batch = self._stack.linearise(scans.part(n, n + 1))[1]
        pool, chosen = self._stack.pool, batch.chosen[0]
        kinds, rows, values = pool.kinds[chosen], pool.rows[chosen].copy(), batch.values[0]
        weights = 1.0 / batch.variances[0]
        bump, known = self.settings[layout.BUMP], self.known_theta
        guesses = [(known or 0.0) + bump * (i / PHASE_GUESSES - 0.5) for i in range(PHASE_GUESSES)]
        jacobian, residuals, moved = np.empty((len(values), 6)), np.empty(len(values)), np.empty(6)
        best = math.inf
        for pose in start_poses(kinds, rows, values, guesses if self.counting else [0.0]):
            rotation, translation = pose.rotation.copy(), pose.translation.copy()
            self.plain.expand(rows, rotation, translation)
            outcome = gauss_newton(
                kinds, rows, values, weights, rotation, translation, jacobian, residuals, moved, SINGULAR
            )
            settled = outcome == CONVERGED
            misfit = float(weights @ np.square(residuals)) if settled else math.inf
            misfit += float(np.sum(np.square(translation[:2] / LIKELY_RUNOUT)))
            if settled and self.counting and known is not None:
                off = abs(layout.wrapped(native_from_rotation(rotation)[2] - known))
                misfit = misfit if off < COUNT_WINDOW * bump else math.inf
            if misfit < best or math.isinf(best):
                best = min(best, misfit)
                self._give(*((rotation, translation) if settled else (pose.rotation, pose.translation)))
        if known is not None:
            self.memory[layout.COUNTED] = 1.0


def _lose(out: Estimates, n: int) -> None:
    """Make every number of scan n NaN, but for its chi-square."""
    write_lost(
        out.rotations[n], out.translations[n], out.covariances_random[n], out.covariances_systematic[n], out.figures[n]
    )
