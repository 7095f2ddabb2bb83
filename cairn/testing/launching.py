"""Runs `cairn up` as a user would, reads its output, and checks that nothing of it is left."""

import argparse
import contextlib
import itertools
import json
import os
import random
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import cache
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import dedent
from typing import Any
from uuid import uuid4

import psutil

from cairn.bus.endpoints import parse_endpoint
from cairn.deployment.load import DeploymentNames, read_names
from cairn.deployment.shipped import deployment_file

CAIRN = str(Path(sys.executable).parent / "cairn")
"""The command of the environment that runs the tests."""

LIMIT_S = 120.0
"""Default time limit of waits [s]: far longer than they take."""

_RECORD = re.compile(r"(\d+\.\d+|\d+-\d+-\d+ [\d:,]+) ([A-Z]+) ")
"""The beginning of a log record: time and level."""

_PROBLEMS = ("WARNING", "ERROR", "CRITICAL")
_CRASHES = ("Traceback (", "Fatal Python error")  # written past the log
_BLOCK = 100  # ports
_MARK = "CAIRN_TEST_RUN"  # in the environment of all processes of a run, grandchildren included


class Run:
    """A running `cairn up`: its output lines, its processes, its end."""

    def __init__(
        self,
        arguments: Sequence[str],
        report: Path,
        endpoint: str,
        environment: Mapping[str, str],
        head: int | None,
        **how: Any,
    ) -> None:
        self.arguments = arguments
        self.report = report
        self.endpoint = endpoint
        self.lines: list[str] = []
        self._mark = uuid4().hex
        self._head = head
        self._changed = threading.Condition()
        self._ended = False
        self.process = subprocess.Popen(
            [CAIRN, "up", *arguments, "--report", str(report)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **environment, _MARK: self._mark},
            **how,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def await_line(self, pattern: str, *, after: int = 0, limit_s: float = LIMIT_S) -> int:
        """Wait for a line that matches the pattern; return its number, for `after`."""
        deadline = time.monotonic() + limit_s
        number = after
        with self._changed:
            while True:
                for line in self.lines[number:]:
                    number += 1
                    if re.search(pattern, line):
                        return number
                assert not self._ended, f"cairn up ended without a line {pattern!r}; {self}"
                left_s = deadline - time.monotonic()
                assert left_s > 0, f"no line {pattern!r} within {limit_s:g} s; {self}"
                self._changed.wait(left_s)

    def await_end(self, limit_s: float = LIMIT_S) -> int:
        """Wait for the end of `cairn up`; return its exit code."""
        try:
            code = self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"cairn up does not end within {limit_s:g} s; {self}") from None
        self._reader.join(limit_s)
        return code

    def stop(self, limit_s: float = LIMIT_S) -> int:
        """Send SIGINT, as Ctrl-C does, and wait for the end; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.await_end(limit_s)

    def pid_of(self, component: str) -> int:
        """Return the process id of a component, or of the `zygote`.

        For a moment there may be two: a process is forked under the name of its parent.
        """
        deadline = time.monotonic() + LIMIT_S
        title = f"cairn: {component}"
        while len(found := [one.pid for one in self.processes() if title_of(one) == title]) != 1:
            assert time.monotonic() < deadline, f"{component} has the processes {found}; {self}"
            time.sleep(0.05)
        return found[0]

    def pids(self) -> list[int]:
        """Return the ids of all processes of the run, grandchildren included."""
        return [process.pid for process in self.processes()]

    def await_nothing_left(self, limit_s: float = LIMIT_S) -> None:
        """Wait until no process of the run is left; kill those that stay, and name them."""
        names = self.kill_left(limit_s)
        assert not names, f"left running: {names}; {self}"

    def kill_left(self, limit_s: float = LIMIT_S) -> list[str]:
        """Wait until no process of the run is left; kill those that stay, and return their names.

        A name is the process's id and command line.
        """
        deadline = time.monotonic() + limit_s
        while (left := self.processes()) and time.monotonic() < deadline:
            await_any_end([process.pid for process in left], deadline - time.monotonic())
        names = []
        for process in left:
            with contextlib.suppress(psutil.NoSuchProcess):
                title = title_of(process)
                process.kill()
                names.append(f"{process.pid} {title}")
        return names

    def log_of(self, component: str) -> str:
        """Return the log file of a component."""
        return (self.logs / f"{component}.log").read_text(encoding="utf-8")

    @property
    def logs(self) -> Path:
        """The folder of the log files, one for each process."""
        return self.report / "logs"

    def problems(self, limit: int) -> list[str]:
        """Return the lines of the last warnings and errors in the log files, in order of time.

        Tracebacks are included. Each file contributes at most about `limit` lines, so that errors
        that follow from others do not displace their cause.
        """
        found = []
        for file in self.logs.glob("*.log"):
            count = 0
            for time_s, lines in reversed(_problems_in(file)):
                found.append((time_s, lines))
                count += len(lines)
                if count >= limit:
                    break
        return [line for _, lines in sorted(found, key=itemgetter(0)) for line in lines]

    def __str__(self) -> str:
        """Return its log folder and its output, for the message of a test that fails."""
        return f"logs: {self.logs}; output of cairn up:\n" + "".join(self.lines)

    def processes(self) -> list[psutil.Process]:
        """Return all processes of the run, grandchildren included, zombies excluded."""
        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                if (
                    process.status() != psutil.STATUS_ZOMBIE
                    and process.environ().get(_MARK) == self._mark
                ):
                    found.append(process)
        return found

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._add(line)
            if len(self.lines) == self._head:
                break
        self.process.stdout.close()
        self._ended = True
        self._add("")

    def _add(self, line: str) -> None:
        with self._changed:
            self.lines.append(line)
            self._changed.notify_all()


class Launching:
    """Launches deployments written in a test, each on a router of its own by default."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.runs: list[Run] = []

    def __call__(
        self,
        deployment: str | Path,
        *arguments: str,
        robot: str = "robot",
        connect: str | None = None,
        environment: Mapping[str, str] | None = None,
        head: int | None = None,
        report: Path | None = None,
        **how: Any,
    ) -> Run:
        """Run `cairn up` with a file, or with `components` and other keys given as YAML.

        `connect` is the endpoint of another run's router, to join it; only `head` lines of output
        are read. Other arguments go to `subprocess.Popen`.
        """
        socket = new_socket()
        endpoint = connect or parse_endpoint(str(socket))
        if isinstance(deployment, Path):
            where = f"bus.connect=[{endpoint}]" if connect else f"bus.socket={socket}"
            words = [str(deployment), "--set", where, *arguments]
        else:
            bus = {"connect": [endpoint]} if connect else {"socket": str(socket)}
            words = [str(self.write(deployment, robot, bus)), *arguments]
        report = report or self._folder / f"report{len(self.runs)}"
        run = Run(words, report, endpoint, environment or {}, head, **how)
        self.runs.append(run)
        return run

    def write(
        self, components: str, robot: str = "robot", bus: Mapping[str, Any] | None = None
    ) -> Path:
        """Write a deployment file with these components; by default on a socket of its own.

        The text may have the keys of a deployment, too; its `cairn` and `robot` take precedence.
        """
        file = self._folder / f"deployment{len(self.runs)}.yaml"
        text = dedent(components)
        head = {"cairn": 1, "robot": robot, "bus": bus or {"socket": str(new_socket())}}
        given = set(re.findall(r"^(cairn|robot):", text, re.MULTILINE))
        lines = [f"{key}: {json.dumps(value)}\n" for key, value in head.items() if key not in given]
        file.write_text("".join(lines) + text, encoding="utf-8")
        return file


