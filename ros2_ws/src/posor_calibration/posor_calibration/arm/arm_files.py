# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of a calibrated arm: URDF, beams file, plain URDF for the controller of the robot, arm file, numbers as JSON.

A POSOR's error is constant in the axes of its receiving plate, so its correction is that of the beam or fixed joint
before it. The plain URDF has a continuous joint in place of each POSOR, and the mean sag: any program computes the
endpoint with it from joint angles.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from posor.calibration.edit import edit_document
from posor.calibration.save import refuse_existing, save_files
from posor.calibration.yaml_document import parse_document, read_text
from posor.chain.beams_file import FILE_KIND, FORMER_VERSIONS, VERSION, BeamsFile, load_beams
from posor.chain.kinematic_chain import Chain
from posor.chain.urdf_file import read_urdf
from posor.chain.urdf_plates import links_are_plates, rotation_to, rpy_text
from posor.errors import ChainError
from posor.output_files import make_folder
from posor.reporting.json_text import json_text
from scipy.linalg import eigh

from posor_calibration.arm.arm_fit import NAME

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.chain.urdf_plates import UrdfJoint
    from posor.numerics.array_types import FloatArray

    from posor_calibration.arm.arm_fit import ArmCalibration, ArmProblem
    from posor_calibration.arm.arm_model import ArmModel, ArmPoses, ArmStates

JSON_FILE, CONTROLLER_FILE = "arm_calibration.json", "controller.urdf"
REPRODUCED = 1e-7  # largest difference of the written files from the fit [m]
_ENLARGEMENT, _MOST_ENLARGEMENTS = 1.25, 20
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


class Provenance(NamedTuple):
    """Origin of a calibration."""

    date: str  # UTC, ISO 8601
    sources: Mapping[str, str]  # SHA-256 of each file that was read, by its path


