# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated calibration campaigns of a POSOR whose true parameters differ from its calibration."""
