# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Building blocks of reports: self-contained HTML pages, figure style, command-line parser."""
