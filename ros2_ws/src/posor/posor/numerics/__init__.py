# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numerical basis: compilation of kernels, three-vectors, 3x3 and 6x6 matrices, time stamps."""
