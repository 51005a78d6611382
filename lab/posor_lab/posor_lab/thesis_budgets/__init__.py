# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The error budgets of the thesis, computed cell by cell from the measurement model."""
