# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Everything that a user starts: launch files, arms, calibrations of the 1985 rig, and the program ``bringup``."""
