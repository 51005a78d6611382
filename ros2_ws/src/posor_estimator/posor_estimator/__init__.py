# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes: posor_node, chain_node, and the program that composes nodes in one process."""
