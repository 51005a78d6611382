"""The arm of ``arms.py`` with all its imperfections, and with none that a switch turns off."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from posor_drivers.simulator.switches import Switches

from .arms import simulation

if TYPE_CHECKING:
    from posor_drivers.simulator.arm import ArmSimulation


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> ArmSimulation:
    return simulation(tmp_path_factory.mktemp("everything"))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> ArmSimulation:
    return simulation(tmp_path_factory.mktemp("clean"), Switches.only())
