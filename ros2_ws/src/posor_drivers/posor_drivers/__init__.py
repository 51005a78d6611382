# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drivers of POSOR electronics: where raw scans come from, and where they are recorded."""
