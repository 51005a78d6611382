# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensor types. Each is found through the entry-point group ``posor.sensors``."""
