# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations of a POSOR and of a whole arm as the content of a Digital Calibration Certificate."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.calibration_recording import bag_sha256
from posor.calibration.parameter_covariance import is_part, stated_covariance
from posor.calibration.parameter_entries import ParameterEntry, parameter_entries
from posor.certificates.dcc_document import Block, Certificate, HashedFile, Quantity
from posor.chain.identity import file_sha256

from posor_calibration.calibration_update import find_quantity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from posor.chain.arm_file import ArmFile

    from posor_calibration.arm.arm_files import Provenance
    from posor_calibration.arm.arm_fit import ArmCalibration
    from posor_calibration.calibration_fit import FitResult
    from posor_calibration.outcome_report import ProcedureVerdict

FACTOR, PROBABILITY = 2.0, 0.9545  # of the expanded uncertainties of normal distributions (JCGM 100, table G.1)
NORMS = ("JCGM 100:2008",)
MEANING = (
    f"Each expanded uncertainty is the standard uncertainty multiplied by the coverage factor {FACTOR:g}, which for a "
    "normal distribution corresponds to a coverage probability of approximately 95 % (JCGM 100, 7.2.3). Errors that "
    "several values share, such as the scale of the reference, are in it. "
    "The correlations of the parameters are in the report and in the calibration file."
)


def certificate_of_fit(result: FitResult, verdict: ProcedureVerdict, bag: Path, former: Path) -> Certificate:
    """Return the content of a certificate of a procedure: the values of its calibration file, or what it found.

    ``former``: the calibration file before.
    """
    outcome, name = result.outcome, result.calibration.name
    results = [Block("new values of the calibration file", _quantities("", _new_values(result)))] if result.text else []
    return Certificate(
        title=f"{result.procedure} of POSOR {name}",
        item=f"POSOR {name}",
        identifications={"content hash of the calibration file (SHA-256)": result.calibration.content_hash},
        software=("posor", version("posor")),
        method=outcome.method,
        norms=NORMS,
        files=[
            HashedFile("bag", bag.name, bag_sha256(bag)),
            HashedFile("former calibration file", former.name, file_sha256(former)),
        ],
        conditions=(),
        results=results
        or [
            Block(
                what,
                _quantities(
                    f"{what}: ", zip(fit.names, fit.units, fit.values.tolist(), fit.sigmas.tolist(), strict=True)
                ),
            )
            for what, fit in outcome.fits.items()
        ],
        declarations={
            "expanded uncertainty": [MEANING],
            "verdict": [verdict.headline, *verdict.findings],
            "notes": verdict.notes,
        },
    )


def certificate_of_arm(arm: ArmFile, found: ArmCalibration, origin: Provenance) -> Certificate:
    """Return the content of a certificate of the calibration of a whole arm."""
    names, units = zip(*((each.name, each.unit) for each in found.parameters), strict=True)
    fitted = zip(names, units, found.values.tolist(), found.sigmas.tolist(), strict=True)
    left_out = [f"Left out, the others contradict: {', '.join(found.outliers)}."] if found.outliers else []
    kept = [f"Not determined, as before: {', '.join(found.undetermined)}."] if found.undetermined else []
    return Certificate(
        title=f"Calibration of arm {arm.name}",
        item=f"measuring arm {arm.name}",
        identifications={"name": arm.name, "serial number": arm.serial},
        software=("posor", version("posor")),
        method="posor calibrate-arm: POSORs, beams, base and tool by least squares from references of the endpoint",
        norms=NORMS,
        files=[HashedFile(Path(path).name, Path(path).name, sha256) for path, sha256 in origin.sources.items()],
        conditions=[
            Block(f"readings {group}", [Quantity(f"position, rms after, readings {group}", misfit.position, "m")])
            for group, misfit in found.after.items()
            if misfit.readings
        ],
        results=[Block("change of each parameter from the former files", _quantities("change: ", fitted))],
        declarations={"expanded uncertainty": [MEANING], "notes": [*left_out, *kept, *found.warnings]},
    )


def _new_values(result: FitResult) -> Iterator[tuple[str, str, float, float]]:
    """Yield name, unit, value and standard uncertainty, with the shared terms, of each new number of the file."""
    calibration, outcome = result.calibration, result.outcome
    replaced = calibration.fits[-1].replaced
    total = np.sqrt(np.diag(stated_covariance(calibration))).tolist()
    used = set()
    for entry, sigma in zip(parameter_entries(calibration), total, strict=True):
        if entry is not None and any(is_part(entry.name, key) for key in replaced):
            used.add(entry.key)
            yield entry.name, _unit(entry), float(entry.quantity.array[entry.index]), sigma
    for key in (new.key for new in outcome.replacements if new.key not in used):  # noise, ranges
        quantity = find_quantity(calibration, key)
        for index in np.ndindex(quantity.array.shape):
            entry = ParameterEntry(key, index, quantity)
            yield entry.name, _unit(entry), float(quantity.array[index]), float(quantity.sigmas[index])


def _unit(entry: ParameterEntry) -> str:
    """Return the unit of a number; that of the coefficient k of a polynomial has its power."""
    unit = entry.quantity.unit
    return unit.replace("^k", f"^{entry.index[0]}") if unit.endswith("^k") else unit


def _quantities(prefix: str, numbers: Iterable[tuple[str, str, float, float]]) -> list[Quantity]:
    """Return quantities of name, unit, value and standard uncertainty; zero: none is stated."""
    return [
        Quantity(f"{prefix}{name}", value, unit, FACTOR * sigma, FACTOR, PROBABILITY)
        if sigma > 0.0
        else Quantity(f"{prefix}{name}", value, unit)
        for name, unit, value, sigma in numbers
    ]
