"""arm_budget: the error budget of an arm's endpoint, extended and with the wrist bent, beside what the thesis printed.

``./run posor_bringup arm_budget [--arm ARM.yaml] [--output budget.json] [--draws N]``
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor_estimator.accuracy.report import writable, write_json
from posor_estimator.core.arm import load_arm
from posor_estimator.core.chain import load_chain
from posor_estimator.core.endpoint_budget import (
    Spread,
    configurations,
    endpoint_budget,
    model_covariances,
    monte_carlo,
    thesis_covariance,
)
from posor_estimator.errors import ChainError, ParameterError, PosorError
from posor_estimator.reporting.command_line import Parser
from rich.console import Console
from rich.table import Table

from posor_bringup.installed import data_path, share
from posor_bringup.thesis import URAD
from posor_bringup.thesis_robot import (
    ENDPOINT_FILE,
    JOINTS_FILE,
    MICROINCH,
    PrintedEndpoint,
    read_endpoint,
    read_joints,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.chain import Chain
    from posor_estimator.core.types import FloatArray

DRAWS = 10_000
SEED = 1985
FIGURES = ("alpha_x_urad", "alpha_y_urad", "alpha_z_urad", "dx_uin", "dy_uin", "dz_uin", "displacement_uin")

THESIS, NOISE, WHOLE = "thesis", "sensor_noise", "sensor_models"
TITLES = {
    THESIS: "thesis 9.3.1, exact beams",
    NOISE: "sensor models, exact beams: noise",
    WHOLE: "noise, calibration and beams",
}


def figures(spread: Spread | PrintedEndpoint) -> dict[str, float]:
    """Return a spread by the names of ``FIGURES``."""
    turns, shifts = (spread.orientation / URAD).tolist(), (spread.displacement / MICROINCH).tolist()
    return dict(zip(FIGURES, [*turns, *shifts, spread.total / MICROINCH], strict=True))


def arm_budget(arm: Arm, draws: int = DRAWS) -> dict[str, dict[str, Any]]:
    """Return the budgets of an arm, by configuration: ``extended`` and ``bent``.

    Each has the figures of ``FIGURES`` by what the joints' accuracies are taken from: ``sensor_noise`` and
    ``sensor_models``, and ``thesis`` where the arm's joints are those of the thesis' robot; each of these also has
    ``monte_carlo``, the same figures, and ``contributions``. The figures of ``thesis``, where there are none those of
    ``sensor_models``, stand in the configuration itself too, and ``printed`` has what the thesis printed.

    Args:
        arm: The arm.
        draws: How many draws a Monte Carlo run has.

    Raises:
        PosorError: A file of the arm cannot be used, or its POSORs cannot be read where all angles are zero.

    """
    chain = arm.chain()
    straight = load_chain(arm.urdf, arm.endpoint_frame)
    joints = read_joints(data_path(JOINTS_FILE))
    printed = read_endpoint(data_path(ENDPOINT_FILE))
    names = [joint.name for joint in chain.joints]
    known = names == list(joints)
    calibrations = {name: arm.calibration(name) for name in names}
    made: dict[str, dict[str, Any]] = {}
    for configuration, angles in configurations(names).items():
        try:
            random, systematic = model_covariances(calibrations, chain, angles)
        except ChainError:
            if any(angles.values()):
                continue  # a joint that cannot turn so far, such as that of the test rig
            raise
        cases: dict[str, tuple[Chain, Mapping[str, FloatArray]]] = {
            NOISE: (straight, random),
            WHOLE: (chain, {name: random[name] + systematic[name] for name in names}),
        }
        if known:
            thesis = {name: thesis_covariance(joint.outside_diameter) for name, joint in joints.items()}
            cases = {THESIS: (straight, thesis), **cases}
        budgets = {name: _one(case, angles, covariances, draws) for name, (case, covariances) in cases.items()}
        chosen = budgets[THESIS if known else WHOLE]
        made[configuration] = {**{name: chosen[name] for name in FIGURES}, **budgets}
        if known:
            made[configuration]["printed"] = figures(printed[configuration])
    return made


def _one(
    chain: Chain, angles: Mapping[str, float], covariances: Mapping[str, FloatArray], draws: int
) -> dict[str, Any]:
    budget = endpoint_budget(chain, angles, covariances)
    return {
        **figures(budget.spread),
        "monte_carlo": figures(monte_carlo(chain, angles, covariances, draws, SEED)),
        "contributions": [{"name": part.name, **figures(part.spread)} for part in budget.contributions],
    }


def print_budgets(budgets: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    """Print the budgets as tables."""
    for configuration, made in budgets.items():
        table = _table(f"Endpoint, {configuration}: standard uncertainties (k = 1)", "accuracies of the joints")
        for name, title in TITLES.items():
            if name in made:
                _add(table, title, made[name])
                _add(table, "  Monte Carlo", made[name]["monte_carlo"])
        if "printed" in made:
            _add(table, "printed in thesis 9.3.1", made["printed"])
        console.print(table)
        for name, title in TITLES.items():
            if name in made:
                parts = _table(f"What it is made of, {configuration}: {title}", "contribution")
                for part in made[name]["contributions"]:
                    _add(parts, part["name"], part)
                console.print(parts)


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column(first)
    for column in ("aX urad", "aY urad", "aZ urad", "dX uin", "dY uin", "dZ uin", "total uin", "total um"):
        table.add_column(column, justify="right")
    return table


def _add(table: Table, title: str, row: Mapping[str, float]) -> None:
    turns, shifts = FIGURES[:3], FIGURES[3:]
    cells = [f"{row[name]:.2f}" for name in turns] + [f"{row[name]:.1f}" for name in shifts]
    table.add_row(title, *cells, f"{row['displacement_uin'] * MICROINCH * 1e6:.2f}")


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="arm_budget", description="Error budget of an arm's endpoint.")
    default = share() / "arms" / "five_axis" / "arm.yaml"
    parser.add_argument("--arm", type=Path, default=default, metavar="ARM.yaml", help="default: the five-axis arm")
    parser.add_argument("--output", type=Path, metavar="FILE.json", help="file for the figures")
    parser.add_argument("--draws", type=int, default=DRAWS, help=f"of each Monte Carlo run (default: {DRAWS})")
    options = parser.parse_args(list(arguments))
    if options.draws < 1:
        raise ParameterError(f"--draws {options.draws}", where="arm_budget", expected="1 or more")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the budget as a program; the exit code is 0 when it could be made."""
    try:
        options = parse(sys.argv[1:] if arguments is None else arguments)
        if options.output is not None:
            writable(options.output)
        budgets = arm_budget(load_arm(options.arm), options.draws)
    except PosorError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    print_budgets(budgets, Console(width=118, highlight=False))
    if options.output is not None:
        write_json(options.output, budgets)
    return 0


if __name__ == "__main__":
    sys.exit(main())
