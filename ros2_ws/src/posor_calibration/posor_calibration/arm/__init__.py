# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of a whole arm from references of its endpoint: POSORs, beams, base and tool at once."""
