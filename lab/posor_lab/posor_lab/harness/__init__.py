# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Harness for the tests of all packages: real programs in own processes, and a node that watches the graph."""
