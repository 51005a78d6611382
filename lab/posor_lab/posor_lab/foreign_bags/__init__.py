# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags as other writers, interrupted recorders and older versions of rosbag2 leave them, read and judged."""
