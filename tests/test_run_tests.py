# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The test runner reports every failure, and interrupts its processes cleanly."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest
from environment import THIS
from posor_lab.harness.program import in_background
from run_tests import (
    PROCESSES,
    REAL_TIME_SHARED,
    SHARED,
    SLOW,
    find_test_files,
    is_real_time,
    make_test_jobs,
    shared_process,
)

RUNNER = [sys.executable, str(THIS.root / "tools" / "run_tests.py")]


def write_test_files(folder: Path, **files: str) -> None:
    for name, text in files.items():
        (folder / f"test_{name}.py").write_text(dedent(text), encoding="utf-8")


def run_tests(*arguments: Path | str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*RUNNER, *map(str, arguments)], capture_output=True, text=True, check=False)


def test_counts_and_reasons_and_long_tests_only_when_asked_for(tmp_path: Path) -> None:
    write_test_files(
        tmp_path,
        good="def test_a(): pass\ndef test_b(): pass\n",
        skips="""
            import pytest

            @pytest.mark.skip(reason="no rig on this machine")
            def test_rig(): pass
        """,
        long="import pytest\n@pytest.mark.long\ndef test_a(): pass\n",
    )
    done = run_tests(tmp_path)
    assert done.returncode == 0, done.stdout
    lines = done.stdout.splitlines()
    assert any(line.endswith("test_good.py: 2 passed") for line in lines)
    assert any(line.startswith("skipped: ") and line.endswith("no rig on this machine") for line in lines)
    assert lines[-1] == "2 passed, 0 failed, 1 skipped"
    done = run_tests("--long", tmp_path)
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-1] == "1 passed, 0 failed, 0 skipped"


FAILURES = {
    "assertion": ("def test_a(): pass\ndef test_b(): assert 1 == 2\n", "assert 1 == 2"),
    "exit": ("import os\ndef test_a(): os._exit(3)\n", "pytest ended with exit code 3"),
    "killed": (
        "import os, signal\ndef test_a(): os.kill(os.getpid(), signal.SIGKILL)\n",
        "pytest ended with exit code -9",
    ),
    "no_tests": ("def nothing(): pass\n", "pytest ended with exit code 5"),
    "import": ("import no_such_module\n", "No module named 'no_such_module'"),
    "fixture": (
        "import pytest\n@pytest.fixture\ndef broken(): raise KeyError('key')\ndef test_a(broken): pass\n",
        "KeyError",
    ),
}


def test_failures(tmp_path: Path) -> None:
    write_test_files(tmp_path, good="def test_a(): pass\n", **{name: text for name, (text, _) in FAILURES.items()})
    done = run_tests(tmp_path)
    assert done.returncode == 1
    details, *summary = done.stdout.split("\nfailed: ")
    assert len(summary) == len(FAILURES)
    for name, (_, words) in FAILURES.items():
        assert words in re.split(r"^\[\d+/\d+\] ", details.partition(f"test_{name}.py")[2], flags=re.MULTILINE)[0], name
        assert words in next(each for each in summary if each.splitlines()[0].endswith(f"test_{name}.py")), name
    assert done.stdout.splitlines()[-1] == f"2 passed, {len(FAILURES)} failed, 0 skipped"


def test_each_file_has_a_process_also_that_of_low_priority_jobs_while_there_are_none(tmp_path: Path) -> None:
    count = PROCESSES + 1
    text = f"""
        import os, pathlib, time
        def test_a():  # ends when all have begun
            here = pathlib.Path({str(tmp_path)!r})
            pathlib.Path(here, pathlib.Path(__file__).stem).write_text(str(os.getpid()))
            while len(list(here.glob("test_?"))) < {count}:
                time.sleep(0.01)
    """
    write_test_files(tmp_path, **dict.fromkeys("abcdef"[:count], text))
    done = run_tests(tmp_path)
    assert done.stdout.splitlines()[-1] == f"{count} passed, 0 failed, 0 skipped"
    assert len({pid.read_text() for pid in tmp_path.glob("test_?")}) == count