class Deviation(NamedTuple):
    """How far endpoints are from those of the calibrated arm, over the poses."""

    position: float  # root mean square [m]
    orientation: float  # [rad]
    largest: float  # [m]

    @staticmethod
    def of(fitted: Sequence[pin.SE3], others: Sequence[pin.SE3]) -> Deviation:
        """Return the deviation of endpoints."""
        errors = np.array([pin.log6(a.actInv(b)).vector for a, b in zip(fitted, others, strict=True)])
        shifts, turns = (np.linalg.norm(errors[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (shifts, turns)]
        return Deviation(rms[0], rms[1], float(shifts.max()))


class Correction(NamedTuple):
    """Mean error of a link, from one POSOR (or the base) to the next (or the endpoint), which the new files contain."""

    joint: str | None  # beam or fixed joint of the URDF that holds it; None: the link has none, the base holds it
    T: pin.SE3  # after the origin of this joint
    covariance: FloatArray  # axes of the joint's start, (6, 6)
    sag: float  # factor of the sag
    sag_sigma: float


def corrections_of(
    model: ArmModel, calibration: ArmCalibration, states: ArmStates, endpoint_frame: str
) -> list[Correction]:
    """Return the corrections of the links from the base; those of shared terms are means over the poses.

    Raises ChainError: there is no fixed joint before a POSOR, which could hold its correction.
    """
    count = len(model.parameters)
    covariance = calibration.covariance[:count, :count]
    errors = model.with_mean_effects(states).errors[0]
    errors[:, :, list(model.sags.values())] = 0.0
    means = dict(zip((each.name for each in model.elements), errors, strict=True))
    joints = {joint.name: joint for joint in read_urdf(model.chain.urdf, endpoint_frame, "the URDF")[0].joints}
    by_child = {joint.child: joint for joint in joints.values()}
    found = []
    for number, link in enumerate(model.chain.links):
        posor = model.joints[number] if number < len(model.joints) else None
        name, behind, effect = None, link.after, np.zeros((6, count))
        if link.beam is not None:
            name, effect = link.beam.name, means[link.beam.name]
        elif posor is not None:
            name, behind = _fixed_before(joints[posor], by_child)
        if posor is not None:
            behind = behind * pin.SE3(np.eye(3), model.origins[number])
            effect = effect + behind.toActionMatrix() @ means[posor]
        if name is None and 0 < number < len(model.joints):
            what = f"has no fixed joint before POSOR '{posor}', for its correction"
            raise ChainError(what, where="the URDF", expected="a fixed joint between two POSORs")
        turn = np.kron(np.eye(2), np.eye(3) if name is None else joints[name].T_parent_joint.rotation) @ effect
        own = model.sags.get(str(name))
        sag = (1.0, 0.0) if own is None else (1.0 + float(calibration.values[own]), float(calibration.sigmas[own]))
        error = pin.exp6(effect @ calibration.values[:count])
        found.append(Correction(name, error, turn @ covariance @ turn.T, *sag))
    return found


def _fixed_before(posor: UrdfJoint, by_child: Mapping[str, UrdfJoint]) -> tuple[str | None, pin.SE3]:
    """Return the fixed joint next before a POSOR, and the receiving plate in its child; None: there is none."""
    behind = pin.SE3.Identity()
    if not links_are_plates(posor):
        behind = posor.T_parent_joint * pin.SE3(rotation_to(posor.axis), np.zeros(3))
    before = by_child.get(posor.parent)
    return (before.name if before is not None and before.kind == "fixed" else None), behind


def edit_urdf(text: str, origins: Mapping[str, pin.SE3], note: str, *, kinds: Mapping[str, str] | None = None) -> str:
    """Return a URDF with other origins, and other types of joints, ``kinds``; all else stays as it is.

    Raises ChainError: a joint is not found.
    """
    masked = _COMMENT.sub(lambda match: " " * len(match[0]), text)
    changes: list[tuple[int, int, str]] = []
    for name, place in origins.items():
        element = re.search(rf"<joint\b[^>]*\bname\s*=\s*([\"']){re.escape(name)}\1[^>]*>", masked)
        end = -1 if element is None else masked.find("</joint", element.end())
        if element is None or end < 0:
            raise ChainError(f"joint '{name}' is not found", where="the URDF", expected="<joint name=...>...</joint>")
        origin = re.compile(r"<origin\b[^>]*?(/>|>\s*</origin\s*>)").search(masked, element.end(), end)
        xyz = " ".join(map(repr, place.translation.tolist()))
        new = f'<origin xyz="{xyz}" rpy="{rpy_text(place.rotation)}"/>'
        changes.append(
            (origin.start(), origin.end(), new) if origin else (element.end(), element.end(), f"\n    {new}")
        )
        if kinds:
            kind = re.search(r"\btype\s*=\s*([\"'])\w+\1", element[0])
            assert kind is not None  # noqa: S101  the URDF has been read
            begin = element.start() + kind.start()
            changes.append((begin, element.start() + kind.end(), f'type="{kinds[name]}"'))
            if kinds[name] != "fixed" and not re.compile(r"<axis\b").search(masked, element.end(), end):
                changes.append((end, end, '  <axis xyz="0 0 1"/>\n  '))
    robot = re.search(r"<robot\b[^>]*>", masked)
    assert robot is not None  # noqa: S101  the same
    changes.append((robot.end(), robot.end(), f"\n  <!-- {note.replace('--', '-')} -->"))
    for begin, end, new in sorted(changes, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def controller_urdf(chain: Chain, endpoint_frame: str, poses: ArmPoses, note: str) -> str:
    """Return a plain URDF of a chain, with its mean over poses."""
    bends: dict[str, list[FloatArray]] = {link.beam.name: [] for link in chain.links if link.beam is not None}
    for row in poses.transforms:
        turn = np.eye(3)
        for number, link in enumerate(chain.links):
            turn = turn @ link.before.rotation
            if link.beam is not None:
                bent = link.beam.T_start_end.actInv(link.beam.T_under(turn.T @ chain.gravity))
                bends[link.beam.name].append(pin.log6(bent).vector)
                turn = turn @ link.beam.T_start_end.rotation
            turn = turn @ link.after.rotation
            if number < len(chain.path_joints):
                turn = turn @ pin.XYZQUATToSE3(row[number]).rotation
    joints = {joint.name: joint for joint in read_urdf(chain.urdf, endpoint_frame, "the URDF")[0].joints}
    origins = {name: joints[name].T_parent_joint * pin.exp6(np.mean(own, axis=0)) for name, own in bends.items()}
    kinds = dict.fromkeys(origins, "fixed")
    for number, posor in enumerate(chain.path_joints):
        drawn = [chain.nominal_joint(posor.name, angle) for angle in poses.angles[:, number]]
        seen = map(pin.XYZQUATToSE3, poses.transforms[:, number])
        errors = [pin.log6(T * nominal.inverse()).vector for T, nominal in zip(seen, drawn, strict=True)]
        mean, own = pin.exp6(np.mean(errors, axis=0)), joints[posor.name]
        to_plate = pin.SE3(rotation_to(own.axis), np.zeros(3))
        is_plate = links_are_plates(own)
        origins[posor.name] = (
            mean * own.T_parent_joint if is_plate else own.T_parent_joint * to_plate * mean * to_plate.inverse()
        )
        kinds[posor.name] = "continuous"
    return edit_urdf(chain.urdf, origins, note, kinds=kinds)


def plain_endpoints(urdf: str, endpoint_frame: str, joints: Sequence[str], angles: FloatArray) -> list[pin.SE3]:
    """Return the endpoints by pinocchio alone; ``angles``: of the joints [rad], (n, j)."""
    model: pin.Model = pin.buildModelFromXML(urdf)
    data, frame = model.createData(), model.getFrameId(endpoint_frame, pin.FrameType.BODY)
    found = []
    for row in angles:
        q = pin.neutral(model)
        for name, angle in zip(joints, row, strict=True):
            begin = model.joints[model.getJointId(name)].idx_q
            q[begin : begin + 2] = math.cos(angle), math.sin(angle)
        pin.framesForwardKinematics(model, data, q)
        found.append(data.oMf[frame].copy())
    return found


@dataclass(frozen=True)
class CalibratedFiles:
    """Texts of the files of a calibrated arm, by name, and how they agree with the fit."""

    texts: Mapping[str, str]
    T_reference_base: pin.SE3
    enlarged: float  # factor of the uncertainties of the beams file, so that they cover those of the fit
    files: Deviation  # of URDF and beams file with the POSORs: effects of shared terms vary from pose to pose
    controller: Deviation  # of the plain URDF with joint angles alone


def make_files(
    arm: ArmFile, problem: ArmProblem, calibration: ArmCalibration, poses: ArmPoses, origin: Provenance
) -> CalibratedFiles:
    """Return the files of an arm, which contain a calibration, compared with it at the temperature of the URDF.

    Raises ChainError: the URDF cannot hold the corrections; PosorError: a file cannot be read.
    """
    model = problem.model
    states = model.states(poses.at_reference(), model.effects_at(poses))
    corrections = corrections_of(model, calibration, states, arm.endpoint_frame)
    joints = {joint.name: joint for joint in read_urdf(model.chain.urdf, arm.endpoint_frame, str(arm.urdf))[0].joints}
    note = f"posor calibrate-arm, {origin.date}, from {', '.join(f'{p} {sha}' for p, sha in origin.sources.items())}"
    origins = {each.joint: joints[each.joint].T_parent_joint * each.T for each in corrections if each.joint is not None}
    urdf = edit_urdf(model.chain.urdf, origins, note)
    lengths = {name: (_length(joints[name].T_parent_joint), _length(place)) for name, place in origins.items()}
    motion = model.move(states, calibration.values, problem.T_reference_base)
    count = len(model.parameters)
    of_arm = motion.by_parameter[:, :, 6:]  # without the base in the frame of the references
    covariances = of_arm @ calibration.covariance[6:count, 6:count] @ of_arm.swapaxes(1, 2)
    covariances += np.einsum("njab,njbc,njdc->nad", motion.by_joint, states.own, motion.by_joint)
    enlarged = 1.0
    for _ in range(_MOST_ENLARGEMENTS):
        beams_text = "" if arm.beams is None else _beams_text(arm.beams, corrections, lengths, enlarged, origin)
        beams = None if arm.beams is None else _parse_beams(beams_text)
        chain = Chain(urdf, arm.endpoint_frame, beams, source="the new URDF", beams_source="the new beams file")
        found = chain.estimate_all(poses.transforms, poses.random, poses.systematic)
        ends = [pin.XYZQUATToSE3(pose) for pose in found.poses]
        ratio = max(
            float(eigh(fit_covariance, _in_axes(stated, end.rotation.T), eigvals_only=True)[-1])
            for fit_covariance, stated, end in zip(covariances, found.covariances(), ends, strict=True)
        )
        if ratio <= 1.0 or arm.beams is None:
            break
        enlarged *= _ENLARGEMENT
    alike = model.move(model.with_mean_effects(states), calibration.values, problem.T_reference_base).endpoints
    base = alike[0] * ends[0].inverse()
    in_base = [base.actInv(place) for place in motion.endpoints]
    worst = Deviation.of([base.actInv(place) for place in alike], ends).largest
    if not worst <= REPRODUCED:
        what = f"the new files differ from the fit by {worst:.3g} m"
        raise ChainError(what, where=NAME, expected=f"at most {REPRODUCED:g}")
    controller = controller_urdf(chain, arm.endpoint_frame, poses, "plain: mean of the POSORs and of the sag")
    plain = plain_endpoints(controller, arm.endpoint_frame, model.joints, poses.angles)
    texts = {arm.urdf.name: urdf, CONTROLLER_FILE: controller}
    changes: dict[str, Any] = {
        f"joints.{name}.calibration": str(path.absolute()) for name, path in arm.calibrations.items()
    }
    changes["urdf"] = arm.urdf.name
    for key, path in (("scenario", arm.scenario), ("commissioning", arm.commissioning)):
        if path is not None:
            changes[key] = str(path.absolute())
    if arm.beams is not None:
        texts[arm.beams.name], changes["beams"] = beams_text, arm.beams.name
    texts[arm.path.name] = edit_document(read_text(arm.path, "arm file"), str(arm.path), changes)
    deviations = Deviation.of(in_base, ends), Deviation.of(in_base, plain)
    return CalibratedFiles(texts, base, enlarged, *deviations)


def _parse_beams(text: str) -> BeamsFile:
    return parse_document(text, "the new beams file", "", (*FORMER_VERSIONS, VERSION), BeamsFile.model_validate)[0]


def _length(place: pin.SE3) -> float:
    return float(np.linalg.norm(place.translation))


def _in_axes(covariance: FloatArray, rotation: FloatArray) -> FloatArray:
    turn = np.kron(np.eye(2), rotation)
    return np.asarray(turn @ covariance @ turn.T)


def _beams_text(
    path: Path,
    corrections: Sequence[Correction],
    lengths: Mapping[str, tuple[float, float]],
    enlarged: float,
    origin: Provenance,
) -> str:
    """Return the beams file with new uncertainties and sags, without shared terms: the new uncertainties hold them.

    ``lengths``: of the beams before and after [m]; gimbals and plates keep their relative places.
    """
    text, beams = read_text(path, FILE_KIND), load_beams(path)
    numbers = {beam.joint: n for n, beam in enumerate(beams.beams)}
    notes = [f"from {name}, SHA-256 {sha}" for name, sha in origin.sources.items()]
    method = "posor calibrate-arm; uncertainties contain those of the POSORs behind the beams"
    changes: dict[str, Any] = {
        "provenance": {
            "source": f"calibration of the whole arm, former: {beams.name}",
            "method": method,
            "date": origin.date,
            "notes": notes,
        }
    }
    if beams.shared:
        changes["shared"] = {}
    for each in corrections:
        if each.joint not in numbers:
            continue
        key, sigmas = f"beams[{numbers[each.joint]}]", enlarged * np.sqrt(np.diagonal(each.covariance))
        for name, part, unit in (("position", sigmas[:3], "m"), ("orientation", sigmas[3:], "rad")):
            changes[f"{key}.uncertainty.{name}"] = {"value": [float(f"{x:.4g}") for x in part], "unit": unit}
        sag = beams.beams[numbers[each.joint]].sag
        if sag is not None:
            modulus, unit = sag.tube.modulus.number / each.sag, sag.tube.modulus.unit
            before, after = lengths[str(each.joint)]
            places = [(f"{key}.sag.plates[{k}].at", plate.at.number) for k, plate in enumerate(sag.plates)]
            for where, at in places:
                changes[where] = {"value": min(at * after / before, after), "unit": "m"}
            gimbals = np.minimum(sag.gimbals.array * after / before, after).tolist()
            changes[f"{key}.sag.gimbals"] = {"value": gimbals, "unit": "m"}
            changes[f"{key}.sag.tube.modulus"] = {"value": modulus, "unit": unit}
            changes[f"{key}.sag.uncertainty"] = {"value": float(f"{enlarged * each.sag_sigma:.4g}"), "unit": "1"}
    return edit_document(text, str(path), changes)


def calibration_json(calibration: ArmCalibration, files: CalibratedFiles, origin: Provenance) -> str:
    """Return all numbers of a calibration."""
    content = {
        "format": "posor_arm_calibration",
        "version": 1,
        **origin._asdict(),
        "T_reference_base": pin.SE3ToXYZQUAT(files.T_reference_base).tolist(),
        "parameters": [
            {**each._asdict(), "value": value, "standard_uncertainty": sigma}
            for each, value, sigma in zip(
                calibration.parameters, calibration.values.tolist(), calibration.sigmas.tolist(), strict=True
            )
        ],
        "covariance": calibration.covariance.tolist(),
        "spread": calibration.spread,
        "undetermined": calibration.undetermined,
        "outliers": calibration.outliers,
        "before": {name: each._asdict() for name, each in calibration.before.items()},
        "after": {name: each._asdict() for name, each in calibration.after.items()},
        "deviation": {"files": files.files._asdict(), "controller": files.controller._asdict()},
        "beams_uncertainty_factor": files.enlarged,
        "warnings": calibration.warnings,
    }
    return json_text(content, indent=1)


def check_output(folder: Path, arm: ArmFile, *, force: bool) -> None:
    """Refuse existing files before the calibration. Raises CalibrationError: there is one, and not ``force``."""
    names = (arm.path, arm.urdf, arm.beams)
    for name in (*(path.name for path in names if path is not None), CONTROLLER_FILE, JSON_FILE):
        if (folder / name).exists():
            refuse_existing(folder / name, force=force)


def save_arm(folder: Path, texts: Mapping[str, str], *, force: bool) -> list[Path]:
    """Write files, all or none; return where the replaced ones are kept. Raises CalibrationError, OutputError."""
    make_folder(folder)
    return save_files({folder / name: text for name, text in texts.items()}, force=force)