@contextmanager
def launching(folder: Path) -> Iterator[Launching]:
    """Launch deployments; at the end all are stopped, and nothing of them may be left."""
    launch = Launching(folder)
    try:
        yield launch
    finally:
        for run in launch.runs:
            if run.process.poll() is None:
                run.process.send_signal(signal.SIGCONT)
                run.process.send_signal(signal.SIGINT)
        for run in launch.runs:
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.process.wait(LIMIT_S)
        errors = []
        for run in launch.runs:  # all, also if the first has left something
            try:
                run.await_nothing_left()
            except AssertionError as error:
                errors.append(str(error))
        assert not errors, "\n".join(errors)


def names_of(file: Path, arguments: Sequence[str]) -> DeploymentNames:
    """Return the robot's and the components' names in the deployment of `cairn up FILE ...`.

    Raises `DeploymentError` if the deployment cannot be read.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--overlay", action="append", type=deployment_file, default=[])
    parser.add_argument("--set", action="append", dest="sets", default=[])
    known, _ = parser.parse_known_args(list(arguments))
    return read_names(deployment_file(str(file)), known.overlay, known.sets)


def _problems_in(file: Path) -> list[tuple[float, list[str]]]:
    """Return the warnings, errors and crashes in a log file, each as time [s] and lines.

    A line that begins no record belongs to the record before it. A file that cannot be read is a
    problem itself; an exception would end pytest instead of reporting the failed test.
    """
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        return [(0.0, [f"{file} cannot be read: {error.strerror}"])]
    found: list[tuple[float, list[str]]] = []
    time_s, is_problem = 0.0, False
    for line in text.splitlines():
        start = _start_of_record(line)
        if start is not None:
            time_s, is_problem = start[0], start[1] in _PROBLEMS
        is_crash = not is_problem and line.startswith(_CRASHES)
        if is_crash or (start is not None and is_problem):
            is_problem = True
            found.append((time_s, []))
        if is_problem:
            found[-1][1].append(line)
    return found


def _start_of_record(line: str) -> tuple[float, str] | None:
    """Return time [s since 1970] and level of the record that a line begins; None if it does not.

    A component's log also contains what its libraries print, which may resemble a record.
    """
    start = _RECORD.match(line)
    if start is None:
        return None
    time, level = start.groups()
    try:
        if " " not in time:
            return float(time), level  # the log of the root has seconds
        return datetime.strptime(time, "%Y-%m-%d %H:%M:%S,%f").timestamp(), level
    except ValueError:
        return None


def title_of(process: psutil.Process) -> str:
    """Return the command line of a process, empty if it has ended."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return " ".join(process.cmdline()).rstrip()  # empty arguments pad a component's title
    return ""


