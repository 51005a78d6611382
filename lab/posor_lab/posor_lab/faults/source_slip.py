"""Slip of the light sources of a coded ring: by every number, on both diodes, from the first scan on and later."""

from __future__ import annotations

import math

import numpy as np
from posor.calibration.designs import sized_design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault
from posor.numerics.stamps import NS
from posor.sensors.diodes import DiodesCalibration
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.faults.fault_table import FaultRow, RowResult
from posor_lab.faults.pose_judge import wrong_poses

SLIP_ROW = FaultRow(
    "light-source index off by every number on both diodes, from the first scan on and later",
    "wrong",
    "six_axis",
    "LOST in the first scan by RESIDUAL or SOURCE",
    ("RESIDUAL", "SOURCE"),
)
SCANS, RATE = 12, 500
LATER = 6
"""Scan at which the later slips begin."""


def run_slips(seed: int, positions: int = 12) -> RowResult:
    """Return the result of all slips at a number of random angles of the ring."""
    calibration = sized_design("quad_light_ring", 0.2032, frames=("receiving", "target"), title="slips")
    posor = Posor(calibration)
    sources = next(len(each.light_sources) for each in calibration.sensors if isinstance(each, DiodesCalibration))
    random = np.random.default_rng(seed)
    wrong = flagged = slips = 0
    slowest = 0
    for theta in random.uniform(-math.pi, math.pi, positions):
        truth = PoseArray.from_axis_angles(2, theta + 1e-3 * np.arange(SCANS) / SCANS)
        truth = PoseArray(truth.rotations, truth.translations + np.array([0.0, 0.0, 0.735e-3]))
        stack = posor.stack
        errors = stack.parameter_sigmas * random.normal(size=stack.parameters)
        stack = stack.with_parameter_values(stack.parameter_values + errors)
        stamps = np.arange(1, SCANS + 1, dtype=np.int64) * (NS // RATE)
        sound = scans_at(stack, truth.rotations, truth.translations, stamps, noise=random)
        for begin in (0, LATER):
            for slip in range(1, sources):
                lit = sound.lit_sources.copy()
                lit[begin:] = (lit[begin:] + slip) % sources
                posor.reset()
                found = posor.estimate_all(sound.with_fields({"lit_sources": lit}))
                covariances = found.covariances_random + found.covariances_systematic
                valid = np.isin(found.states, USABLE_STATES)
                wrong += int(
                    np.count_nonzero(
                        valid & wrong_poses(PoseArray(found.rotations, found.translations), covariances, truth)
                    )
                )
                named = np.flatnonzero(found.faults[begin:] & int(Fault.RESIDUAL | Fault.SOURCE))
                slips += 1
                flagged += named.size > 0
                slowest = max(slowest, int(named[0]) if named.size else SCANS)
    seen = f"{flagged} of {slips} slips named, the slowest after {slowest} scans; {sources} sources"
    return RowResult(SLIP_ROW, seen, slowest / RATE if flagged == slips else None, wrong)
