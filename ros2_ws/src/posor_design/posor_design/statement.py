# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The statement of an endpoint's uncertainty: all that a customer needs, and where each number comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.parameter_entries import parameter_entries
from posor.chain.commissioning_record import load_record
from posor.chain.identity import ArmIdentity, calibration_id, file_sha256
from posor.uncertainty.budget_poses import scan_at
from posor.uncertainty.budget_quantities import physical_quantities
from posor.uncertainty.protection_level import ArmReliability, arm_reliability
from posor.uncertainty.reading_sensitivity import sensitivity_at

from posor_design.endpoint_components import ArmPropagation, Component, Kind
from posor_design.reliability_report import AXES
from posor_design.statement_records import ARM, BAG, BEAMS, PATH, Origin, Records, calibration_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

    from posor_design.arm_uncertainty import ArmUncertainty, EndpointUncertainty
    from posor_design.statement_poses import StatementPoses

NO_SHARE = 1e-3
"""Smaller shares of a rectangular distribution in the variance do not change the coverage."""
SHORT = 3  # names of quantities that a sentence lists


@dataclass(frozen=True)
class LargestQuantity:
    """The calibrated quantity that contributes most of a joint's systematic uncertainty of the position."""

    name: str
    share: float  # of the joint's own systematic variance of the position
    origin: Origin


@dataclass(frozen=True)
class Condition:
    """A condition of the measurement, and where it is stated."""

    name: str
    text: str
    origin: Origin | str  # place in a record, an option, or a sentence


@dataclass(frozen=True)
class Statement:
    """All parts of a statement."""

    arm: ArmFile
    identity: str  # SHA-256 of the arm, see ``chain.identity``
    issued: str  # UTC, ISO 8601
    software: str
    base_frame: str
    worst: EndpointUncertainty  # at the pose that the statement is about
    name: str  # what this pose is
    poses: Sequence[EndpointUncertainty]  # at all poses, ``worst`` among them
    names: Sequence[str]
    origins: Sequence[Origin]  # of the components of ``worst``
    largest: Mapping[str, LargestQuantity]  # by joint
    reliability: ArmReliability
    level_origins: Sequence[Origin]  # of the bounds of the causes that set the protection level
    conditions: Sequence[Condition]
    reservations: Sequence[str]  # sentences on what is not in the numbers
    records: Records

    @property
    def level_axis(self) -> int:
        """Axis of the position with the largest protection level, 0 to 2."""
        return int(np.argmax(self.reliability.protection_level[:3]))

    def share_of(self, *, kind: Kind | None = None, source: str | None = None) -> float:
        """Return the share of the components of a kind or a source in the summed variances of x, y and z."""
        shares = zip(self.worst.components, self.worst.position_shares(), strict=True)
        return float(
            sum(share for each, share in shares if kind in (None, each.kind) and source in (None, each.source))
        )

    def sentences(self) -> list[str]:
        """Return how the expanded uncertainty is meant (JCGM 100, 7.2.3 and 7.2.4)."""
        worst = self.worst
        factors = ", ".join(f"{k:.2f} for {axis}" for k, axis in zip(worst.factors, AXES, strict=True))
        low, high = worst.factors.min(), worst.factors.max()
        which = f"k = {low:.2f}" if high - low < 5e-3 else f"k ({factors})"  # noqa: PLR2004  two decimals
        found = [
            (
                "Each stated expanded uncertainty U is the combined standard uncertainty u multiplied by the coverage "
                f"factor {which}, which for a t distribution with the effective degrees of freedom corresponds to "
                "a coverage probability of approximately 95 % (JCGM 100:2008, 7.2.3 and G.4)."
            ),
            (
                "The ellipsoid contains the position with a probability of approximately 95 % (coverage factor "
                f"{worst.ellipsoid_factor:.2f}, JCGM 102:2011, 6.5)."
            ),
        ]
        if np.isinf(worst.freedoms).all():
            found.append(
                "All effective degrees of freedom are infinite: every contribution is a stated value or bound, "
                "evaluated as type B with a known uncertainty (JCGM 100, G.4.3); none is the scatter of few readings."
            )
        rectangular = self.share_of(kind=Kind.TEMPERATURE) + self.share_of(kind=Kind.STAMPS)
        if rectangular > NO_SHARE:
            found.append(
                f"{100.0 * rectangular:.3g} % of the variance of the position has rectangular distributions, from "
                "stated bounds (JCGM 100, 4.3.7); where they dominate, the coverage probability is more than 95 %."
            )
        return found


