# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Correction of simulated robots, judged by the independent truth."""
