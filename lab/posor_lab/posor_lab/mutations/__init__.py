# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Mutations: the estimator's model is broken on purpose, and a check against the independent truth must notice."""
