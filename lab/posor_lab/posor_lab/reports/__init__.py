# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of the reports: findings, progress in the terminal, reception of a graph."""
