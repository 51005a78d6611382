# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks all files and parameters of an arm before any node starts.

Everything that is wrong is reported at once. ``posor arm check``, ``bringup``, the launch file and all programs that
read an arm use this check.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.arm_names import find_arm
from posor.calibration.calibration_file import load_calibration
from posor.calibration.shared_terms import check_same_terms
from posor.calibration.yaml_document import FileLocations, parse_yaml, read_text
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.chain.beams_file import load_beams
from posor.chain.commissioning_record import load_record
from posor.chain.kinematic_chain import load_chain
from posor.errors import CalibrationError, ChainError, ErrorCollector, PosorError, similar_name
from posor.messages.message_definitions import MessageTypes
from posor.parameter_model import validate_parameters
from posor_drivers.driver_parameters import driver_parameters_for
from posor_drivers.instruments.instruments_file import load_instruments
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.scenario import load_scenario
from posor_drivers.sources.instrument_source import InstrumentParameters
from posor_drivers.sources.simulated_source import SimulatedParameters
from posor_drivers.sources.source import load_source_class

from posor_bringup.arm_programs import DRIVER_NODE, arm_programs, own_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain

    from posor_bringup.supervisor import Parameter, ProgramCommand


class CheckedArm(NamedTuple):
    """An arm whose files and parameters are all valid."""

    arm: ArmFile
    chain: Chain
    calibrations: Mapping[str, Calibration]  # by joint, sessions applied
    programs: Sequence[ProgramCommand]  # one for each node
    scans_per_second: int | None  # of the simulator; None: the arm has no scenario


def check_arm(
    text: str,
    *,
    namespace: str = "",
    drivers: bool = True,
    driver_parameters: Mapping[str, Parameter] | None = None,
    chain_parameters: Mapping[str, Parameter] | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    parameter_files: Sequence[Path] = (),
) -> CheckedArm:
    """Load an arm, given as for ``find_arm``, and check all its files and the parameters of its nodes.

    ``namespace`` is around that of the arm. The other arguments are those of ``arm_programs``; without ``drivers``
    their parameters and source are not checked.

    Raises PosorError: there is no such arm, or a file or a parameter is wrong. An error for several problems is a
    SeveralErrors.
    """
    path, errors = find_arm(text), ErrorCollector()
    try:
        arm = load_arm_file(path).in_namespace(namespace)
    except PosorError as error:
        errors.add(error)
        _check_named_files(path, errors)
        errors.raise_errors()
        raise
    programs: list[ProgramCommand] = []
    with errors.collecting():
        programs = arm_programs(
            arm,
            drivers=drivers,
            driver_parameters=driver_parameters,
            chain_parameters=chain_parameters,
            parameters=parameters,
            parameter_files=parameter_files,
        )
    calibrations: dict[str, Calibration] = {}
    for joint in arm.calibrations:
        with errors.collecting():
            calibrations[joint] = arm.calibration(joint)
    chain = _check_chain(arm, calibrations, errors)
    if arm.commissioning is not None and arm.commissioning.exists():  # before the first commissioning there is none
        with errors.collecting():
            _check_record(arm, arm.commissioning)
    simulated: Any = None
    scans_per_second: int | None = None
    for program in programs:
        joint = program.namespace.rpartition("/")[2]
        if program.executable == DRIVER_NODE and joint in calibrations:
            with errors.collecting():
                own = _source_parameters(program)
                simulated = own if isinstance(own, SimulatedParameters) else simulated
                load_source_class(str(program.parameters["source"]))(own, MessageTypes()).check(calibrations[joint])
                if isinstance(own, InstrumentParameters) and chain is not None:
                    _check_thermometers(arm, chain, own)
    if arm.scenario is not None:
        with errors.collecting():
            if chain is None or calibrations.keys() != arm.calibrations.keys():
                load_scenario(arm.scenario)
            else:  # each driver simulates the arm; here the errors are reported before any node starts
                own = () if simulated is None else (simulated, simulated.rate, simulated.truth)
                scans_per_second = ArmSimulation(arm, *own).scenario.ticks_per_second
    errors.raise_errors()
    return CheckedArm(arm, arm.chain() if chain is None else chain, calibrations, programs, scans_per_second)