def make_statement(
    arm: ArmFile, model: ArmUncertainty, poses: StatementPoses, records: Records, scans: int
) -> Statement:
    """Return the statement about the pose with the largest uncertainty of the position.

    ``scans``: number of scans whose mean is the result. Raises PosorError: a POSOR has no valid pose at its angle, or
    a file is invalid.
    """
    shifts, notes = poses.stamp_shifts, list(poses.notes)
    if shifts is not None and not np.isfinite(shifts).all():
        shifts = None
        notes.append("The errors of the stamps are not bounded (no limits of motion are stated) and not in U.")
    found = model.at(poses.angles, scans=scans, observed=poses.observed, stamp_shifts=shifts)
    number = int(np.argmax([each.largest for each in found]))
    worst = found[number]
    reliability = arm_reliability(
        model.chain, model.calibrations, {**dict.fromkeys(model.calibrations, 0.0), **worst.angles}
    )
    largest, exact = _quantities(model, worst, records)
    identity, differences = _identity(arm, model.calibrations)
    beams = [beam.name for beam in model.chain.beams]
    return Statement(
        arm=arm,
        identity=identity,
        issued=datetime.now(UTC).isoformat(timespec="seconds"),
        software=f"posor {version('posor')}",
        base_frame=model.chain.base_frame,
        worst=worst,
        name=poses.names[number],
        poses=found,
        names=poses.names,
        origins=[_origin(each, records, beams, observed=bool(poses.observed)) for each in worst.components],
        largest=largest,
        reliability=reliability,
        level_origins=[_level_origin(model, records, *each) for each in reliability.set_by],
        conditions=[
            Condition("joint angles", _angles_text(worst.angles), _pose_origin(poses, number, records)),
            *_conditions(arm, model, records, scans, moving=shifts is not None),
        ],
        reservations=[*notes, *_reservations(arm, model, reliability), *exact, *differences],
        records=records,
    )


def _origin(component: Component, records: Records, beams: Sequence[str], *, observed: bool) -> Origin:
    source, kind = component.source, component.kind
    if kind is Kind.STAMPS or (kind is Kind.RANDOM and observed):
        return records.origin(BAG)
    role = calibration_of(source)
    if role in records:
        where = ("probes", 0, "noise") if kind is Kind.RANDOM else ()
        return records.origin(role, "sensors", 0, *where)
    if kind is Kind.SHARED:
        return next(records.origin(role, "shared", source) for role in records.all if _states(records, role, source))
    if kind is Kind.TEMPERATURE:
        return records.origin(BEAMS, "beams")
    key = ("sag", "uncertainty") if kind is Kind.SAG else ("uncertainty",)
    return records.origin(BEAMS, "beams", beams.index(source), *key)


def _level_origin(model: ArmUncertainty, records: Records, joint: str, cause: str) -> Origin:
    """Return the line that bounds a cause: an entry of the calibration, or the sensors whose default it is."""
    if joint not in model.calibrations:
        return records.origin(BEAMS if BEAMS in records else ARM, "beams")
    names = [each.name for each in model.calibrations[joint].causes]
    where = ("causes", names.index(cause)) if cause in names else ("sensors",)
    return records.origin(calibration_of(joint), *where)


def _pose_origin(poses: StatementPoses, number: int, records: Records) -> Origin | str:
    if BAG in records:
        return records.origin(BAG)
    if poses.lines:
        return replace(records.origin(PATH), line=poses.lines[number])
    return "option --angles" if len(poses.names) == 1 else f"{poses.names[number]}, option --grid"


def _angles_text(angles: Mapping[str, float]) -> str:
    listed = ", ".join(f"{name} {angle:.4f} ({math.degrees(angle):.2f}°)" for name, angle in angles.items())
    return f"{listed} rad"


def _states(records: Records, role: str, term: str) -> bool:
    return records.origin(role, "shared", term).key == f"shared.{term}"


def _quantities(
    model: ArmUncertainty, worst: EndpointUncertainty, records: Records
) -> tuple[dict[str, LargestQuantity], list[str]]:
    """Return the largest quantity of each joint, and a sentence on quantities without a stated uncertainty."""
    transforms = {name: model.chain.nominal_joint(name, worst.angles[name]) for name in model.joints}
    arm, found, exact = ArmPropagation(model.chain, transforms), {}, []
    for name, T in transforms.items():
        posor, role = model.posors[name], calibration_of(name)
        scan = scan_at(posor, T)
        gain = sensitivity_at(posor, scan, T).gain
        by_parameter = arm.joints[name][:3] @ gain @ posor.stack.residual_jacobian(scan, T.rotation, T.translation)
        root = posor.parameter_square_root
        own = root[:, : root.shape[1] - len(posor.calibration.shared)]
        entries = parameter_entries(posor.calibration, posor.calibration.session)
        variances = {}
        for quantity in physical_quantities(posor):
            where = list(quantity.parameters)
            effect = by_parameter[:, where]
            if np.any(effect) and not np.any(root[where]):
                exact.append(f"{name} {quantity.name}")
            variances[quantity.name, where[0]] = float(np.sum(np.square(effect @ own[where])))
        total = float(np.sum(np.square(by_parameter @ own)))
        (quantity_name, first), variance = max(variances.items(), key=lambda item: item[1])
        entry = entries[first]
        origin = records.origin(role) if entry is None else records.origin_of_key(role, entry.key)
        found[name] = LargestQuantity(quantity_name, variance / total if total else 0.0, origin)
    if not exact:
        return found, []
    more = f" and {len(exact) - SHORT} more" if len(exact) > SHORT else ""
    listed = ", ".join(exact[:SHORT])
    return found, [f"Calibrated quantities without a stated uncertainty are taken as exact: {listed}{more}."]


