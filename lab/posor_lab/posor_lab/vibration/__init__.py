# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Vibration: simulated arms whose links oscillate and whose measuring beams follow."""