def _check_thermometers(arm: ArmFile, chain: Chain, own: InstrumentParameters) -> None:
    """Check that the chain reads each thermometer that a driver publishes, and that of a plate from its own joint."""
    plates = {plate.thermometer.name: plate.joint for plate in chain.plates}
    beams = [beam.entry.thermometer.name for beam in chain.beams if beam.entry.thermometer is not None]
    for name, entry in load_instruments(Path(own.file)).thermometers.items():
        where = f"{own.file}, key thermometers.{name}"
        if entry.joint == own.joint and name not in plates and name not in beams:
            expected = similar_name(name, [*beams, *plates], f"a thermometer of {arm.beams or 'a beams file'}")
            raise CalibrationError("no beam and no plate has this thermometer", where=where, expected=expected)
        if entry.joint == own.joint != plates.get(name, own.joint):
            what = f"joint '{entry.joint}', but '{name}' is on the plate of '{plates[name]}' in the beams file"
            raise CalibrationError(what, where=where, expected=f"joint: {plates[name]}, and its channel")


def load_checked_arm(text: str, namespace: str = "") -> ArmFile:
    """Return an arm, given as for ``find_arm``, in a namespace, whose files are valid; the drivers are not checked.

    Raises PosorError: see ``check_arm``.
    """
    return check_arm(text, namespace=namespace, drivers=False).arm


def _source_parameters(program: ProgramCommand) -> Any:
    """Return the parameters of a driver's source."""
    parameters = own_parameters(program)
    model = validate_parameters(driver_parameters_for(parameters), parameters, node=program.name)
    return getattr(model, str(parameters["source"]))


def _check_named_files(path: Path, errors: ErrorCollector) -> None:
    """Check each file that an invalid arm file names, by itself."""
    with errors.collecting():
        _, content = parse_yaml(read_text(path, "arm file"), str(path))
        if not isinstance(content, dict):
            return
        folder, joints = path.resolve().parent, content.get("joints")
        entries = joints.values() if isinstance(joints, dict) else ()
        named = [
            *((content.get(key), load) for key, load in (("beams", load_beams), ("scenario", load_scenario))),
            (content.get("urdf"), lambda urdf: load_chain(urdf, str(content.get("endpoint_frame", "endpoint")))),
            *((each.get("calibration"), load_calibration) for each in entries if isinstance(each, dict)),
        ]
        for name, load in named:
            if isinstance(name, str) and name:
                with errors.collecting():
                    load(folder / name)


def _check_chain(arm: ArmFile, calibrations: Mapping[str, Calibration], errors: ErrorCollector) -> Chain | None:
    """Check URDF and beams by themselves and together, then against the calibrations; None: the chain is wrong."""
    plain = errors.result_of(lambda: load_chain(arm.urdf, arm.endpoint_frame))
    if arm.beams is not None:
        with errors.collecting():
            load_beams(arm.beams)
    chain = errors.result_of(arm.chain)
    for joint in () if plain is None else plain.joints:
        calibration = calibrations.get(joint.name)
        if calibration is None:
            continue
        frames = calibration.frames
        if (frames.parent, frames.child) != (joint.parent, joint.child):
            path = arm.calibrations[joint.name]
            place = FileLocations(str(path), parse_yaml(read_text(path, "calibration file"), str(path))[0])
            errors.add(
                ChainError(
                    f"measures '{frames.child}' in '{frames.parent}'",
                    where=f"{place.describe('frames')}, calibration of joint '{joint.name}'",
                    expected=f"'{joint.child}' in '{joint.parent}', as in {arm.urdf}",
                )
            )
    terms = {str(arm.calibrations[joint]): calibration.shared for joint, calibration in calibrations.items()}
    with errors.collecting():
        check_same_terms({**({} if chain is None else {str(arm.beams): chain.shared}), **terms})
    return chain


def _check_record(arm: ArmFile, path: Path) -> None:
    """Check the commissioning record."""
    commissioned = load_record(path).files.calibrations
    if set(commissioned) != set(arm.calibrations):
        raise CalibrationError(
            f"joints {', '.join(commissioned)}",
            where=f"commissioning record {path}",
            expected=f"{', '.join(arm.calibrations)}, the joints of {arm.path}",
        )
