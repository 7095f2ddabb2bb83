"""The systemd unit of deploy/robot runs a robot as an unprivileged user, and restarts it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from subprocess import PIPE

import psutil
import pytest

from tests.hardware.guest.cables import Cable
from tests.hardware.guest.modules import run

_REPOSITORY = Path(__file__).parents[3]
_FILES = _REPOSITORY / "deploy" / "robot"
_UNITS = Path("/run/systemd/system")
_SERVICE = "cairn@trial"
_LIMIT_S = 300.0

pytestmark = pytest.mark.timeout(700)
_INSTALLED = Path("/opt/cairn")

_DEPLOYMENT = """
cairn: 1
robot: trial
components:
  scanner:
    plugin: hokuyo_scanner
    # Emulated processors are slow: 40 scans per second would occupy them completely.
    parameters: {port: /dev/cairn/scanner, skip: 9}
"""
# Changes of the unit: it does not wait for the rest of a system, and limits are longer, because an
# emulated machine is slow; the environment and its interpreter may be anywhere.
_HERE = """
[Unit]
DefaultDependencies=no
[Service]
TimeoutStartSec=280
WatchdogSec=20
ProtectHome=tmpfs
BindReadOnlyPaths={paths}
"""


@pytest.fixture(scope="module", autouse=True)
def _installed() -> Iterator[None]:
    """Everything installed as docs/how-to/robot.md describes, but with a linked environment."""
    for folder in (_UNITS / f"{_SERVICE}.service.d", Path("/etc/cairn"), Path("/etc/sysusers.d")):
        folder.mkdir(parents=True, exist_ok=True)
    Path("/run/udev/rules.d").mkdir(parents=True, exist_ok=True)
    shutil.copy(_FILES / "70-cairn.rules", "/run/udev/rules.d")
    shutil.copy(_FILES / "cairn.sysusers", "/etc/sysusers.d/cairn.conf")
    shutil.copy(_FILES / "cairn@.service", _UNITS)
    paths = {_REPOSITORY, Path(sys.prefix), Path(sys.base_prefix)}
    text = _HERE.format(paths=" ".join(map(str, sorted(paths))))
    (_UNITS / f"{_SERVICE}.service.d" / "here.conf").write_text(text)
    Path("/etc/cairn/trial.yaml").write_text(_DEPLOYMENT)
    _INSTALLED.symlink_to(sys.prefix)
    run("systemd-sysusers")
    run("udevadm", "control", "--reload")
    run("systemctl", "daemon-reload")
    yield
    _INSTALLED.unlink()


@pytest.fixture
def service(acm: Cable) -> Iterator[str]:
    """The service, running, with a scanner plugged in."""
    acm.unplug()  # the udev rules give it its name when it is plugged in
    acm.plug_in()
    emulator = subprocess.Popen(
        [sys.executable, "-m", "cairn.cli.program", "emulate", "hokuyo", "--serial", acm.far_end]
    )
    try:
        subprocess.run(["systemctl", "start", _SERVICE], check=False, timeout=_LIMIT_S)
        assert of_service("ActiveState") == "active", journal()
        yield _SERVICE
        run("systemctl", "stop", _SERVICE)
    finally:
        emulator.kill()
        emulator.wait()


def test_service_runs_as_an_unprivileged_user_and_stops_cleanly(service: str) -> None:
    processes = of_robot()
    assert len(processes) >= 3, processes
    assert {process.username() for process in processes} == {"cairn"}
    for process in processes:
        assert "CapEff:\t0000000000000000" in Path(f"/proc/{process.pid}/status").read_text()
    assert scans_come(), journal()

    run("systemctl", "stop", service)

    assert of_robot() == []
    assert of_service("Result") == "success", journal()
    assert "ended: " in journal()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_service_is_restarted_when_its_root_is_killed_or_hangs(
    service: str, number: signal.Signals
) -> None:
    first = of_robot()
    root = int(of_service("MainPID"))
    before = end_of_journal()

    os.kill(root, number)

    await_text(f"Started {_SERVICE}", after=before)
    assert int(of_service("MainPID")) not in (0, root)
    assert not any(process.is_running() for process in first)
    assert scans_come(), journal()


def test_command_installs_and_removes_the_service(service: str) -> None:
    drop_in = Path("/etc/systemd/system", f"{service}.service.d", "deployment.conf")

    of_cairn("service", "install", "/etc/cairn/trial.yaml", "--set", "log_level=warning")

    assert "log_level=warning" in of_service("ExecStart")
    assert (of_service("ActiveState"), of_service("UnitFileState")) == ("active", "enabled")
    assert scans_come(), journal()
    of_cairn("service", "uninstall", "trial")
    assert of_service("ActiveState") == "inactive"
    assert not drop_in.exists()


def of_cairn(*words: str) -> None:
    """Run a command of the installed Cairn, which has to succeed."""
    done = subprocess.run(
        [str(_INSTALLED / "bin" / "cairn"), *words],
        check=False, capture_output=True, text=True, timeout=_LIMIT_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def scans_come() -> bool:
    """Whether the scanner's scans are on the bus."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "cairn.cli.program", "topic", "echo", "scan", "--count", "1"),
            *("--connect", "/run/cairn-trial/domain-0.sock"),
        ],
        check=False,
        capture_output=True,
        timeout=_LIMIT_S,
    )
    return done.returncode == 0


def of_robot() -> list[psutil.Process]:
    """All processes of the service."""
    listed = Path("/sys/fs/cgroup", of_service("ControlGroup").lstrip("/"), "cgroup.procs")
    if not of_service("ControlGroup") or not listed.exists():
        return []
    return [psutil.Process(int(pid)) for pid in listed.read_text().split()]


def of_service(what: str) -> str:
    """Return a property of the service, as systemd reports it."""
    done = subprocess.run(
        ["systemctl", "show", _SERVICE, "--property", what, "--value"],
        check=True,
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
    )
    return done.stdout.strip()


def journal() -> str:
    """Return the journal of the service, and of systemd about it."""
    done = subprocess.run(
        ["journalctl", "--unit", _SERVICE, "--output", "json"],
        check=True,
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
    )
    return "\n".join(str(json.loads(line)["MESSAGE"]) for line in done.stdout.splitlines())


def end_of_journal() -> str:
    """Where the journal ends now."""
    done = subprocess.run(
        ["journalctl", "--lines", "0", "--show-cursor"],
        check=True,
        capture_output=True,
        text=True,
        timeout=_LIMIT_S,
    )
    return done.stdout.rpartition("-- cursor: ")[2].strip()


def await_text(text: str, *, after: str) -> None:
    """Wait for a line of systemd or the service, after this position in the journal."""
    follow = ["journalctl", "--follow", "--lines=all", "--after-cursor", after, "--output=cat"]
    with subprocess.Popen([*follow, "--unit", _SERVICE], stdout=PIPE, text=True) as process:
        limit = threading.Timer(_LIMIT_S, process.kill)
        limit.start()
        try:
            assert process.stdout is not None
            assert any(text in line for line in process.stdout), f"no {text!r}; {journal()}"
        finally:
            limit.cancel()
            process.kill()
