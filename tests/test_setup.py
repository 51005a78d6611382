# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The set-up makes a workspace, repairs it after interruptions, and does nothing if it is complete."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from environment import THIS, SetupError, Workspace, write_stamp
from posor_lab.harness.program import Program
from setup_state import build_inputs, environment_inputs, reasons_to_set_up
from setup_workspace import rewrite_cmake_paths

from tests.miniature import BASE_PYTHON, PACKAGE, Miniature, clean_environ

EVENT_DEADLINE_S = 60.0
STEP = re.compile(r"^set-up: (.*), expected (?:some|one|two|\d).* \.\.\. \d+\.\d s$", re.MULTILINE)
RECORD_STARTED_PROCESSES = """
import runpy, sys
started = []
events = {"os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.system", "subprocess.Popen"}
sys.addaudithook(lambda event, arguments: started.append(event) if event in events else None)
sys.path.insert(0, sys.argv[1])
try:
    runpy.run_path(sys.argv[1] + "/setup_workspace.py", run_name="__main__")
finally:
    print("started", *started)
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Miniature:
    """A small checkout that is set up before and after every test."""
    miniature = Miniature(tmp_path_factory.mktemp("checkout"))
    miniature.fill()
    done = miniature.set_up()
    assert done.returncode == 0, done.stderr
    assert len(STEP.findall(done.stdout)) == 3
    return miniature


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    wait_until(path.exists, process, f"{path} is there")


def wait_until(event: Callable[[], bool], process: subprocess.Popen[str], what: str) -> None:
    deadline = time.monotonic() + EVENT_DEADLINE_S
    while not event():
        assert process.poll() is None, f"ended before {what}"
        assert time.monotonic() < deadline, f"timeout before {what}"
        time.sleep(0.002)


def processes_started(workspace: Workspace) -> str:
    command = [str(BASE_PYTHON), "-c", RECORD_STARTED_PROCESSES, str(workspace.root / "tools")]
    done = subprocess.run(command, env=clean_environ(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_second_set_up_starts_no_process(checkout: Miniature) -> None:
    assert processes_started(checkout) == "started\n"


@pytest.mark.long
def test_changed_data_file_starts_a_build(checkout: Miniature) -> None:
    checkout.write("ros2_ws/src/miniature/config/more.txt", "4\n")
    assert "subprocess.Popen" in processes_started(checkout)


def test_this_checkout_is_up_to_date() -> None:
    assert not any(reasons_to_set_up(THIS, {}, official=json.loads(THIS.environment_stamp.read_text())["official"]))


@pytest.mark.parametrize(
    ("name", "imports", "rebuilds"),
    [
        ("numerics/compiled.py", "posor.numerics.compiled", True),
        ("model/gap.py", "posor.numerics.compiled", True),
        ("model/fault.py", "enum", True),  # its constants are compiled into kernels
        ("ros/gap.py", "posor.numerics.compiled", False),
    ],
)
def test_changed_kernels_are_compiled_by_the_set_up(tmp_path: Path, name: str, imports: str, *, rebuilds: bool) -> None:
    file = tmp_path / "ros2_ws/src/posor/posor" / name
    file.parent.mkdir(parents=True)
    inputs = []
    for number in (1, 2):
        file.write_text(f"import {imports}\nnumber = {number}\n", encoding="utf-8")
        inputs.append(build_inputs(Workspace(tmp_path), official=False))
    assert (inputs[0] != inputs[1]) == rebuilds
    (file.parent / ".#gap.py").symlink_to("user@host.1:2")  # the lock of an editor; its target does not exist
    assert build_inputs(Workspace(tmp_path), official=False) == inputs[1]


@pytest.mark.parametrize(
    ("name", "rebuilds"),
    [
        ("config/more.yaml", True),
        ("package.xml", True),
        ("setup.py", True),
        ("notes.txt", False),
        ("config/.more.yaml.swp", False),
        ("config/more.yaml~", False),
        ("config/more.yaml.orig", False),
        ("dist/miniature.whl", False),
        (".pytest_cache/README.md", False),
        ("build/lib/miniature/programs.py", False),
        ("miniature.egg-info/PKG-INFO", False),
        ("test/data.yaml", False),
    ],
)
def test_only_sources_start_a_build(tmp_path: Path, name: str, *, rebuilds: bool) -> None:
    miniature = Miniature(tmp_path)
    miniature.fill()
    before = build_inputs(miniature, official=False)
    miniature.write(f"ros2_ws/src/miniature/{name}", "new")
    assert (build_inputs(miniature, official=False) != before) == rebuilds


def test_pip_leaves_the_sources_clean(tmp_path: Path) -> None:
    scripts = [*THIS.ros2.glob("src/*/setup.py"), *THIS.root.glob("lab/*/setup.py")]
    packages = {script.read_bytes(): script.parent for script in scripts}.values()  # one of each text
    official = json.loads(THIS.environment_stamp.read_text())["official"]

    def sources() -> set[Path]:
        return {path for package in packages for path in package.rglob("*") if "__pycache__" not in path.parts}

    before = sources()
    pip = [str(THIS.python), "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    environ = os.environ | {"POSOR_KERNEL_LIBRARY": str(THIS.ros2 / "build" / "posor" / "posor_kernels.so")}
    subprocess.run([*pip, "--wheel-dir", str(tmp_path), *map(str, packages)], check=True, env=environ)
    assert len(list(tmp_path.glob("*.whl"))) == len(packages)
    assert sources() == before
    assert not any(reasons_to_set_up(THIS, {}, official=official))


@pytest.mark.long
def test_python_and_data_files_need_no_build(checkout: Miniature) -> None:
    installed = checkout.install / "miniature" / "share" / "miniature" / "config" / "numbers.txt"
    for number in ("17", "23"):
        checkout.write("ros2_ws/src/miniature/miniature/new_module.py", f"NUMBER = {number}\n")
        checkout.write("ros2_ws/src/miniature/config/numbers.txt", f"{number}\n")
        assert processes_started(checkout) == "started\n"
        assert installed.read_text() == f"{number}\n"


@pytest.mark.long
def test_new_executable_is_built(checkout: Miniature) -> None:
    source = checkout.ros2 / "src" / "miniature" / "setup.py"
    present = '"wait = miniature.programs:wait"'
    source.write_text(source.read_text().replace(present, f'{present}, "more = miniature.programs:tell"'))
    done = checkout.set_up()
    assert done.returncode == 0, done.stderr
    assert STEP.findall(done.stdout) == ["colcon build of ros2_ws (sources changed)"]
    assert "arguments -x" in checkout.run("miniature", "more", "-x").stdout


@pytest.mark.long
@pytest.mark.parametrize("whole_group", [True, False], ids=["with its commands", "alone"])
def test_killed_during_colcon_build(checkout: Miniature, *, whole_group: bool) -> None:
    shutil.rmtree(checkout.install)
    with checkout.start_set_up() as process:
        wait_for(checkout.install / "miniature", process)
        (os.killpg if whole_group else os.kill)(process.pid, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert not checkout.build_stamp.exists()
    done = checkout.set_up()
    assert done.returncode == 0, done.stderr
    assert STEP.findall(done.stdout) == ["colcon build of ros2_ws (none yet or unfinished)"]
    assert "things 42" in checkout.run("miniature", "tell").stdout


@pytest.mark.long
def test_changed_lock_file_renews_the_environment_also_after_a_kill(checkout: Miniature) -> None:
    checkout.write("requirements/dev.txt", "# nothing more\n")
    with checkout.start_set_up() as process:
        wait_until(lambda: not checkout.environment_stamp.exists(), process, "the stamp is removed")
        wait_for(checkout.venv / "pyvenv.cfg", process)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.stdout is not None
        assert "(requirements or location changed)" in process.stdout.read()
    done = checkout.set_up()
    assert done.returncode == 0, done.stderr
    assert len(STEP.findall(done.stdout)) == 3
    assert "(unfinished or damaged)" in done.stdout
    assert "things 42" in checkout.run("miniature", "tell").stdout
    assert processes_started(checkout) == "started\n"


def test_environment_without_its_python_is_detected(tmp_path: Path) -> None:
    miniature = Miniature(tmp_path)
    miniature.fill()
    miniature.python.parent.mkdir(parents=True)
    miniature.python.symlink_to(BASE_PYTHON)
    write_stamp(miniature.environment_stamp, {"inputs": environment_inputs(miniature, official=False)})
    assert reasons_to_set_up(miniature, {}, official=False) == ("", "none yet or unfinished")
    miniature.python.unlink()
    assert reasons_to_set_up(miniature, {}, official=False) == ("unfinished or damaged", "new environment")


@pytest.mark.long
@pytest.mark.parametrize("who", ["set-up", "run"])
def test_interrupted_by_the_user(checkout: Miniature, who: str) -> None:
    shutil.rmtree(checkout.install)
    start = (
        checkout.start_set_up if who == "set-up" else partial(checkout.start, checkout.root / "run", PACKAGE, "tell")
    )
    with start() as process:
        wait_for(checkout.install / PACKAGE, process)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    assert err.endswith(f"posor {who}: interrupted.\n")
    assert who == "set-up" or "Traceback" not in err  # the set-up shows what colcon says
    assert checkout.set_up().returncode == 0


@pytest.mark.long
def test_removed_package_is_installed_again(checkout: Miniature) -> None:
    shutil.rmtree(checkout.install / "miniature")
    done = checkout.set_up()
    assert STEP.findall(done.stdout) == ["colcon build of ros2_ws (incomplete, or by a plain colcon build)"]
    assert checkout.run("miniature", "tell").returncode == 0


@pytest.mark.long
def test_two_concurrent_set_ups_build_once(checkout: Miniature) -> None:
    checkout.build_stamp.unlink()
    both = [checkout.start_set_up() for _ in range(2)]
    ends = [process.communicate() for process in both]
    assert [process.returncode for process in both] == [0, 0], ends
    assert len(STEP.findall("".join(out for out, _ in ends))) == 1
    assert checkout.run("miniature", "tell").returncode == 0


@pytest.mark.long
def test_moved_checkout_is_set_up_again(checkout: Miniature, tmp_path: Path) -> None:
    moved = Miniature(tmp_path / "moved")
    shutil.copytree(checkout.root, moved.root, symlinks=True)
    done = moved.set_up()
    assert done.returncode == 0, done.stderr
    assert len(STEP.findall(done.stdout)) == 3
    assert str(checkout.root) not in moved.run("miniature", "tell").stdout


@pytest.mark.parametrize("folder", ["core", "_core"], ids=["numpy 1", "numpy 2"])
def test_cmake_paths_are_rewritten_to_the_environment(folder: str, tmp_path: Path) -> None:
    site_packages = sysconfig.get_path("purelib", "venv", vars={"base": str(tmp_path)})
    Path(site_packages, "numpy", folder, "include").mkdir(parents=True)
    file = tmp_path / "share" / "rcl" / "cmake" / "export.cmake"
    file.parent.mkdir(parents=True)
    built_with = "/opt/python/cp311-cp311"
    file.write_text(
        f'"{built_with}/include/python3.11;{built_with}/lib/python3.11/site-packages/numpy/_core/include"\n'
    )
    assert rewrite_cmake_paths(tmp_path) == 1
    headers, numpy = file.read_text().strip('"\n').split(";")
    assert os.path.isfile(f"{headers}/Python.h")  # noqa: PTH113 - a path within CMake text
    assert numpy == f"{site_packages}/numpy/{folder}/include"
    assert rewrite_cmake_paths(tmp_path) == 0


def test_cmake_path_of_another_kind_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "share" / "export.cmake"
    file.parent.mkdir()
    file.write_text("/opt/python/cp311-cp311/bin/python3\n")
    with pytest.raises(SetupError, match=r"export\.cmake: holds a path of the machine that built the wheel"):
        rewrite_cmake_paths(tmp_path)


def test_an_interrupted_tool_ends_what_it_started() -> None:
    main = "lambda: run_commands(['sh', '-c', 'sleep 300 & echo $!; wait'])"
    code = f"from environment import exit_with, run_commands; exit_with('tool', {main})"
    with Program([sys.executable, "-c", code], {"PYTHONPATH": str(THIS.root / "tools")}) as running:
        command = Path("/proc", running.wait_for_line("").strip(), "cmdline")
        assert running.end(signal.SIGTERM) == 130
        assert running.stderr == ["tool: interrupted."]
        assert not command.is_file() or not command.read_bytes()
