# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Accuracy runs: how well the estimator inverts the model, states its uncertainty, and notices faults."""
