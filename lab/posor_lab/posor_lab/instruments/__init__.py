# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials of the instruments: servers of simulated devices, the real nodes, and the truth behind the servers."""
