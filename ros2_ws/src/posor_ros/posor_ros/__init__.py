# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of all nodes of the stack: parameters, lifecycle, diagnostics, quality of service and the main loop."""
