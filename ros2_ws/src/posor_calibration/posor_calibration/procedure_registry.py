"""All calibration procedures by name. A new procedure is added to this list."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_calibration.procedures import (
    beam_transform,
    bundle,
    diode_axes,
    diode_map_fit,
    gap_linearisation,
    gap_repeatability,
    light_sources,
    probe_spacing,
    ring_profile,
    supply_sensitivity,
    target_plane,
    temperature_sensitivity,
    zero_drift,
)

if TYPE_CHECKING:
    from posor_calibration.procedure import Procedure

PROCEDURES: dict[str, Procedure[Any]] = {
    module.PROCEDURE.name: module.PROCEDURE
    for module in (
        beam_transform,
        bundle,
        diode_axes,
        diode_map_fit,
        gap_linearisation,
        gap_repeatability,
        light_sources,
        probe_spacing,
        ring_profile,
        supply_sensitivity,
        target_plane,
        temperature_sensitivity,
        zero_drift,
    )
}
