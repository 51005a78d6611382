# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""SROS 2 policies compared with what the nodes really open, with and without the services that change state."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from contextlib import ExitStack
from fnmatch import fnmatchcase
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from posor_bringup.arm_programs import LAYOUTS, arm_programs, group_programs
from posor_bringup.arms import load_checked_arm
from posor_drivers.driver_node import DriverNode
from posor_estimator.chain_node import ChainNode
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.graph import Graph
from posor_lab.harness.in_process_nodes import NodeProcess, run_refused_node
from posor_lab.harness.program import Program, installed
from posor_lab.shop.shop_arm import write_shop_arm
from posor_lab.vibration.vibrating_arm import write_vibrating_arm
from posor_ros.lifecycle_node import PosorNode
from rclpy.node import Node

pytestmark = pytest.mark.usefixtures("ros_domain")

Entity = tuple[str, str]
"""Kind (publish, subscribe, reply, request) and name, or pattern of names, of a topic or a service."""

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = ROOT / "examples/security/make_keystore.sh"
JOINTS = ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw")
JOINT = JOINTS[-1]  # the last joint: its simulated driver publishes what belongs to the whole arm too
CLASSES: dict[str, type[PosorNode[Any]]] = {
    "chain_node": ChainNode,
    "posor_node": PosorEstimatorNode,
    "driver_node": DriverNode,
}
WITH_ALL_TOPICS: dict[str, dict[str, object]] = {
    "posor_node": {"encoder.sigma": 0.01, "home_pose": [1e-3, 0.0, 0.0]},
    "chain_node": {"encoders.topic": "encoders", "encoders.sigma": [1e-6]},
    "driver_node": {},
}
"""Parameters with which nodes open everything that they can."""
READING_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
)
ROS2 = """#!/bin/sh
# Stands for the command of an official Jazzy, which is not on PyPI: keeps the policies with which it is called.
set -e
case "$1 $2" in
"pkg prefix") echo "{share}" ;;
"security create_keystore") [ ! -d "$3" ]; mkdir -p "$3/public"; touch "$3/public/ca.cert.pem" ;;
"security create_enclave") [ ! -d "$3/enclaves$4" ]; mkdir -p "$3/enclaves$4"; touch "$3/enclaves$4/key.pem" ;;
"security create_permission") cp "$5" "$3/enclaves$4/used.xml" ;;
*) exit 9 ;;
esac
"""
CHILDREN = {
    "policy": {"enclaves"},
    "enclaves": {"enclave"},
    "enclave": {"profiles"},
    "profiles": {"profile"},
    "profile": {"topics", "services"},
    "topics": {"topic"},
    "services": {"service"},
}
"""Elements of a policy and what they contain. The format also has actions and metadata, which no policy here needs."""
REQUIRED = {"policy": {"version"}, "enclave": {"path"}, "profile": {"ns", "node"}}
RULES = {"topics": {"publish", "subscribe"}, "services": {"reply", "request"}}


