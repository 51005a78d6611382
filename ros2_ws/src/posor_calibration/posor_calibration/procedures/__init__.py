# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The calibration procedures, each a constant of a module; ``procedure_registry`` finds them."""
