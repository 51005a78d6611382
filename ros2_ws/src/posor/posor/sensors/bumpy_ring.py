# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bumpy ring: gap probes looking radially at a ring with bumps; two runouts and the large rotation, counted in bumps.

Source: thesis 3.2.2, the alternative to diodes. The source draws three probes. With three, the sensitivity of the
readings to (x, y, theta) vanishes at least twice in every bump, whatever the profile, since its determinant is a
continuous function of the bump phase with zero mean. Four probes, opposite ones in phase and the two pairs in
quadrature, are equally well conditioned at every phase, with one redundant reading for the health check: so four are
the default. Five with the phases of ``design_parts.ring_azimuths`` check each other at every angle. ``observability``
shows it for any arrangement.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.plausible_range import PLACE
from posor.calibration.quantity import ANY, Quantity, measured
from posor.model.gap import MAX_HARMONICS
from posor.model.reading_rows import RING, ROW, evaluate_rows
from posor.model.readings import RING_VOLTAGES
from posor.sensors.base import SensorCalibration, no_parameters
from posor.sensors.probe import ProbeCalibration, ProbeSensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray, IntArray


IN_PHASE = 0.95  # least resultant of the probes' phases, doubled, at which they are in phase


class RingSurfaceCalibration(FrozenModel):
    """The ring: ``r(phi) = mean_radius + sum_k (cos_k cos(k phi) + sin_k sin(k phi))``, phi the azimuth in T.

    ``orders`` are the whole numbers k, ``cos`` and ``sin`` the amplitudes, one for each.
    """

    bumps: Annotated[int, Field(strict=True, ge=2, le=10_000)]
    mean_radius: Annotated[Quantity, measured("m")]
    orders: Annotated[list[Annotated[int, Field(strict=True, ge=1)]], Field(min_length=1)]
    cos: Annotated[Quantity, measured("m", ANY)]
    sin: Annotated[Quantity, measured("m", ANY)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        PLACE.check("mean_radius", self.mean_radius)
        for name, amplitudes in (("cos", self.cos), ("sin", self.sin)):
            if amplitudes.array.size != len(self.orders):
                expected = f"{len(self.orders)}, one for each order"
                raise EntryError(f"{name} has {amplitudes.array.size} amplitudes", key=(name,), expected=expected)
        if len(self.orders) > MAX_HARMONICS:
            raise EntryError(f"{len(self.orders)} orders", key=("orders",), expected=f"at most {MAX_HARMONICS}")
        if len(set(self.orders)) != len(self.orders):
            raise EntryError(f"orders {self.orders} repeat", key=("orders",), expected="each order once")
        if self.bumps not in self.orders:
            expected = f"{self.bumps} among them, the order of the bumps themselves"
            raise EntryError(f"orders {self.orders}", key=("orders",), expected=expected)
        return self


class BumpyRingCalibration(SensorCalibration):
    """A bumpy ring, its probes, and theta at its home mark."""

    type: Literal["bumpy_ring"]
    ring: RingSurfaceCalibration
    home: Annotated[Quantity, measured("rad")]
    probes: Annotated[list[ProbeCalibration], Field(min_length=3, max_length=8)]

    @model_validator(mode="after")
    def _check_phases(self) -> Self:
        # The slopes of all bumps vanish at one theta where the phases agree modulo half a bump.
        if abs(np.mean(np.exp(4j * math.pi * self.phases))) > IN_PHASE:
            listed = ", ".join(f"{phase:.2f}" for phase in self.phases)
            what = f"with {self.ring.bumps} bumps, the probes are at the phases {listed} of a bump: all in phase"
            expected = "phases spread over half a bump, so that some probe sees a slope at every theta"
            raise EntryError(what, key=("probes",), expected=expected)
        return self

    @property
    def phases(self) -> FloatArray:
        """Phase of each probe at theta = 0 in bumps, 0 to 1, shape (probes,)."""
        tips = np.array([probe.tip.array[:2] for probe in self.probes])
        return np.asarray(np.mod(np.arctan2(tips[:, 1], tips[:, 0]) * self.ring.bumps / (2.0 * math.pi) + 1e-9, 1.0))

    def build(self) -> BumpyRing:
        """Return the sensor."""
        return BumpyRing(self)

    @property
    def bump_angle(self) -> float:
        """Angle of one bump [rad]."""
        return 2.0 * math.pi / self.ring.bumps

    @property
    def home_theta(self) -> float:
        """Theta at the home mark [rad]."""
        return self.home.number


class BumpyRing(ProbeSensor):
    """Ring probes and the ring that they see."""

    KIND, VOLTAGES = "ring", RING_VOLTAGES

    def __init__(self, calibration: BumpyRingCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        ring = calibration.ring
        self._orders = np.array(ring.orders, dtype=float)
        self.bumps = ring.bumps
        super().__init__(
            calibration.probes,
            {"mean_radius": ring.mean_radius.array, "cos": ring.cos.array, "sin": ring.sin.array},
            {"mean_radius": ring.mean_radius.sigmas, "cos": ring.cos.sigmas, "sin": ring.sin.sigmas},
        )

    def _layout(self) -> tuple[NDArray[np.void], IntArray]:
        harmonics = len(self._orders)
        rows = np.zeros(len(self._probes), dtype=ROW)
        rows["kind"], rows["harmonics"] = RING, harmonics
        rows["orders"][:, :harmonics] = self._orders
        of_row = no_parameters(len(rows))
        of_row["tip"], of_row["axis"] = self.parameter_ids("tips"), self.parameter_ids("axes")
        of_row["mean_radius"] = self.parameter_ids("mean_radius")
        of_row["cosines"][:, :harmonics] = self.parameter_ids("cos")
        of_row["sines"][:, :harmonics] = self.parameter_ids("sin")
        return rows, of_row["parameters"]

    def observability(self, phases: FloatArray) -> FloatArray:
        """Return how well the ring's readings tell (x, y, theta) apart at each bump phase.

        ``phases``: bump phases [rad, 2 pi to a bump], shape (n,), at theta = phase / bumps, no runout. Returns the
        smallest over the largest singular value of the readings' sensitivity to x, y and theta times the mean radius,
        shape (n,): zero is blind.
        """
        out = np.empty(len(phases))
        radius = float(self._array("mean_radius"))
        for n, phase in enumerate(phases):
            theta = phase / self.bumps
            rotation = np.array(
                [[math.cos(theta), -math.sin(theta), 0.0], [math.sin(theta), math.cos(theta), 0.0], [0.0, 0.0, 1.0]]
            )
            jacobian = evaluate_rows(self.rows, rotation, np.zeros(3))[1]
            spread = np.linalg.svd(jacobian[:, [0, 1, 5]] / np.array([1.0, 1.0, radius]), compute_uv=False)
            out[n] = spread[2] / spread[0]
        return out
