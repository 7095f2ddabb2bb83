"""Starts processes through a zygote, signals them and tells of their end."""

import contextlib
import logging
import os
import signal
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn.errors import CairnError
from cairn.supervision.child import LauncherLost
from cairn.supervision.child_process import ChildExit, ChildProcess
from cairn.supervision.zygote_protocol import (
    Answer,
    Done,
    Ended,
    Hello,
    Lines,
    ProtocolError,
    Refused,
    Request,
    Signal,
    Spawn,
    Spawned,
    read_answer,
    request_line,
)

_ANSWER_LIMIT_S = 5.0
_SEND_LIMIT = struct.pack("ll", 5, 0)  # struct timeval [s, us]
_log = logging.getLogger(__name__)


class ZygoteLost(LauncherLost):
    """The zygote has ended: all processes that it started are killed, none can be started."""


class SpawnFailed(CairnError):  # noqa: N818 - reads as what happened
    """A process could not be started; the message says why."""


@dataclass(frozen=True)
class _Asked:
    name: str  # of the process to be started
    answer: "Future[Any]"


class ZygoteClient:
    """A connection to a zygote, which owns the processes spawned over it.

    When it closes, or the process that holds it ends, they are killed with their process groups.
    For use by one thread. A thread of its own calls `on_exit` for each process that ended, and
    `on_lost` if the zygote ends, before `on_exit` for all processes that end with it; neither may
    ask anything of the client.
    """

    def __init__(
        self,
        socket_path: Path,
        on_exit: Callable[[ChildExit], None] | None = None,
        on_lost: Callable[[ZygoteLost], None] | None = None,
        timeout_s: float = 60.0,
    ) -> None:
        """Connect, and wait at most `timeout_s` seconds for the zygote's imports.

        Raises `ZygoteLost` if no zygote listens there or it ends, `CairnError` at the time limit.
        """
        self._path = socket_path
        self._on_exit = on_exit
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._over: CairnError | None = None  # why nothing can be asked any more
        self._requests = 0
        hello: Future[Hello] = Future()
        self._asked: dict[int, _Asked] = {0: _Asked("", hello)}
        self._children: dict[int, ChildProcess] = {}
        self._socket = _connect(socket_path, timeout_s)
        self._reader = threading.Thread(target=self._read, name="zygote client", daemon=True)
        self._reader.start()
        try:
            greeting = self._result(hello, timeout_s, "finish its imports")
        except CairnError:
            self.close(0.0)
            raise
        self.zygote_pid: int = greeting.pid
        self.preload_failures: Mapping[str, str] = greeting.failures  # module: why
        self.preload_threads: Mapping[str, list[str]] = greeting.threads  # module: threads it left

    def spawn(
        self,
        name: str,
        entry: str,
        argument: Mapping[str, Any],
        log_file: Path,
        *,
        fresh: bool = False,
        needs: Sequence[str] = (),
        timeout_s: float = 10.0,
    ) -> ChildProcess:
        """Start a process that calls `entry` ("package.module:function") with a JSON-able dict.

        Its output is appended to the log file. It ends with exit code 0 when the entry returns, 1
        with a traceback in the log when it raises. With `fresh` it gets a new interpreter instead
        of a fork of the zygote; else the modules in `needs` must have been imported there.

        Raises `SpawnFailed` with the reason, `ZygoteLost`, or `CairnError` at the time limit,
        after which the process, should it be started late, is killed; `TypeError` or `ValueError`
        for arguments that are not as said.
        """
        number, started = self._next(name)
        self._send(
            Spawn(number, name, entry, dict(argument), os.fspath(log_file), fresh, tuple(needs))
        )
        child: ChildProcess = self._result(started, timeout_s, f"start {name}", number)
        return child

    def signal(self, pid: int, number: int) -> None:
        """Send a signal to a process spawned here; nothing if it has ended.

        Raises `CairnError` if the zygote does not answer.
        """
        self._signal(pid, number, False)

    def kill(self, pid: int) -> None:
        """Kill a process spawned here and all of its group; nothing if it has ended."""
        self._signal(pid, signal.SIGKILL, True)

    def close(self, timeout_s: float = 5.0) -> None:
        """Kill all processes spawned here, and wait at most `timeout_s` seconds for their end."""
        with self._lock:
            self._over = self._over or CairnError(f"the connection to {self._path} is closed")
            with contextlib.suppress(OSError):  # the zygote was the first to close it
                self._socket.shutdown(socket.SHUT_WR)
        if self._reader is not threading.current_thread():
            self._reader.join(timeout_s)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _signal(self, pid: int, number: int, group: bool) -> None:
        if self._over is None:
            with contextlib.suppress(ZygoteLost):  # then it is killed
                request, done = self._next("")
                self._send(Signal(request, pid, number, group))
                self._result(done, _ANSWER_LIMIT_S, f"send a signal to process {pid}", request)

    def _next(self, name: str) -> "tuple[int, Future[Any]]":
        if threading.current_thread() is self._reader:
            raise RuntimeError("on_exit and on_lost must not ask anything of the zygote")
        with self._lock:
            if self._over is not None:
                raise self._over
            self._requests += 1
            asked = _Asked(name, Future())
            self._asked[self._requests] = asked
            return self._requests, asked.answer

    def _result(self, answer: "Future[Any]", timeout_s: float, what: str, request: int = 0) -> Any:
        try:
            return answer.result(timeout_s)
        except TimeoutError:
            with self._lock:
                self._asked.pop(request, None)
            raise CairnError(
                f"the zygote on {self._path} did not {what} within {timeout_s:g} s"
            ) from None

    def _send(self, request: Request) -> None:
        line = request_line(request)
        try:
            with self._lock:
                self._socket.sendall(line)
        except OSError:  # ended, or stuck with half a line sent: the reader tells
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _read(self) -> None:
        lines = Lines()
        reason = "it has closed the connection"
        try:
            while data := self._socket.recv(1 << 16):
                for line in lines.feed(data):
                    self._take(read_answer(line))
        except (OSError, ProtocolError) as error:
            reason = str(error)
        self._end(ZygoteLost(f"the zygote on {self._path} is lost: {reason}"))

    def _take(self, answer: Answer) -> None:
        match answer:
            case Hello():
                self._resolve(0, answer)
            case Spawned(request, pid):
                self._spawned(request, pid)
            case Done(request):
                self._resolve(request, None)
            case Refused(request, error):
                self._refused(request, error)
            case Ended(pid, name, code, number):
                self._ended(ChildExit(pid, name, code, number))

    def _spawned(self, request: int, pid: int) -> None:
        with self._lock:
            asked = self._asked.pop(request, None)
            if asked is not None:
                child = self._children[pid] = ChildProcess(asked.name, pid, self._signal)
        if asked is None:  # nobody waits for it any more
            self._send(Signal(-1, pid, signal.SIGKILL, True))
        else:
            asked.answer.set_result(child)

    def _resolve(self, request: int, result: Any) -> None:
        with self._lock:
            asked = self._asked.pop(request, None)
        if asked is not None:
            asked.answer.set_result(result)

    def _refused(self, request: int, error: str) -> None:
        with self._lock:
            asked = self._asked.pop(request, None)
        if asked is not None:
            asked.answer.set_exception(
                SpawnFailed(f"{asked.name} could not be started: {error}")
                if asked.name
                else CairnError(f"a signal could not be sent: {error}")
            )

    def _ended(self, how: ChildExit) -> None:
        with self._lock:
            child = self._children.pop(how.pid, None)
        if child is not None:
            child.ended(how)
            self._tell(self._on_exit, how)

    def _end(self, lost: ZygoteLost) -> None:
        with self._lock:
            closed, self._over = self._over is not None, self._over or lost
            asked, self._asked = list(self._asked.values()), {}
            self._socket.close()
        for one in asked:
            one.answer.set_exception(self._over)
        for pid in self._children:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # their death signal spares grandchildren
        if not closed:
            self._tell(self._on_lost, lost)
        for child in list(self._children.values()):
            self._ended(ChildExit(child.pid, child.name, None, signal.SIGKILL))

    def _tell(self, callback: Callable[[Any], None] | None, what: object) -> None:
        try:
            if callback is not None:
                callback(what)
        except Exception:
            _log.exception("the callback for %s failed", what)


def _connect(path: Path, timeout_s: float) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(timeout_s)
    try:
        connection.connect(os.fspath(path))
    except OSError as error:
        connection.close()
        raise ZygoteLost(f"no zygote listens on {path}: {error}") from error
    connection.settimeout(None)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _SEND_LIMIT)
    return connection