def make_keystore(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the example script with a stand-in for ros2cli."""
    command = folder / "bin" / "ros2"
    command.parent.mkdir(exist_ok=True)
    command.write_text(ROS2.format(share=ROOT / "ros2_ws/src/posor_bringup"), encoding="utf-8")
    command.chmod(0o755)
    environ = {**os.environ, "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.run([SCRIPT, *arguments], env=environ, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def keystore(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("security")
    for _ in range(2):  # the second run keeps the keys
        made = make_keystore(folder, str(folder / "keys"), "five_axis", *JOINTS)
        assert (made.returncode, made.stderr) == (0, "")
    return folder / "keys" / "enclaves"


def load_policy(keystore: Path, enclave: str) -> ET.Element:
    """Return the policy of an enclave."""
    return ET.parse(keystore / enclave.removeprefix("/") / "used.xml").getroot()  # noqa: S314  our own file


def allowed(policy: ET.Element) -> set[Entity]:
    """Return what a policy allows, as patterns of full names."""
    entities = set()
    for profile in policy.iter("profile"):
        namespace = profile.attrib["ns"].rstrip("/")
        for rules in profile:
            for kind, entry in ((kind, entry) for kind in rules.attrib for entry in rules):
                name = str(entry.text).replace("~", f"{namespace}/{profile.attrib['node']}")
                entities.add((kind, name if name.startswith("/") else f"{namespace}/{name}"))
    return entities


def opened(observer: Node, name: str, namespace: str) -> set[Entity]:
    queries = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
        "request": observer.get_client_names_and_types_by_node,
    }
    return {(kind, entity) for kind, query in queries.items() for entity, _ in query(name, namespace)}


def matches(entity: Entity, rule: Entity) -> bool:
    return entity[0] == rule[0] and fnmatchcase(entity[1], rule[1])


def not_allowed(entities: set[Entity], rules: set[Entity]) -> set[Entity]:
    return {entity for entity in entities if not any(matches(entity, rule) for rule in rules)}


def not_opened(entities: set[Entity], rules: set[Entity]) -> set[Entity]:
    return {rule for rule in rules if not any(matches(entity, rule) for entity in entities)}


def opened_by_nodes(
    arm: str = "five_axis", all_topics: Mapping[str, dict[str, object]] = WITH_ALL_TOPICS, **changes: object
) -> dict[str, set[Entity]]:
    """Return what the nodes of the chain and of one joint open, by enclave; each has a process of its own."""
    found = {}
    with ExitStack() as stack:
        for program in arm_programs(load_checked_arm(arm)):
            if program.name not in ("chain_node", f"{JOINT}/posor_node", f"{JOINT}/driver_node"):
                continue
            own = all_topics[program.executable]
            process = stack.enter_context(NodeProcess())
            parameters = {**program.parameters, **own, **changes}
            node = process.start(CLASSES[program.executable], program.namespace, parameters)
            assert node.may_publish
            found[program.enclave] = opened(node, node.get_name(), node.get_namespace())
    return found


@pytest.mark.parametrize("executable", ["chain_node", "posor_node", "driver_node", "compose", "commission", "record"])
def test_policies_have_the_format_of_sros2(keystore: Path, executable: str) -> None:
    paths = sorted(keystore.rglob(executable))
    assert len(paths) == (len(JOINTS) if executable in ("posor_node", "driver_node") else 1)
    for path in paths:
        enclave = f"/{path.relative_to(keystore)}"
        policy = load_policy(keystore, enclave)
        assert policy.tag == "policy"
        assert policy.attrib == {"version": "0.2.0"}
        assert [element.attrib["path"] for element in policy.iter("enclave")] == [enclave]
        for element in policy.iter():
            content = {child.tag for child in element}
            assert content <= CHILDREN.get(element.tag, set())
            assert content or str(element.text).strip(), element.tag
            if rules := RULES.get(element.tag):
                assert len(element.attrib) == 1
                assert set(element.attrib) < rules
                assert set(element.attrib.values()) == {"ALLOW"}
            else:
                assert set(element.attrib) == REQUIRED.get(element.tag, set())
        if find_spec("sros2"):  # an official Jazzy: the published schema
            import_module("sros2.policy").load_policy(path / "used.xml")


def test_policies_allow_what_the_nodes_open_and_no_more(keystore: Path, tmp_path: Path) -> None:
    compose = allowed(load_policy(keystore, "/five_axis/compose"))
    warm = write_shop_arm(load_checked_arm("five_axis"), tmp_path / "warm")  # its beams have thermometers
    found = opened_by_nodes(str(warm))
    assert len(found) == len(CLASSES)
    arm = write_vibrating_arm(load_checked_arm("five_axis"), tmp_path / "vibrating")  # accelerometers exclude encoders
    for enclave, entities in opened_by_nodes(str(arm), {**WITH_ALL_TOPICS, "chain_node": {}}).items():
        found[enclave] |= entities
    for enclave, entities in found.items():
        rules = allowed(load_policy(keystore, enclave))
        assert not_allowed(entities, rules) == set()
        assert not_opened(entities, rules) == set()
        assert not_allowed(entities, compose) == set()


def test_a_policy_of_one_joint_does_not_allow_the_topics_of_another(keystore: Path) -> None:
    others = allowed(load_policy(keystore, "/five_axis/elbow/posor_node"))
    own = {("publish", f"/five_axis/{JOINT}/transform"), ("reply", f"/five_axis/{JOINT}/posor_node/home")}
    assert not_allowed(own, allowed(load_policy(keystore, f"/five_axis/{JOINT}/posor_node"))) == set()
    assert not_allowed(own, others) == own


def test_the_recorders_policy_allows_what_it_opens_and_no_more(keystore: Path, tmp_path: Path) -> None:
    topics = ["/diagnostics", "/five_axis/endpoint/state"]
    command = [*installed("posor_drivers", "record"), "--output", str(tmp_path / "bag"), "--topics", *topics]
    rules = allowed(load_policy(keystore, "/five_axis/record"))
    with Graph() as graph, NodeProcess() as process:
        chain = arm_programs(load_checked_arm("five_axis"), drivers=False)[0]
        process.start(ChainNode, chain.namespace, chain.parameters)
        with Program([*command, "--ros-args", "--enclave", "/five_axis/record"]) as recorder:
            recorder.wait_for_line("ready: ")
            found: set[Entity] = set()

            def everything_is_discovered() -> bool:
                nodes = graph.node.get_node_names_and_namespaces_with_enclaves()
                for name, namespace, enclave in nodes:
                    if enclave == "/five_axis/record":
                        found.update(opened(graph.node, name, namespace))
                return not not_opened(found, rules)

            graph.wait_until(everything_is_discovered, "the topics and services of the recorder")
            assert recorder.end() == 0
    assert not_allowed(found, rules) == set()


def test_every_process_of_an_arm_has_an_enclave(keystore: Path, tmp_path: Path) -> None:
    programs = arm_programs(load_checked_arm("five_axis"))
    for program in (each for layout in LAYOUTS for each in group_programs(programs, layout, tmp_path)):
        assert (keystore / program.enclave.removeprefix("/") / "used.xml").is_file()
        command = program.command()
        assert command[command.index("--enclave") + 1] == program.enclave


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["keys", "five_axis"], "2 arguments; expected KEYSTORE ARM JOINT..."),
        (["keys", "five_axis", "a/b"], "'a/b' is no name of an arm or a joint; expected letters, digits and _"),
    ],
)
def test_the_script_refuses_wrong_arguments(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    made = make_keystore(tmp_path, *arguments)
    assert (made.returncode, made.stderr.count("\n")) == (2, 1)
    assert sentence in made.stderr


def test_without_changes_no_service_changes_the_state() -> None:
    found = opened_by_nodes(allow_changes=False)
    assert len(found) == len(CLASSES)
    for enclave, entities in found.items():
        services = {entity for kind, entity in entities if kind == "reply"}
        assert services == {f"{enclave}/{name}" for name in READING_SERVICES}
        assert len(entities) > len(services)


def test_a_node_that_nothing_can_start_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    parameters = {"urdf": "arm.urdf", "autostart": False, "allow_changes": False}
    code, lines = run_refused_node(ChainNode, parameters, capfd)
    assert (code, len(lines)) == (2, 1)
    assert "'autostart' and 'allow_changes' are both false, so that nothing can start the node; expected" in lines[0]


def test_a_node_does_not_start_without_the_security_that_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The middleware from PyPI has no security; that of an official Jazzy finds that these keys are none."""
    for name in ("identity_ca.cert", "cert", "key", "permissions_ca.cert"):
        (tmp_path / "enclaves").mkdir(exist_ok=True)
        (tmp_path / "enclaves" / f"{name}.pem").touch()
    for name in ("governance", "permissions"):
        (tmp_path / "enclaves" / f"{name}.p7s").touch()
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    code, lines = run_refused_node(ChainNode, {"urdf": "arm.urdf"}, capfd)
    assert code == 2
    assert lines[-1].startswith("node chain_node: error creating node: ")
