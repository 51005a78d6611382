# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Digital Calibration Certificates (DCC 3.2.1 of PTB): written from results, checked against the schema files."""
