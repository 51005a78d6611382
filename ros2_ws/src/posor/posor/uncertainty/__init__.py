# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error budgets of a POSOR: what the noise of each reading and each calibrated number do to the six freedoms."""
