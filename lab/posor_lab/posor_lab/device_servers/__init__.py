# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counterparts of devices for tests: servers that speak their protocols over real sockets, with faults on demand."""
