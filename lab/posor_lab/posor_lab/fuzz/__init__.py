# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages and files: results of the programs for damaged bytes."""
