# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the joints' poses to the endpoint: arm file, beams, sag, time synchroniser."""
