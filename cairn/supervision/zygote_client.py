"""A client of the zygote: spawns processes through it, signals them, and learns how they ended."""

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
from cairn.supervision.zygote_protocol import (
    Answer,
    Done,
    Exited,
    Hello,
    LineSplitter,
    ProtocolError,
    Request,
    RequestRefused,
    Signal,
    Spawn,
    Spawned,
    decode_answer,
    encode_request,
)

_ANSWER_LIMIT_S = 5.0
_SEND_LIMIT = struct.pack("ll", 5, 0)  # struct timeval [s, us]
_log = logging.getLogger(__name__)


class ZygoteLost(LauncherLost):
    """The zygote has ended: all processes that it started are killed, none can be started."""


class SpawnFailed(CairnError):  # noqa: N818 - reads as what happened
    """A process could not be started; the message gives the reason."""


class ChildProcess:
    """A process spawned through the zygote; it leads a process group of its own."""

    def __init__(self, name: str, pid: int, send_signal: Callable[[int, int, bool], None]) -> None:
        """`send_signal` takes process id, signal number and whether the group is meant."""
        self.name = name
        self.pid = pid
        self._send_signal = send_signal
        self._exited: Future[Exited] = Future()

    @property
    def exited(self) -> Exited | None:
        """How it ended, None while it runs."""
        return self._exited.result(0) if self._exited.done() else None

    def wait(self, timeout_s: float) -> Exited | None:
        """Wait for its end and that of its process group; None if it still runs then."""
        with contextlib.suppress(TimeoutError):
            return self._exited.result(timeout_s)
        return None

    def on_exit(self, call: Callable[[Exited], object]) -> None:
        """Have `call` made when it has ended, on the client's thread; at once if it has.

        `call` must not make requests to the zygote.
        """
        self._exited.add_done_callback(lambda exited: call(exited.result()))

    def signal(self, number: int) -> None:
        """Send a signal to the process alone; no effect if it has ended.

        Raises `CairnError` if the zygote does not answer.
        """
        if not self._exited.done():
            self._send_signal(self.pid, number, False)

    def terminate(self) -> None:
        """Ask it to end, by SIGTERM."""
        self.signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill its whole process group; no effect if it has ended; see `signal`."""
        if not self._exited.done():
            self._send_signal(self.pid, signal.SIGKILL, True)

    def set_exited(self, exited: Exited) -> None:
        """Record how it ended; for the zygote's client."""
        self._exited.set_result(exited)


@dataclass(frozen=True)
class _Pending:
    name: str  # of the process to be started, "" for other requests
    answer: "Future[Any]"


