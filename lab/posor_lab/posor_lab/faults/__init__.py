# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fault table: injects faults into nodes and estimator, counts wrong poses that are published as valid."""
