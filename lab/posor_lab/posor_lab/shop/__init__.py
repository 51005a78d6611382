# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The shop floor: a simulated arm whose beams warm up."""
