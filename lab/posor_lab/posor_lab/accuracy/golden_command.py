"""Check of the measurement model against a file of ray-traced cases: ``./run posor_lab golden FILE.jsonl``.

Prints one JSON line: for each stack the largest error of a predicted reading [m] and of a recovered pose [m, rad].
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pinocchio as pin
from posor.errors import DataFileError
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import Scans
from posor.reporting.program_errors import reports_errors

from posor_lab.accuracy.ray_traced_cases import RayTracedCase, StackName, read_cases


def case_errors(case: RayTracedCase) -> tuple[float, float, float]:
    """Return the largest error of the predicted readings [m], and of the recovered pose: translation [m], angle [rad].

    Raises:
        DataFileError: The readings of the case do not give a pose.

    """
    posor = Posor(case.calibration)
    predicted = posor.predict(case.scan, case.T_R_T)
    # The bump count is taken as known: the true rotation about Z, rounded to a whole bump.
    bump = max(sensor.bump_angle for sensor in case.calibration.sensors)
    theta = math.atan2(case.T_R_T.rotation[1, 0], case.T_R_T.rotation[0, 0])
    counts = np.array([bump * round(theta / bump)]) if bump > 0.0 else None
    found = posor.estimate_each(Scans.of([case.scan]), counts)
    if found.states[0] != State.OK:
        raise DataFileError(f"gives no pose ({Fault(int(found.faults[0])).name})", where=case.name)
    error = case.T_R_T.inverse() * pin.SE3(found.rotations[0], found.translations[0])
    return (
        float(np.max(np.abs(predicted - case.readings))),
        float(np.linalg.norm(error.translation)),
        float(np.linalg.norm(pin.log3(error.rotation))),
    )


def largest_errors(path: Path) -> dict[str, dict[str, float]]:
    """Return the largest errors over all cases of a file, by stack.

    Raises:
        DataFileError: The file cannot be read, or a case gives no pose.

    """
    report = {}
    for stack in get_args(StackName):
        largest = np.max([case_errors(case) for case in read_cases(path, stack)], axis=0)
        report[stack] = dict(zip(("prediction_m", "translation_m", "rotation_rad"), largest.tolist(), strict=True))
    return report


@reports_errors
def main(arguments: list[str] | None = None) -> int:
    """Run the check; the exit code is 0 if all cases could be checked."""
    parser = argparse.ArgumentParser(prog="golden", description=str(__doc__).splitlines()[0])
    parser.add_argument("file", type=Path, help="cases, one JSON object per line")
    options = parser.parse_args(arguments)
    print(json.dumps(largest_errors(options.file)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
