from __future__ import annotations

import pytest
from posor.errors import ParameterError
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import parse_driver_parameters


def test_driver_parameters_of_a_launch_argument() -> None:
    parameters = parse_driver_parameters("simulated.sag:=false  simulated.cycles:=2")
    assert parameters == {"simulated.sag": False, "simulated.cycles": 2}
    programs = arm_programs(load_checked_arm("five_axis"), driver_parameters=parameters)
    assert [program.parameters["simulated.sag"] for program in programs if program.ends] == [False] * 5
    assert parse_driver_parameters("") == {}
    with pytest.raises(ParameterError) as caught:
        parse_driver_parameters("simulated.sag=false")
    assert str(caught.value) == (
        "launch argument 'driver_parameters': 'simulated.sag=false' is not a parameter, name:=value."
    )
