# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated arm, its endpoint errors, coverage and budget."""
