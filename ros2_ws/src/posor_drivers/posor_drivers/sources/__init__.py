# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sources of raw scans; ``source.py`` explains how to add one."""
