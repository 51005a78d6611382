# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of setup.cfg; each program is imported when it is called."""

from __future__ import annotations

from posor.lazy_program import LazyProgram

reprocess = LazyProgram("reprocess", "posor.bags.reprocess_command")
dcc = LazyProgram("dcc", "posor.certificates.dcc_command")
recover = LazyProgram("recover", "posor.bags.recover_command")
correct = LazyProgram("correct", "posor.correction.correct_command")