def test_files_of_a_folder_share_a_process_but_those_with_ros(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("run_tests.SHARED", (tmp_path,))
    texts = {"a": "", "b": "with ros_context([]): pass", "c": ""}
    write_test_files(tmp_path, **texts)
    files = {name: tmp_path / f"test_{name}.py" for name in texts}
    shared, alone = make_test_jobs(list(files.values()))
    assert (shared.command[-2:], shared.low_priority) == ([str(files["a"]), str(files["c"])], True)
    assert (alone.command[-1], alone.low_priority) == (str(files["b"]), False)


def test_files_with_ros_share_a_process_of_normal_priority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("run_tests.REAL_TIME_SHARED", (tmp_path / "test_[a-b]*.py",))
    write_test_files(tmp_path, **dict.fromkeys("abc", "with ros_context([]): pass"), d="")
    files = [tmp_path / f"test_{name}.py" for name in "abcd"]
    shared, *alone = make_test_jobs(files)
    assert [Path(word) for word in shared.command if word.endswith(".py")] == files[:2]
    assert [Path(job.command[-1]) for job in alone] == files[2:]
    assert not any(job.low_priority for job in (shared, *alone))


def test_what_tests_of_a_shared_process_import_starts_no_node_or_server() -> None:
    files = [file for file in find_test_files([]) if shared_process(file) and not is_real_time(file)]
    helpers = [file for folder in {file.parent for file in files} for file in folder.glob("*.py")]
    makers = {file.stem for file in helpers if not file.name.startswith("test_") and is_real_time(file)}
    words = {file.name: set(re.findall(r"\w+", file.read_text(encoding="utf-8"))) for file in files}
    assert {name: found & makers for name, found in words.items() if found & makers} == {}


def test_files_of_one_folder_are_divided_by_the_first_pattern_that_they_match(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    patterns = tmp_path / "deep", tmp_path / "test_[a-b]*.py", tmp_path
    monkeypatch.setattr("run_tests.SHARED", patterns)
    (tmp_path / "deep").mkdir()
    names = ("test_a.py", "test_b.py", "test_c.py", "deep/test_a.py")
    files = [tmp_path / name for name in names]
    for file in files:
        file.touch()
    shared = {job.name: [Path(word) for word in job.command if word.endswith(".py")] for job in make_test_jobs(files)}
    assert shared == {str(patterns[0]): files[3:], str(patterns[1]): files[:2], str(patterns[2]): files[2:3]}


def test_files_in_real_time_have_processes_of_their_own() -> None:
    assert not set(SHARED) & set(REAL_TIME_SHARED)


def test_slow_files_and_folders_come_first() -> None:
    jobs = make_test_jobs(find_test_files([]))
    assert tuple(job.name for job in jobs[: len(SLOW)]) == SLOW


def test_no_such_path(tmp_path: Path) -> None:
    done = run_tests(tmp_path / "nowhere")
    assert done.returncode == 2
    assert done.stderr == f"make test: {tmp_path}/nowhere: no such test file or folder.\n"


@pytest.mark.parametrize(
    ("start", "number"), [(list, signal.SIGINT), (list, signal.SIGTERM), (in_background, signal.SIGINT)]
)
def test_interruption_ends_the_tests_at_work(
    tmp_path: Path, start: Callable[[list[str]], list[str]], number: signal.Signals
) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    write_test_files(
        tmp_path,
        endless=f"""
            import os, pytest, signal

            @pytest.fixture
            def output():
                fifo = open("{fifo}", "w")
                yield fifo
                print("cleaned up", file=fifo, flush=True)

            def test_endless(output):
                print("begun", file=output, flush=True)  # the signal arrives during the test, not during collection
                while True:
                    signal.pause()
        """,
    )
    with subprocess.Popen(
        start([*RUNNER, str(tmp_path)]), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as runner:
        with fifo.open() as output:
            assert output.readline() == "begun\n"
            runner.send_signal(number)
            assert output.readline() == "cleaned up\n"
        _, err = runner.communicate()
    assert runner.returncode == 130
    assert err == "make test: interrupted.\n"
