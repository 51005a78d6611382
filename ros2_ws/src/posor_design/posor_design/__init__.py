"""Design calculators: each computes a part of a POSOR or of its structure from dimensions, in SI units.

The calculators are public functions of this package, such as ``posor_design.beam_frequencies``. They need no
ROS, and are imported when they are first used. ``posor design`` runs them from the command line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_design.calculators import load_calculator

if TYPE_CHECKING:
    from posor_design.air_bearing import aerostatic_bearing
    from posor_design.ball_bearings import ball_load, bearing_friction, bearing_scaling
    from posor_design.calibration_geometry import axis_offsets, light_source_angles, probe_spacing
    from posor_design.contact import ball_race_contact, hertz_contact
    from posor_design.distance_sensors import capacitance_probe, fibre_lever, linearity, probe_area
    from posor_design.error_chain import endpoint_error, position_bits, straight_linkage
    from posor_design.gimbals import gimbal_motion, gimbal_torques, shortest_wires, wire_gimbal
    from posor_design.inertial_sensors import fibre_gyroscope, inertial_drift, inertial_limits
    from posor_design.interferometry import air_effects, straightness_optics
    from posor_design.joint_loads import bearing_pair, chain_drive, gear_drive, joint_moment
    from posor_design.machine_metrology import (
        abbe_error,
        alignment,
        probe_zero,
        straightness,
        straightness_runs,
        thermal_growth,
    )
    from posor_design.measuring_beams import beam_frequencies, beam_sag, sag_correction
    from posor_design.sensor_noise import angle_resolution, converter_resolution, diode_noise
    from posor_design.structures import (
        cantilever_beam,
        cantilever_for_stiffness,
        cantilever_for_stress,
        cantilever_frequencies,
    )
    from posor_design.torsion import beam_torsion, disc_inertia, shaft_stress
    from posor_design.yoke_gimbals import dither_acceleration, yoke_friction

__all__ = [
    "abbe_error",
    "aerostatic_bearing",
    "air_effects",
    "alignment",
    "angle_resolution",
    "axis_offsets",
    "ball_load",
    "ball_race_contact",
    "beam_frequencies",
    "beam_sag",
    "beam_torsion",
    "bearing_friction",
    "bearing_pair",
    "bearing_scaling",
    "cantilever_beam",
    "cantilever_for_stiffness",
    "cantilever_for_stress",
    "cantilever_frequencies",
    "capacitance_probe",
    "chain_drive",
    "converter_resolution",
    "diode_noise",
    "disc_inertia",
    "dither_acceleration",
    "endpoint_error",
    "fibre_gyroscope",
    "fibre_lever",
    "gear_drive",
    "gimbal_motion",
    "gimbal_torques",
    "hertz_contact",
    "inertial_drift",
    "inertial_limits",
    "joint_moment",
    "light_source_angles",
    "linearity",
    "position_bits",
    "probe_area",
    "probe_spacing",
    "probe_zero",
    "sag_correction",
    "shaft_stress",
    "shortest_wires",
    "straight_linkage",
    "straightness",
    "straightness_optics",
    "straightness_runs",
    "thermal_growth",
    "wire_gimbal",
    "yoke_friction",
]


def __getattr__(name: str) -> Any:
    """Import a calculator when it is first used (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = load_calculator(name.replace("_", "-"))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
