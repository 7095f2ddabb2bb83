"""Programs that run beside a campaign's deployment, such as emulators of its devices."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cairn.errors import CairnError
from cairn.processes.orphan_cleanup import set_parent_death_signal

_READY_S = 20.0
_END_S = 5.0


class Programs:
    """Running programs by name; a context manager, which ends them."""

    def __init__(self, commands: Mapping[str, Sequence[str]], folder: Path) -> None:
        """Take the commands; they run in the folder, which gets what they print, as NAME.log."""
        self._commands = commands
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Programs:
        """Start them; each is ready when it has printed something.

        Raises `CairnError` if one does not start, or prints nothing.
        """
        try:
            for name, words in self._commands.items():
                self._start(name, words)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End them: by SIGTERM, and then by SIGKILL."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdin is not None
            with suppress(OSError):
                process.stdin.close()
        self._running.clear()

    def write(self, name: str, text: str) -> None:
        """Write a line to a program; raises `CairnError` if there is none, or it has ended."""
        process = self._running.get(name)
        if process is None:
            known = ", ".join(self._running) or "none"
            raise CairnError(f"the campaign has no program {name}; its programs: {known}")
        assert process.stdin is not None
        try:
            process.stdin.write(f"{text}\n".encode())
        except OSError as error:
            raise CairnError(f"program {name} has ended; see {name}.log") from error

    def _start(self, name: str, words: Sequence[str]) -> None:
        log = self._folder / f"{name}.log"
        with log.open("wb") as output:
            try:
                process = subprocess.Popen(
                    words,
                    stdin=subprocess.PIPE,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    bufsize=0,
                    cwd=self._folder,
                    env=_environment(),
                    process_group=0,
                    preexec_fn=lambda: set_parent_death_signal(signal.SIGTERM),
                )
            except OSError as error:
                raise CairnError(f"program {name}: {words[0]}: {error.strerror}") from error
        self._running[name] = process
        deadline = time.monotonic() + _READY_S
        while log.stat().st_size == 0:
            if process.poll() is not None:
                raise CairnError(f"program {name} has ended, exit status {process.returncode}")
            if time.monotonic() > deadline:
                raise CairnError(f"program {name} has printed nothing for {_READY_S:g} s")
            select.select((), (), (), 0.05)


def _environment() -> dict[str, str]:
    """Return the environment of programs, in which `cairn` is the one that runs the campaign."""
    folders = [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    return {**os.environ, "PATH": os.pathsep.join(folders), "PYTHONUNBUFFERED": "1"}