def _identity(arm: ArmFile, calibrations: Mapping[str, Calibration]) -> tuple[str, list[str]]:
    ids = {name: calibration_id(each) for name, each in calibrations.items()}
    files = ArmIdentity({}, file_sha256(arm.urdf), file_sha256(arm.beams))
    if arm.commissioning is None or not arm.commissioning.exists():
        return files.with_calibrations(ids, "").sha256, ["The arm is not commissioned: no record confirms its files."]
    commissioned = load_record(arm.commissioning).parts()
    present = files.with_calibrations(ids, commissioned.record)
    found = present.differences(commissioned)
    return present.sha256, [f"Not as commissioned: {'; '.join(found.values())}."] if found else []


def _conditions(arm: ArmFile, model: ArmUncertainty, records: Records, scans: int, *, moving: bool) -> list[Condition]:
    chain, beams = model.chain, records.origin(BEAMS, "beams") if BEAMS in records else "no beams file"
    strains = sorted({_strain(beam) for beam in chain.beams if beam.expansion.any() and not len(beam.thermal)})
    warm = "no range of the temperature of the beams is stated"
    if any(len(beam.thermal) for beam in chain.beams):
        warm = "beams within the spread of their temperature, without thermometers"
    if strains:
        warm = f"beams longer or shorter by up to {' or '.join(map(str, strains))} µm/m, all alike"
    gravity = records.origin(BEAMS, "gravity") if BEAMS in records else None
    stated = gravity if gravity and gravity.key else "standard gravity, ISO 80000-3, along -Z of the base"
    x, y, z = chain.gravity
    driver = records.origin(ARM, "driver")
    rate = arm.driver.parameters.get("rate")
    samples = arm.driver.parameters.get("conditioning.samples", 1)
    return [
        Condition("temperature", warm, beams),
        Condition("gravity", f"{x:g}, {y:g}, {z:g} m/s² in {chain.base_frame}", stated),
        Condition("motion", *(("as in the bag", records.origin(BAG)) if moving else ("the arm is at rest", "assumed"))),
        Condition("rate", "the driver's default" if rate is None else f"{rate} Hz", driver),
        Condition("scans", f"mean of {_plural(scans, 'scan')}", "option --average"),
        Condition("samples", f"mean of {_plural(samples, 'sample')} in each scan", driver),
    ]


def _plural(count: object, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _strain(beam: MeasuringBeam) -> float:
    """Return the largest expansion of a beam [µm/m]."""
    return round(1e6 * float(np.linalg.norm(beam.expansion) / np.linalg.norm(beam.T_start_end.translation)), 3)


def _reservations(arm: ArmFile, model: ArmUncertainty, reliability: ArmReliability) -> list[str]:
    chain = model.chain
    found = []
    beams = {beam.name: beam for beam in chain.beams}
    if arm.beams is None:
        found.append(
            f"{arm.path.name} names no beams file: the beams are straight and exact, so U does not contain them."
        )
    elif exact := [name for name, beam in beams.items() if not beam.covariance.any() and not beam.shared_effects]:
        found.append(f"The placement of {_listed(exact)} has no stated uncertainty: U does not contain it.")
    cold = [name for name, beam in beams.items() if not beam.expansion.any()]
    if cold:
        found.append(f"No range of the temperature of {_listed(cold)} is stated: U does not contain their expansion.")
    fixed = [
        f"{each.parent} to {each.child}" for each in chain.fixed_transforms if _is_long(each.T_parent_child.translation)
    ]
    if fixed:
        found.append(f"The URDF's fixed links {_listed(fixed)} are no beams of the beams file and are exact.")
    counted = [
        joint
        for joint in model.joints
        if model.posors[joint].counts_bumps
        and not any(key.startswith("encoder.") for key in arm.posor_parameters[joint])
    ]
    if counted:
        found.append(f"No encoder confirms the count of {_listed(counted)}: U holds if the count is right.")
    unbounded = [axis for axis, level in zip(AXES, reliability.protection_level, strict=True) if math.isinf(level)]
    if unbounded:
        joint, cause = reliability.set_by[AXES.index(unbounded[0])]
        found.append(f"An undetected fault ({joint}: {cause}) is not bounded along or about {_listed(unbounded)}.")
    return found


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else names[0]


def _is_long(translation: FloatArray) -> bool:
    return bool(np.linalg.norm(translation) > 0.0)
