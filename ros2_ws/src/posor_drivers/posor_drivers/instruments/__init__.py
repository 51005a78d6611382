# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Instruments: devices that deliver frames of channel values, their clocks, and scans made of their channels."""
