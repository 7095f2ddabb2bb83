"""Requests to a machine, by the system's `ssh`, whose users, ports and keys ssh_config(5) has."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

from cairn.errors import CairnError
from cairn.system.files import explain_os_error

_PROGRAM: Final = Path(__file__).with_name("machine_side.py")
_DESTINATION: Final = re.compile(r"([A-Za-z0-9_][A-Za-z0-9_.-]*@)?[A-Za-z0-9_:][A-Za-z0-9_.:%-]*")
_OPTIONS: Final = ("-T", "-o", "ConnectTimeout=10", "-o", "ServerAliveInterval=15")
_SSH_FAILED: Final = 255
_NOT_FOUND: Final = 127
_LONGEST_REASON: Final = 2000


@dataclass(frozen=True)
class Host:
    """A computer as ssh names it, `[USER@]HOST`; `config` replaces the user's ~/.ssh/config."""

    destination: str
    config: Path | None = None

    def __post_init__(self) -> None:
        if not _DESTINATION.fullmatch(self.destination):
            raise CairnError(f"--to {self.destination!r}: it is not a destination [USER@]HOST")

    def request(
        self, request: Mapping[str, Any], write: Callable[[IO[bytes]], None] | None = None
    ) -> dict[str, Any]:
        """Make a request of the machine's side; `write` writes what that reads from stdin.

        Raises `CairnError` if the machine cannot be reached, or refuses it.
        """
        source = _PROGRAM.read_text(encoding="utf-8")
        remote = shlex.join(["python3", "-c", source, json.dumps(request)])
        config = [] if self.config is None else ["-F", str(self.config)]
        command = ["ssh", *config, *_OPTIONS, "--", self.destination, remote]
        with tempfile.TemporaryFile() as errors:
            try:
                process = subprocess.Popen(
                    command, stdout=subprocess.PIPE, stderr=errors,
                    stdin=subprocess.DEVNULL if write is None else subprocess.PIPE,
                )  # fmt: skip
            except OSError as error:
                raise CairnError(f"ssh: {error.strerror}; install OpenSSH's client") from error
            with process:
                assert process.stdout is not None
                if write is not None and process.stdin is not None:
                    try:
                        with process.stdin as stream:
                            write(stream)
                    except BrokenPipeError:
                        pass  # its answer has the reason
                    except OSError as error:
                        process.kill()
                        raise CairnError(
                            f"{error.filename}: cannot be copied: {explain_os_error(error)}"
                        ) from error
                    except BaseException:
                        process.kill()
                        raise
                output = process.stdout.read()
            errors.seek(0)
            reason = errors.read().decode(errors="replace").strip()[-_LONGEST_REASON:]
        return self._answer(process.returncode, output, reason)

    def _answer(self, status: int, output: bytes, reason: str) -> dict[str, Any]:
        if status == _SSH_FAILED:
            raise CairnError(f"{reason or 'the connection was lost'}; try: ssh {self.destination}")
        if status == _NOT_FOUND:
            raise CairnError("there is no python3 there; install python3 and python3-venv")
        try:
            found: dict[str, Any] = json.loads(output)
        except ValueError as error:
            raise CairnError(
                f"no answer (exit status {status}): {reason or output[-200:]!r}; does its shell "
                "print something when it starts?"
            ) from error
        if "error" in found:
            raise CairnError(found["error"])
        return found
