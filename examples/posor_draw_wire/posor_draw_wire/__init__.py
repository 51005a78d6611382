# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draw-wire length sensors for a POSOR: an example of a sensor type in a package of its own."""
