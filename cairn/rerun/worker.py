"""Re-runs one start of a component in a process of its own: a crash or a hang ends only that."""

import faulthandler
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import asdict
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from cairn.errors import CairnError
from cairn.processes.orphan_cleanup import set_parent_death_signal
from cairn.recording.reader import McapRecording
from cairn.rerun.call_logs import ComponentStart
from cairn.rerun.result import RerunResult
from cairn.rerun.run import prepared_rerun, starts_in
from cairn.runtime.process_exit import end_process

_RESULT = TypeAdapter(RerunResult)
_SHOWN_LOG: Final = 2000  # characters
_GRACE_S: Final = 30.0
"""Beyond its time limit, the process may take so long for its start and end [s]."""
_WAIT_S: Final = 0.2
_LONGEST_CALL: Final = 300  # bytes
_FATAL, _TIMEOUT, _STACK = "Fatal Python error", "Timeout (0:", "(most recent call first):\n"
"""What `faulthandler` writes when the process crashes or takes too long."""


def rerun_in_processes(
    files: Sequence[Path],
    starts: Sequence[ComponentStart],
    until_ns: int | None,
    time_limit_s: float,
) -> list[RerunResult]:
    """Return the results of re-runs, each made by a new process, as many at a time as cores.

    A crash, a hang and an error are in `incomplete`, with the call in which it was, and the stack.
    """
    running = _Running()

    def rerun(start: ComponentStart) -> RerunResult:
        return _rerun(files, start, until_ns, time_limit_s, running)

    with ThreadPoolExecutor(max(1, min(os.cpu_count() or 1, len(starts)))) as pool:
        try:
            futures = [pool.submit(rerun, start) for start in starts]
            left = set(futures)
            while left:
                # Python misses a Ctrl-C that comes just as a wait begins, until the wait ends.
                done, left = wait(left, _WAIT_S, FIRST_EXCEPTION)
                for future in done:
                    future.result()
            return [future.result() for future in futures]
        except BaseException:  # such as Ctrl-C, which must not wait for the time limit
            pool.shutdown(wait=False, cancel_futures=True)
            running.kill()
            raise


class _Running:
    """The processes that run; `kill` ends those that are being started, too."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._killed = False

    def start(self, start: Callable[[], "subprocess.Popen[bytes]"]) -> "subprocess.Popen[bytes]":
        """Start a process; `CairnError` after `kill`."""
        with self._lock:
            if self._killed:
                raise CairnError("interrupted")
            process = start()
            self._processes.add(process)
            return process

    def ended(self, process: "subprocess.Popen[bytes]") -> None:
        """Note that a process has ended."""
        with self._lock:
            self._processes.discard(process)

    def kill(self) -> None:
        """Kill all, and start no more."""
        with self._lock:
            self._killed = True
            for process in self._processes:
                process.kill()


def _rerun(
    files: Sequence[Path],
    start: ComponentStart,
    until_ns: int | None,
    time_limit_s: float,
    running: _Running,
) -> RerunResult:
    """Return the result of one; its process is in `running` meanwhile."""
    result = RerunResult(start.component, start.incarnation)
    with tempfile.TemporaryDirectory(prefix="cairn-rerun-") as folder:
        answer, log, call = (Path(folder, name) for name in ("result.json", "log", "call"))
        call.touch()
        request = {
            "parent": os.getpid(),
            "files": [str(file.absolute()) for file in files],
            "component": start.component,
            "incarnation": start.incarnation,
            "started_ns": start.started_ns,
            "until_ns": until_ns,
            "time_limit_s": time_limit_s,
            "answer": str(answer),
            "call": str(call),
        }
        with log.open("wb") as stream:
            command = [sys.executable, "-P", "-m", "cairn.rerun.worker"]  # not from this folder
            process = running.start(
                lambda: subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=stream, stderr=stream,
                    start_new_session=True, env={**os.environ, "PYTHONFAULTHANDLER": "1"},
                )
            )  # fmt: skip
            try:
                process.communicate(json.dumps(request).encode(), time_limit_s + _GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                log.write_text(_TIMEOUT)
            running.ended(process)
        try:
            return _RESULT.validate_json(answer.read_bytes())
        except (OSError, ValidationError):
            text = log.read_text(encoding="utf-8", errors="replace").strip()
            where = call.read_text(encoding="utf-8", errors="replace").strip()
            where = where or "before its first call"
            result.incomplete = _explained(process.returncode, text, where, time_limit_s)
            return result


def _explained(status: int, log: str, where: str, time_limit_s: float) -> str:
    """Return why a process has no result: its exit status, its log, and in which call it was."""
    if _TIMEOUT in log:
        stack = log.rpartition(_STACK)[2]  # that of the main thread
        return (
            f"the re-run took longer than {time_limit_s:g} s; it was {where}; give a longer "
            f"--time-limit, or correct the handler if it hangs:\n{stack[:_SHOWN_LOG]}"
        )
    _, fatal, rest = log.partition(_FATAL)
    shown = (fatal + rest)[:_SHOWN_LOG] if fatal else log[-_SHOWN_LOG:]
    return f"its process ended with status {status}, {where}: {shown}"


def main() -> None:
    """Make the re-run that stdin describes, and write its result to a file."""
    logging.basicConfig(level=logging.ERROR)
    set_parent_death_signal(signal.SIGKILL)
    request: dict[str, Any] = json.load(sys.stdin)
    if os.getppid() != request["parent"]:  # it ended before it could be noticed
        return
    faulthandler.dump_traceback_later(request["time_limit_s"], exit=True)
    name, incarnation = request["component"], request["incarnation"]
    result = RerunResult(name, incarnation)
    try:
        with McapRecording([Path(file) for file in request["files"]]) as recording:
            start = next(
                one
                for one in starts_in(recording)
                if (one.component, one.incarnation, one.started_ns)
                == (name, incarnation, request["started_ns"])
            )
            with (
                Path(request["call"]).open("wb", buffering=0) as calls,
                prepared_rerun(
                    recording, start, request["until_ns"], on_call=partial(_note, calls)
                ) as rerun,
            ):
                result = rerun.run()
    except (CairnError, OSError) as error:  # a path in the log may be too long for a file
        result.incomplete = str(error)
    faulthandler.cancel_dump_traceback_later()
    Path(request["answer"]).write_text(json.dumps(asdict(result)))


def _note(file: FileIO, time_ns: int, call: str) -> None:
    """Write to a file in which call the process is: it may not return from it."""
    text = f"in {call}, at {time_ns / 1e9:.6f} s".encode()[:_LONGEST_CALL]
    os.pwrite(file.fileno(), text.ljust(_LONGEST_CALL), 0)


if __name__ == "__main__":
    main()
    end_process(0)  # also if threads of the component still run
