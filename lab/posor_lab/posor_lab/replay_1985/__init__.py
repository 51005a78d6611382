# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Replays the motion tests of 1985 through the nodes and compares them with the thesis."""
