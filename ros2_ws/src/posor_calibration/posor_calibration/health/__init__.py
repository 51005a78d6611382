# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Health of an arm over years: short tests at an artefact, their history, control charts, advice."""
