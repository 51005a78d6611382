# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the stack: latency, lost ticks, processor time, and speed of offline processing."""
