"""Runs a node in the test's own process, where it is to refuse its parameters or what they name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.ros.main import run
from posor_estimator.testing.program import ros_arguments

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pytest

    from posor_estimator.ros.node import PosorNode


def refusal(
    node_class: type[PosorNode[Any]],
    parameters: Mapping[str, object],
    capfd: pytest.CaptureFixture[str],
    namespace: str = "",
) -> tuple[int, list[str]]:
    """Return the exit code and the complaint, line by line, of a node's program that ends by itself.

    Args:
        node_class: The node.
        parameters: What its command line sets.
        capfd: pytest's fixture of that name: it hears the ROS log as well.
        namespace: Of the node.

    Raises:
        AssertionError: It wrote to standard output.

    """
    capfd.readouterr()
    code = run(node_class, [node_class.NAME, *ros_arguments(parameters, namespace)])
    said, complaint = capfd.readouterr()
    if said:
        raise AssertionError(f"standard output has '{said}'")
    return code, complaint.splitlines()
