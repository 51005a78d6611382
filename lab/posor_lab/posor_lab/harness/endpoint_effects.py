# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""How shifts of joints and expansions of beams move an endpoint, by pinocchio: the reference of the kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pinocchio as pin
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray


def endpoint_effects(chain: Chain, T_parent_child: Mapping[str, pin.SE3]) -> dict[str, FloatArray]:
    """Return how a shift of each joint's transform moves the endpoint.

    The sag of the beams is left out: it changes the levers by less than a thousandth.

    ``T_parent_child``: transform of each joint, by name. Returns the matrix (6, 6) of each joint, by name: from a shift
    of the transform (ROS order, axes of the joint's parent) to one of the endpoint (ROS order, axes of the base, the
    small turn applied at the endpoint).
    """
    pose = chain.links[0].T_nominal
    axes, centres = {}, {}
    for joint, link in zip(chain.joints, chain.links[1:], strict=True):
        axes[joint.name] = pose.rotation
        pose = pose * T_parent_child[joint.name]
        centres[joint.name] = pose.translation
        pose = pose * link.T_nominal
    return {name: _effect(axes[name], pose.translation - centres[name]) for name in axes}


def _effect(rotation: FloatArray, lever: FloatArray) -> FloatArray:
    x, y, z = lever
    effect = np.zeros((6, 6))
    effect[:3, :3] = effect[3:, 3:] = rotation
    effect[:3, 3:] = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ rotation  # turn x lever
    return effect


def expansion_shifts(chain: Chain, T_parent_child: Mapping[str, pin.SE3]) -> FloatArray:
    """Return how the endpoint moves if each measuring beam has the largest expansion that its temperature may cause.

    A beam of uniform temperature keeps its shape, so its expansion moves the endpoint without turning it. The sag of
    the beams is left out, as in ``endpoint_effects``.

    ``T_parent_child``: transform of each joint, by name. Returns the shift by each of the b beams between the base and
    the endpoint, (b, 6), ROS order, axes of the base [m, rad].
    """
    moved = [T_parent_child[joint.name].rotation for joint in chain.joints]
    shifts, rotation = [], np.eye(3)
    for link, turn in zip(chain.links, [*moved, np.eye(3)], strict=True):
        if link.beam is not None:
            shift = rotation @ link.before.rotation @ link.beam.expansion
            shifts.append(np.concatenate([shift, np.zeros(3)]))
        rotation = rotation @ link.T_nominal.rotation @ turn
    return np.reshape(shifts, (-1, 6))
