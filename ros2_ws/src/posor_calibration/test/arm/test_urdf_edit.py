# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text of a new URDF: only the named origins and types change; comments are no joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from posor.errors import ChainError
from posor_calibration.arm.arm_files import edit_urdf

URDF = """<robot name='r'>
  <!-- <joint name="b" type="fixed"><origin xyz="9 9 9"/></joint> -->
  <link name="base"/><link name="l"/><link name="m"/>
  <joint type='fixed'
         name='b'><parent link="base"/><child link="l"/><origin xyz="1 0 0"></origin></joint>
  <joint name="j" type="floating"><parent link="l"/><child link="m"/></joint>
</robot>
"""
PLACE = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]))


def test_origins_and_types_change_and_all_else_stays() -> None:
    text = edit_urdf(URDF, {"b": PLACE, "j": PLACE}, "why -- here", kinds={"b": "fixed", "j": "continuous"})
    model: pin.Model = pin.buildModelFromXML(text)
    assert (model.nq, model.names[1]) == (2, "j")
    np.testing.assert_allclose(model.jointPlacements[1].homogeneous, (PLACE * PLACE).homogeneous, atol=1e-12)
    assert '<!-- <joint name="b" type="fixed"><origin xyz="9 9 9"/></joint> -->' in text
    assert "<!-- why - here -->" in text
    assert text.count("<axis") == 1


def test_a_joint_that_is_only_in_a_comment_is_not_found() -> None:
    with pytest.raises(ChainError, match="joint 'c' is not found"):
        edit_urdf(URDF.replace('name="b"', 'name="c"'), {"c": PLACE}, "")
