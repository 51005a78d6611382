# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The measurement model: one file per physical effect, each formula with its derivatives."""
