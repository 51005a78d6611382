# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated arm live for a long time: scans, memory, descriptors and threads."""
