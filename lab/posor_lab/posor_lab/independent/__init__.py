# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A second model of POSORs and arms, written from the geometry alone: the truth that shares no code with the product.

Nothing here imports ``posor`` or another package of the product; ``tests/test_import_layers.py`` checks this. Files are
read by PyYAML, URDFs by pinocchio. The interface is made of paths, plain names and arrays in SI units.
"""
