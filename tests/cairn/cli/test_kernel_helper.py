"""The process that compiles kernels for a command ends with it, and runs nothing else."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from cairn.cli import kernel_helper
from cairn.testing.launching import await_any_end
from tests.patience import LIMIT_S

COMMAND = """\
import sys
from cairn.cli import kernel_helper
kernel_helper.PACKAGES = ("slow",)
sys.modules["slow"] = sys  # it is being imported
kernel_helper.compile_in_helper()
"""
SLOW = """\
import os, time
with open({started!r}, "w") as started:
    started.write(str(os.getpid()))
time.sleep(600.0)
"""


@contextmanager
def compiling(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", int]]:
    """Run a command in a folder; yield it and the id of its helper, which imports a module."""
    os.mkfifo(started := folder / "started")
    (folder / "modules").mkdir()
    (folder / "modules" / "slow.py").write_text(SLOW.format(started=str(started)))
    with subprocess.Popen(
        [sys.executable, "-P", "-c", COMMAND],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder / 'modules'}:{os.getcwd()}"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as command:
        try:
            yield command, int(started.read_text())
        finally:
            command.kill()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_helper_ends_with_the_command(tmp_path: Path, number: int) -> None:
    with compiling(tmp_path) as (command, helper):
        # As Ctrl-C in a terminal: to all processes of the command.
        os.killpg(command.pid, number)
        await_any_end([helper], LIMIT_S)
        with suppress(psutil.NoSuchProcess):  # else it is not reaped yet
            assert psutil.Process(helper).status() == psutil.STATUS_ZOMBIE
        _, printed = command.communicate(timeout=LIMIT_S)

    assert printed.count("Traceback") == (1 if number == signal.SIGINT else 0), printed


def test_no_module_of_the_current_folder_is_imported(tmp_path: Path) -> None:
    for name in ("json", "sys", "importlib", "numpy", "cairn"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'was_imported')!r}, 'w')\n")

    with compiling(tmp_path):
        pass

    assert not (tmp_path / "was_imported").exists()


def test_helper_that_fails_is_reported(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kernel_helper, "BOOTSTRAP", "raise SystemExit(3)")

    kernel_helper.compile_in_helper()

    printed = capfd.readouterr().err
    assert "compiling kernels in this process: helper process: exit code 3" in printed
    assert "compiled" not in printed
