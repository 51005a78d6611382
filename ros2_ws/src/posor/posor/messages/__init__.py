# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes: layout, unpacking of raw scans, packing of estimates. No ROS here."""
