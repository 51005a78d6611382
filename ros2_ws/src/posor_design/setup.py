# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packaging for colcon and pip by ``setup.cfg``, where colcon cannot read ``python_requires``."""

from __future__ import annotations

import sys
from tempfile import TemporaryDirectory

from setuptools import setup

SCRATCH = TemporaryDirectory()  # pip builds there: the source folder stays clean; colcon has a build folder
OPTIONS = {"build": {"build_base": SCRATCH.name}, "egg_info": {"egg_base": SCRATCH.name}}

setup(python_requires=">=3.11", options={} if "develop" in sys.argv else OPTIONS)
