# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entries of beams files for tests, and a beams file of some entries."""

from __future__ import annotations

from typing import Any

from posor.chain.beams_file import BeamsFile


def quantity(value: object, unit: str) -> dict[str, Any]:
    """Return a quantity as a file states it."""
    return {"value": value, "unit": unit}


def tube(outer: float, inner: float) -> dict[str, Any]:
    """Return a tube of aluminium with these diameters [m]."""
    diameters = {"outer_diameter": quantity(outer, "m"), "inner_diameter": quantity(inner, "m")}
    return {**diameters, "modulus": quantity(69e9, "Pa"), "density": quantity(2700.0, "kg/m^3")}


def plate(name: str, at: float, mass: float) -> dict[str, Any]:
    """Return a plate at a distance [m] from the beginning of its beam, with its mass [kg]."""
    return {"name": name, "at": quantity(at, "m"), "mass": quantity(mass, "kg")}


def uncertainty(position: list[float], orientation: list[float]) -> dict[str, Any]:
    """Return the standard uncertainty of a beam's end along [m] and about [rad] X, Y, Z."""
    return {"position": quantity(position, "m"), "orientation": quantity(orientation, "rad")}


def beams_content(*beams: dict[str, Any], version: int = 1) -> dict[str, Any]:
    """Return the content of a beams file."""
    provenance = {"source": "a test", "method": "by hand", "date": "none"}
    return {"format": "posor_beams", "version": version, "name": "test", "provenance": provenance, "beams": list(beams)}


def beams_file(*beams: dict[str, Any], version: int = 1) -> BeamsFile:
    """Return a beams file."""
    return BeamsFile.model_validate(beams_content(*beams, version=version))
