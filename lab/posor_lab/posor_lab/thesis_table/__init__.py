# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Printed numbers of the thesis beside the numbers that this project computes."""
