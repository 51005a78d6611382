# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Judges the commissioning check on simulated arms: exchanged plugs, signs, wrong files, and arms without a fault."""
