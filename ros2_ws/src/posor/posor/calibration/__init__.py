# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration files: YAML in SI units, versioned, validated, with uncertainties, provenance and a content hash."""
