"""`cairn up --console`: a console beside a run, in a process of its own that ends with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cairn.system.files import explain_os_error

ADDRESS: Final = "console: "
"""Begins the line of `cairn console` with the address."""

_STOP_LIMIT_S: Final = 3.0
# The console is a client: the robot ends without it, and it ends when `cairn up` is killed.
_BOOT: Final = (
    "import os, signal, sys\n"
    "from cairn.processes.orphan_cleanup import set_parent_death_signal\n"
    "set_parent_death_signal(signal.SIGTERM)\n"
    "if os.getppid() != int(sys.argv.pop(1)): sys.exit()\n"
    "from cairn.cli.program import script\n"
    "script()\n"
)


@contextmanager
def console_beside(
    endpoint: str,
    domain: int,
    log: Path,
    report: Callable[[str], None],
    note: Callable[[str], None],
) -> Iterator[None]:
    """Run a console of the robot at that endpoint until the end of the context.

    Args:
        endpoint: where the router of the run listens.
        domain: its domain.
        log: file for what the console prints, but not its address, which contains the token.
        report: called with the address, once, on a thread.
        note: called with the reason if the console does not start, or ends early.
    """
    process = None
    try:
        process = _started(endpoint, domain, log)
    except OSError as error:
        note(f"no console: {explain_os_error(error)}; the robot runs without it")
    if process is None:
        yield
        return
    ending = threading.Event()

    def watch() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(ADDRESS):
                report(line.removeprefix(ADDRESS).strip())
        code = process.wait()
        if not ending.is_set():
            note(f"the console has ended (exit code {code}); the robot goes on; see {log}")

    watcher = threading.Thread(target=watch, name="cairn console", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ending.set()
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        watcher.join(_STOP_LIMIT_S)


def _started(endpoint: str, domain: int, log: Path) -> subprocess.Popen[str]:
    command = ["console", "--connect", endpoint, "--domain", str(domain)]
    with log.open("ab") as errors:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", _BOOT, str(os.getpid()), *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,  # the terminal's Ctrl-C reaches `cairn up` only
        )