class ZygoteClient:
    """A connection to a zygote, which owns the processes spawned over it.

    When it closes, or the process that holds it ends, they are killed with their process groups.
    For use by one thread. A thread of its own calls `ChildProcess.on_exit` callbacks, and `on_lost`
    if the zygote ends, before the exits of all processes that end with it; none of them may make
    requests to the client.
    """

    def __init__(
        self,
        socket_path: Path,
        on_lost: Callable[[ZygoteLost], None] | None = None,
        timeout_s: float = 60.0,
    ) -> None:
        """Connect, and wait at most `timeout_s` seconds for the zygote's imports.

        Raises `ZygoteLost` if no zygote listens there or it ends, `CairnError` at the time limit.
        """
        self._path = socket_path
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._closed: CairnError | None = None  # why no more requests can be made
        self._requests = 0
        hello: Future[None] = Future()
        self._pending: dict[int, _Pending] = {0: _Pending("", hello)}
        self._children: dict[int, ChildProcess] = {}
        self._socket = _connect(socket_path, timeout_s)
        self._reader = threading.Thread(target=self._read, name="zygote client", daemon=True)
        self._reader.start()
        try:
            self._result(hello, timeout_s, "finish its imports")
        except CairnError:
            self.close(0.0)
            raise

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
        of a fork of the zygote; otherwise the zygote must have imported the modules in `needs`.

        Raises `SpawnFailed` with the reason, `ZygoteLost`, or `CairnError` at the time limit; if
        the process is started after that, it is killed. Raises `TypeError` or `ValueError` for
        arguments of wrong form.
        """
        number, started = self._next_request(name)
        self._send(
            Spawn(number, name, entry, dict(argument), os.fspath(log_file), fresh, tuple(needs))
        )
        child: ChildProcess = self._result(started, timeout_s, f"start {name}", number)
        return child

    def close(self, timeout_s: float = 5.0) -> None:
        """Kill all processes spawned here, and wait at most `timeout_s` seconds for their end."""
        with self._lock:
            self._closed = self._closed or CairnError(f"the connection to {self._path} is closed")
            with contextlib.suppress(OSError):  # the zygote was the first to close it
                self._socket.shutdown(socket.SHUT_WR)
        if self._reader is not threading.current_thread():
            self._reader.join(timeout_s)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _send_signal(self, pid: int, number: int, group: bool) -> None:
        if self._closed is None:
            with contextlib.suppress(ZygoteLost):  # then the process is killed
                request, done = self._next_request("")
                self._send(Signal(request, pid, number, group))
                self._result(done, _ANSWER_LIMIT_S, f"send a signal to process {pid}", request)

    def _next_request(self, name: str) -> "tuple[int, Future[Any]]":
        if threading.current_thread() is self._reader:
            raise RuntimeError("on_exit and on_lost must not make requests to the zygote")
        with self._lock:
            if self._closed is not None:
                raise self._closed
            self._requests += 1
            pending = _Pending(name, Future())
            self._pending[self._requests] = pending
            return self._requests, pending.answer

    def _result(self, answer: "Future[Any]", timeout_s: float, what: str, request: int = 0) -> Any:
        try:
            return answer.result(timeout_s)
        except TimeoutError:
            with self._lock:
                self._pending.pop(request, None)
            raise CairnError(
                f"the zygote on {self._path} did not {what} within {timeout_s:g} s"
            ) from None

    def _send(self, request: Request) -> None:
        line = encode_request(request)
        try:
            with self._lock:
                self._socket.sendall(line)
        except OSError:  # ended, or stuck with half a line sent: the reader reports it
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _read(self) -> None:
        lines = LineSplitter()
        reason = "it has closed the connection"
        try:
            while data := self._socket.recv(1 << 16):
                for line in lines.feed(data):
                    self._handle(decode_answer(line))
        except (OSError, ProtocolError) as error:
            reason = str(error)
        self._end(ZygoteLost(f"zygote lost: {self._path}: {reason}"))

    def _handle(self, answer: Answer) -> None:
        match answer:
            case Hello():
                self._resolve(0)
            case Spawned(request, pid):
                self._spawned(request, pid)
            case Done(request):
                self._resolve(request)
            case RequestRefused(request, error):
                self._refused(request, error)
            case Exited():
                self._exited(answer)

    def _spawned(self, request: int, pid: int) -> None:
        with self._lock:
            pending = self._pending.pop(request, None)
            if pending is not None:
                child = self._children[pid] = ChildProcess(pending.name, pid, self._send_signal)
        if pending is None:  # the request has timed out
            self._send(Signal(-1, pid, signal.SIGKILL, True))
        else:
            pending.answer.set_result(child)

    def _resolve(self, request: int) -> None:
        with self._lock:
            pending = self._pending.pop(request, None)
        if pending is not None:
            pending.answer.set_result(None)

    def _refused(self, request: int, error: str) -> None:
        with self._lock:
            pending = self._pending.pop(request, None)
        if pending is not None:
            pending.answer.set_exception(
                SpawnFailed(f"{pending.name} could not be started: {error}")
                if pending.name
                else CairnError(f"a signal could not be sent: {error}")
            )

    def _exited(self, exited: Exited) -> None:
        with self._lock:
            child = self._children.pop(exited.pid, None)
        if child is not None:
            child.set_exited(exited)

    def _end(self, lost: ZygoteLost) -> None:
        with self._lock:
            closed, self._closed = self._closed is not None, self._closed or lost
            pending, self._pending = list(self._pending.values()), {}
            self._socket.close()
        for one in pending:
            one.answer.set_exception(self._closed)
        for pid in self._children:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # their death signal spares grandchildren
        try:
            if not closed and self._on_lost is not None:
                self._on_lost(lost)
        except Exception:
            _log.exception("handling the loss of the zygote failed")
        for child in list(self._children.values()):
            self._exited(Exited(child.pid, child.name, None, signal.SIGKILL))


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
