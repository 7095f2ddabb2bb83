"""How processes report to a test, and how the test sees that they have ended."""

import json
import os
import select
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import Any
from uuid import uuid4

import psutil

from tests.patience import LIMIT_S

TREE = "CAIRN_TEST_TREE"


class Report:
    """What a process reports about itself; its connection lasts as long as the process."""

    def __init__(self, connection: socket.socket) -> None:
        connection.settimeout(LIMIT_S)
        self.connection = connection
        self.lines = connection.makefile("rw")
        self.facts: dict[str, Any] = json.loads(self.lines.readline())
        self.pid: int = self.facts["pid"]
        self.name: str = self.facts["name"]

    def await_end(self) -> None:
        """Wait until the process has ended."""
        try:
            assert self.connection.recv(1) == b""
        except ConnectionResetError:
            return


class Reports:
    """The socket to which the processes of a test connect."""

    def __init__(self, directory: Path) -> None:
        self.path = str(directory / "reports.sock")
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(self.path)
        self._listener.listen(64)
        self._listener.settimeout(LIMIT_S)
        self._arrived: list[Report] = []
        self._all: list[Report] = []

    def __enter__(self) -> "Reports":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._listener.close()
        for report in self._all:
            report.lines.close()
            report.connection.close()

    def of(self, name: str) -> Report:
        """Wait for the report of a process of this name; each report is returned once."""
        while True:
            for report in self._arrived:
                if report.name == name:
                    self._arrived.remove(report)
                    return report
            connection, _ = self._listener.accept()
            report = Report(connection)
            self._arrived.append(report)
            self._all.append(report)


class Tree:
    """All processes started from now on: they carry a mark, even if they detach."""

    def __init__(self) -> None:
        self.mark = uuid4().hex
        os.environ[TREE] = self.mark

    def processes(self) -> list[psutil.Process]:
        """Return those that run, without zombies and without the test's own process."""
        found = []
        for process in psutil.process_iter():
            try:
                marked = process.environ().get(TREE) == self.mark
                if marked and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
        return found

    def await_end(self, *but: int) -> None:
        """Wait until none of them runs, except those of these process ids."""
        deadline = time.monotonic() + LIMIT_S
        left = [process for process in self.processes() if process.pid not in but]
        while left:
            for process in left:
                await_end_of(process.pid, deadline - time.monotonic())
            left = [process for process in self.processes() if process.pid not in but]
            assert not left or time.monotonic() < deadline, f"these still run: {left}"

    def end(self) -> None:
        """Kill all of them, so that a failed test leaves nothing."""
        for process in self.processes():
            process.kill()
        del os.environ[TREE]


def await_end_of(pid: int, limit_s: float) -> None:
    """Wait until a process has ended, even if it is not a child, or the limit has passed."""
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    select.select([process], [], [], max(0.0, limit_s))
    os.close(process)
