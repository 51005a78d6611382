"""Finds an arm by name or path and checks that its files are consistent."""

from __future__ import annotations

from pathlib import Path

from posor.calibration.shared_terms import check_same_terms
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.chain.commissioning_record import load_record
from posor.errors import ChainError, ParameterError
from posor_drivers.simulator.arm_simulation import ArmSimulation

from posor_bringup.installed import share

ARM_FILE = "arm.yaml"


def installed_arms() -> list[str]:
    """Return the names of the arms that this package installs."""
    return sorted(path.parent.name for path in (share() / "arms").glob(f"*/{ARM_FILE}"))


def find_arm(text: str) -> Path:
    """Return the path of an arm file, from its path, its folder's path, or the name of an installed arm.

    Raises ParameterError: there is no such arm.
    """
    for path in (Path(text), Path(text) / ARM_FILE, share() / "arms" / text / ARM_FILE):
        if path.is_file():
            return path
    names = ", ".join(installed_arms())
    raise ParameterError("no such arm", where=f"arm '{text}'", expected=f"the path of an arm file, or one of {names}")


def load_checked_arm(text: str) -> ArmFile:
    """Load an arm, given as for ``find_arm``, and check that all its files can be read and are consistent.

    Raises ParameterError: there is no such arm; CalibrationError: a file cannot be read or is invalid, two files state
    different uncertainties of a shared term, or the scenario does not fit the arm; ChainError: the URDF is invalid, or
    the calibrations do not match its joints.
    """
    arm = load_arm_file(find_arm(text))
    chain = arm.chain()
    terms = {str(arm.beams): chain.shared}
    for joint in chain.joints:
        calibration = arm.calibration(joint.name)
        frames, terms[str(arm.calibrations[joint.name])] = calibration.frames, calibration.shared
        if (frames.parent, frames.child) != (joint.parent, joint.child):
            raise ChainError(
                f"measures '{frames.child}' in '{frames.parent}'",
                where=f"{arm.calibrations[joint.name]}, calibration of joint '{joint.name}'",
                expected=f"'{joint.child}' in '{joint.parent}', as in {arm.urdf}",
            )
    check_same_terms(terms)
    if arm.commissioning is not None and arm.commissioning.exists():  # before the first commissioning there is none
        load_record(arm.commissioning)
    if arm.scenario is not None:
        ArmSimulation(arm)  # each driver makes one; here its errors are reported before anything is started
    return arm
