# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Design calculators: each computes a part of a POSOR or of its structure from dimensions, in SI units.

The calculators are public functions of this package, such as ``posor_design.beam_frequencies``. They need no
ROS. ``posor design`` runs them from the command line.
"""

from posor_design.air_bearing import aerostatic_bearing as aerostatic_bearing
from posor_design.ball_bearings import ball_load as ball_load
from posor_design.ball_bearings import bearing_friction as bearing_friction
from posor_design.ball_bearings import bearing_scaling as bearing_scaling
from posor_design.calibration_geometry import axis_offsets as axis_offsets
from posor_design.calibration_geometry import light_source_angles as light_source_angles
from posor_design.calibration_geometry import probe_spacing as probe_spacing
from posor_design.contact import ball_race_contact as ball_race_contact
from posor_design.contact import hertz_contact as hertz_contact
from posor_design.distance_sensors import capacitance_probe as capacitance_probe
from posor_design.distance_sensors import fibre_lever as fibre_lever
from posor_design.distance_sensors import linearity as linearity
from posor_design.distance_sensors import probe_area as probe_area
from posor_design.error_chain import endpoint_error as endpoint_error
from posor_design.error_chain import position_bits as position_bits
from posor_design.error_chain import straight_linkage as straight_linkage
from posor_design.gimbals import dither_acceleration as dither_acceleration
from posor_design.gimbals import gimbal_motion as gimbal_motion
from posor_design.gimbals import gimbal_torques as gimbal_torques
from posor_design.gimbals import shortest_wires as shortest_wires
from posor_design.gimbals import wire_gimbal as wire_gimbal
from posor_design.gimbals import yoke_friction as yoke_friction
from posor_design.inertial_sensors import fibre_gyroscope as fibre_gyroscope
from posor_design.inertial_sensors import inertial_drift as inertial_drift
from posor_design.inertial_sensors import inertial_limits as inertial_limits
from posor_design.interferometry import air_effects as air_effects
from posor_design.interferometry import straightness_optics as straightness_optics
from posor_design.joint_loads import bearing_pair as bearing_pair
from posor_design.joint_loads import chain_drive as chain_drive
from posor_design.joint_loads import gear_drive as gear_drive
from posor_design.joint_loads import joint_moment as joint_moment
from posor_design.machine_metrology import abbe_error as abbe_error
from posor_design.machine_metrology import alignment as alignment
from posor_design.machine_metrology import probe_zero as probe_zero
from posor_design.machine_metrology import straightness as straightness
from posor_design.machine_metrology import straightness_runs as straightness_runs
from posor_design.machine_metrology import thermal_growth as thermal_growth
from posor_design.measuring_beams import beam_frequencies as beam_frequencies
from posor_design.measuring_beams import beam_sag as beam_sag
from posor_design.measuring_beams import sag_correction as sag_correction
from posor_design.sensor_noise import angle_resolution as angle_resolution
from posor_design.sensor_noise import converter_resolution as converter_resolution
from posor_design.sensor_noise import diode_noise as diode_noise
from posor_design.structures import cantilever_beam as cantilever_beam
from posor_design.structures import cantilever_for_stiffness as cantilever_for_stiffness
from posor_design.structures import cantilever_for_stress as cantilever_for_stress
from posor_design.structures import cantilever_frequencies as cantilever_frequencies
from posor_design.torsion import beam_torsion as beam_torsion
from posor_design.torsion import disc_inertia as disc_inertia
from posor_design.torsion import shaft_stress as shaft_stress
