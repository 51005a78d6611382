# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulation of an arm with POSORs: true poses and raw scans. This package imports no ROS."""
