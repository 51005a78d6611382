# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs (CSV, Parquet, TDMS, MATLAB) as scans and references, by a map that the user writes."""
