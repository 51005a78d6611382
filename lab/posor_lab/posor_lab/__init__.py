# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Everything that judges the POSOR stack: 1985 comparison, campaigns, accuracy, budgets, benchmark."""
