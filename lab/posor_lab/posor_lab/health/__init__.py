# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Health tests of arms that age, with the independent truth."""
