# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags in bulk: many messages at a time, as arrays."""
