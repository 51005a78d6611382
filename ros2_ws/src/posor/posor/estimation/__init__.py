# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From one raw scan to one pose with covariance."""