def new_socket() -> Path:
    """Return a path for the Unix socket of one more router, in a private folder of this process.

    Pytest's own folders have paths that are too long for a socket.
    """
    return Path(_sockets().name) / f"{next(_numbers)}.sock"


@cache
def _sockets() -> "TemporaryDirectory[str]":
    return TemporaryDirectory(prefix="cairn-test-", ignore_cleanup_errors=True)


_numbers = itertools.count()


def new_endpoint() -> str:
    """Return the endpoint of a Unix socket at which no process listens."""
    return parse_endpoint(str(new_socket()))


def free_port() -> int:
    """Return a free TCP port that neither the kernel nor another test process gives away.

    A port that the kernel has chosen (port 0) would not do: it may give the same one to any
    connection or listener on this computer as soon as it is released, and a deployment opens its
    router only seconds after its port was chosen.
    """
    while True:
        port = next(_own_ports())
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port


@cache
def _own_ports() -> Iterator[int]:
    """Return the ports of a block that this process alone uses, again and again.

    The block is outside the range from which the kernel chooses ports, if there is room.
    """
    chosen_by_kernel = Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="ascii")
    first, last = map(int, chosen_by_kernel.split())
    blocks = [range(start, start + _BLOCK) for start in range(10_000, 65_000, _BLOCK)]
    random.SystemRandom().shuffle(blocks)  # a test may have seeded the other generator
    blocks.sort(key=lambda block: block[0] <= last and first <= block[-1])
    reservation = socket.socket(socket.AF_UNIX)
    for block in blocks:
        with contextlib.suppress(OSError):  # another process has reserved it
            reservation.bind(f"\0cairn-test-ports-{block[0]}")
            reservation.detach()  # stays open until the process ends
            return itertools.cycle(block)
    raise AssertionError("other processes have reserved all TCP ports from 10000 on")


def await_any_end(pids: Sequence[int], limit_s: float) -> None:
    """Wait until one of these processes has ended."""
    with contextlib.ExitStack() as stack:
        poll = select.poll()
        for pid in pids:
            try:
                descriptor = os.pidfd_open(pid)
            except ProcessLookupError:
                return
            stack.callback(os.close, descriptor)
            poll.register(descriptor, select.POLLIN)
        poll.poll(max(0.0, limit_s) * 1000)
