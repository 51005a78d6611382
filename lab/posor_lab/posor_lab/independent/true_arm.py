# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of an arm by its files: the URDF by pinocchio, sag by finite elements, warm beams slice by slice."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from posor_lab.independent.file_values import read_file, si_values
from posor_lab.independent.finite_elements import GimballedBeam, sag_gains, vibration_gains
from posor_lab.independent.true_joint import TrueJoint

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)  # [m/s^2], ISO 80000-3
_SLICES = 256  # of a warm beam
_SAG_STEPS = 3
"""Steps to the direction of gravity in the line of the gimbals, from that in the plate: each gains a factor of 1e4."""


@dataclass(frozen=True)
class TrueLink:
    """From the target plate of a joint (or the base) to the receiving plate of the next one (or the endpoint)."""

    before: pin.SE3  # from that plate to the start of the beam
    end: pin.SE3  # from the start of the beam to its end, without sag
    after: pin.SE3  # from there to the next plate
    start_gain: FloatArray  # motion of the plate at the start for 1 m/s^2 along each axis of the start, (6, 3)
    end_gain: FloatArray  # the same of the plate at the end
    expansion: float = 0.0  # coefficient of the beam [1/K]
    width: float = 1.0  # of the beam [m]
    sag: Any = None  # ``sag`` of the beam in the beams file
    damping: float = 0.0  # of the first mode, share of the critical one

    @property
    def first_frequency(self) -> float:
        """First natural frequency of the beam [Hz], by finite elements; only of a beam with ``sag``."""
        return GimballedBeam(float(np.linalg.norm(self.end.translation)), self.sag).first_frequency

    def vibration_gains(self, frequencies: FloatArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the motions of the plates at start and end in steady vibration, by finite elements, (m, 6, 6) each."""
        return vibration_gains(self.end.translation, self.sag, self.damping, frequencies)

    def warm_ends(self, deviations: FloatArray, across: FloatArray, excess: float) -> tuple[FloatArray, FloatArray]:
        """Return the end without sag in the start, (n, 3, 3), (n, 3) [m], at temperatures from that of the URDF.

        ``deviations``: means [K], (n,); ``across``: differences between opposite sides in two directions [K], (2,);
        ``excess``: relative error of the coefficient. Each slice grows, and turns from its warm side to its cold side.
        """
        length, span = float(np.linalg.norm(self.end.translation)), self.end.translation
        coefficient = self.expansion * (1.0 + excess)
        frame = Rotation.align_vectors([span], [[length, 0.0, 0.0]])[0].as_matrix()  # X along the beam
        turn = coefficient * length / self.width / _SLICES * np.array([0.0, across[1], -across[0]])
        step = np.tile(np.eye(4), (len(deviations), 1, 1))
        step[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
        half = np.zeros((len(deviations), 3))
        half[:, 0] = 0.5 * length / _SLICES * (1.0 + coefficient * deviations)
        step[:, :3, 3] = half + half @ step[0, :3, :3].T
        grown = np.linalg.matrix_power(step, _SLICES)
        rotations = frame @ grown[:, :3, :3] @ frame.T @ self.end.rotation
        return rotations, grown[:, :3, 3] @ frame.T


class TrueArm:
    """An arm as its files describe it.

    Attributes:
        joints: Names of the floating joints, from the base to the endpoint.
        origins: Pose of each in its receiving plate.
        links: One more than joints.
        gravity: In the base [m/s^2], (3,).

    """

    def __init__(self, path: Path | str) -> None:
        """Read an arm file and the files that it names."""
        arm = read_file(path)
        folder = Path(path).resolve().parent
        self._files = {
            name: (folder / joint["calibration"], joint.get("session", "")) for name, joint in arm["joints"].items()
        }
        self._known: dict[str, TrueJoint] = {}
        beams = read_file(folder / arm["beams"]) if arm.get("beams") else {"beams": []}
        gravity = beams.get("gravity")
        self.gravity = np.array(STANDARD_GRAVITY) if gravity is None else si_values(gravity, "m/s^2")
        model = pin.buildModelFromUrdf(str(folder / arm["urdf"]))
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        frames = model.frames

        def place(frame: int) -> pin.SE3:
            return data.oMf[frame]

        def link_before(frame: int) -> int:
            while frames[frame].type != pin.FrameType.BODY:
                frame = frames[frame].parentFrame
            return int(frame)

        end = model.getFrameId(arm.get("endpoint_frame", "endpoint"), pin.FrameType.BODY)
        entries = {beam["joint"]: beam for beam in beams["beams"]}
        joints, origins, links = [], [], []
        last, frame = end, end  # last: the plate at which the present link ends
        beam: tuple[str, int, int] | None = None  # name, frame of its start, frame of its end
        while frame > 0:
            kind, name = frames[frame].type, frames[frame].name
            if kind == pin.FrameType.FIXED_JOINT and name in entries:
                beam = name, link_before(frames[frame].parentFrame), frame
            elif kind == pin.FrameType.JOINT:
                links.append(_link(place(frame), place(last), beam, place, entries))
                last, beam = link_before(frames[frame].parentFrame), None
                joints.append(name)
                origins.append(place(last).actInv(place(frame)))
            frame = frames[frame].parentFrame
        links.append(_link(pin.SE3.Identity(), place(last), beam, place, entries))
        self.joints: tuple[str, ...] = tuple(joints[::-1])
        self.origins: tuple[pin.SE3, ...] = tuple(origins[::-1])
        self.links: tuple[TrueLink, ...] = tuple(links[::-1])

    def joint(self, name: str, errors: Mapping[str, float] | None = None) -> TrueJoint:
        """Return a joint that differs from its calibration file by errors, see ``TrueJoint.with_errors``."""
        if name not in self._known:
            path, session = self._files[name]
            self._known[name] = TrueJoint(read_file(path), session)
        return self._known[name].with_errors(errors or {})

    def endpoints(self, rotations: FloatArray, translations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the endpoint in the base, (n, 3, 3), (n, 3) [m], of n scans without errors.

        ``rotations``, ``translations``: poses of the target plates in the receiving plates, (n, j, 3, 3), (n, j, 3)
        [m]. A plate sags from the line through the gimbals of its beam, and gravity acts on that line: the line is
        found from the plate by iteration.
        """
        count = len(rotations)
        place = np.tile(np.eye(4), (count, 1, 1))
        for i, link in enumerate(self.links):
            start = place @ link.before.homogeneous
            line = start
            for _ in range(_SAG_STEPS):
                sag = _motions(link.start_gain, self._field(line))
                line = start @ np.linalg.inv(sag)
            sagged = _motions(link.end_gain, self._field(line))
            end = np.tile(link.end.homogeneous, (count, 1, 1))
            end[:, :3, :3] = sagged[:, :3, :3] @ end[:, :3, :3]
            end[:, :3, 3] += sagged[:, :3, 3]
            place = line @ end @ link.after.homogeneous
            if i < len(self.joints):
                seen = np.tile(np.eye(4), (count, 1, 1))
                seen[:, :3, :3], seen[:, :3, 3] = rotations[:, i], translations[:, i]
                place = place @ seen
        return place[:, :3, :3], place[:, :3, 3]

    def with_links(self, links: Sequence[TrueLink]) -> TrueArm:
        """Return the same arm with other links."""
        other = copy(self)
        other.links = tuple(links)
        return other

    def _field(self, line: FloatArray) -> FloatArray:
        """Return gravity in the axes of frames (n, 4, 4), (n, 3)."""
        return np.asarray(np.einsum("nji,j->ni", line[:, :3, :3], self.gravity))


def _motions(gain: FloatArray, field: FloatArray) -> FloatArray:
    """Return the motions of a plate in fields (n, 3), (n, 4, 4)."""
    motion = field @ gain.T
    out = np.tile(np.eye(4), (len(field), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = Rotation.from_rotvec(motion[:, 3:]).as_matrix(), motion[:, :3]
    return out


def _link(begin: pin.SE3, end: pin.SE3, beam: tuple[str, int, int] | None, place: Any, entries: Any) -> TrueLink:
    """Return the link between two places in the base, with all joints in their neutral position."""
    if beam is None:
        return TrueLink(begin.actInv(end), pin.SE3.Identity(), pin.SE3.Identity(), np.zeros((6, 3)), np.zeros((6, 3)))
    name, first, last = beam
    straight = place(first).actInv(place(last))
    sag, heat = entries[name].get("sag"), entries[name].get("temperature") or {}
    gains = (np.zeros((6, 3)),) * 2 if sag is None else sag_gains(straight.translation, sag)
    width = (heat.get("gradient") or {}).get("width") or (sag and sag["tube"]["outer_diameter"])
    expansion = float(si_values(heat["coefficient"], "1/K")) if heat else 0.0
    width_m = float(si_values(width, "m")) if width else 1.0
    vibration = entries[name].get("vibration")
    damping = float(si_values(vibration["damping"], "1")) if vibration else 0.0
    places = begin.actInv(place(first)), straight, place(last).actInv(end)
    return TrueLink(*places, *gains, expansion, width_m, sag, damping)
