# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Correction of a robot by the measured endpoint of its arm: joint offsets, online and for recorded programs."""
