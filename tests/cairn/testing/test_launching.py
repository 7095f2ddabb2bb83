"""Runs find the processes and the problems of their deployment, and leave nothing running.

A program of the test's own takes the place of `cairn up`.
"""

import sys
from functools import partialmethod
from pathlib import Path
from textwrap import dedent

import pytest

from cairn.testing.launching import LIMIT_S, Launching, Run, await_any_end, launching

pytestmark = pytest.mark.processes

COMPONENTS = "components: {}"

ENDS = ""

TWO_COMPONENTS = """
    import os
    from setproctitle import setproctitle

    is_open, closes_at_its_end = os.pipe()
    for name in ("base_camera", "base"):
        if os.fork() == 0:
            os.close(closes_at_its_end)
            setproctitle(f"cairn: {name}")
            os.write(1, f"{name} {os.getpid()}\\n".encode())
            os.read(is_open, 1)
            os._exit(0)
    os.wait()
    """

LEAVES_A_PROCESS = """
    import subprocess

    left = subprocess.Popen(["sleep", "600"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    print(f"left {left.pid}")
    """


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The program that runs in place of `cairn`."""
    file = tmp_path / "program"
    file.touch(mode=0o755)
    monkeypatch.setattr("cairn.testing.launching.CAIRN", str(file))
    return file


def write(program: Path, text: str) -> None:
    program.write_text(f"#!{sys.executable}\n{dedent(text)}", encoding="utf-8")


def test_process_of_a_component_is_not_that_of_a_longer_name(
    program: Path, launch: Launching
) -> None:
    write(program, TWO_COMPONENTS)
    run = launch(COMPONENTS, environment={"SPT_NOENV": "1"})  # titles leave the environment alone
    pids = {}
    for name in ("base_camera", "base"):
        line = run.lines[run.await_line(f"^{name} ") - 1]
        pids[name] = int(line.split()[1])

    assert {name: run.pid_of(name) for name in pids} == pids


def test_every_run_is_checked_for_processes_left(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        Run, "await_nothing_left", partialmethod(Run.await_nothing_left, limit_s=0.0)
    )
    write(program, LEAVES_A_PROCESS)
    runs, left = list[Run](), list[int]()

    def leave_two_processes() -> None:
        with launching(tmp_path) as launch:
            for _ in range(2):
                runs.append(launch(COMPONENTS))
                number = runs[-1].await_line("left ")
                left.append(int(runs[-1].lines[number - 1].split()[-1]))
                assert runs[-1].await_end() == 0

    with pytest.raises(AssertionError, match="left running") as failure:
        leave_two_processes()

    for pid in left:
        assert f"{pid} sleep 600" in str(failure.value)
        await_any_end([pid], LIMIT_S)
    assert [run.pids() for run in runs] == [[], []]


def test_foreign_line_that_resembles_a_record_belongs_to_the_record_before(
    program: Path, launch: Launching
) -> None:
    write(program, ENDS)
    run = launch(COMPONENTS)
    run.logs.mkdir(parents=True)
    warning = "2026-11-22 17:22:42,512 WARNING robot.base: no device"
    foreign = [
        "2026-11-22 17:22:42 WARNING vendor_sdk: retrying",
        "2026-99-99 17:22:42,512 ERROR vendor_sdk: retrying",
    ]
    info = "2026-11-22 17:22:43,007 INFO    robot.base: the device is back"
    lines = [warning, *foreign, info, *foreign]
    (run.logs / "base.log").write_text("\n".join(lines), encoding="utf-8")

    assert run.problems(10) == [warning, *foreign]


def test_log_file_that_cannot_be_read_is_a_problem(program: Path, launch: Launching) -> None:
    write(program, ENDS)
    run = launch(COMPONENTS)
    unreadable = run.logs / "base.log"
    unreadable.mkdir(parents=True)
    error = "2026-11-22 17:22:42,512 ERROR robot.camera: no device"
    (run.logs / "camera.log").write_text(error, encoding="utf-8")

    assert run.problems(10) == [f"{unreadable} cannot be read: Is a directory", error]
