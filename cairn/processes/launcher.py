"""Launches components in processes of their own, through the zygote, and makes requests to them.

The root of the tree starts the zygote (`start_zygote`). Each supervisor with children in processes
of their own has a connection to it (`ZygoteClient`), and a channel to each child (`ProcessHandle`).
"""

import itertools
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import psutil

from cairn.deployment.plugins import find_plugin
from cairn.errors import CairnError
from cairn.processes.child import ChildUnavailable, ZygoteLost
from cairn.processes.child_channel import (
    Heartbeat,
    InvalidPacket,
    SupervisorChannel,
    Verb,
    channel_pair,
)
from cairn.processes.orphan_cleanup import MARK, kill_marked
from cairn.processes.zygote import (
    ANSWER,
    BOOTSTRAP,
    Answer,
    Exited,
    Signal,
    Spawn,
    encode,
)
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.process_exit import ExitLog, ExitReport
from cairn.system.files import explain_os_error
from cairn.system.heap import SMALL_THREAD_CACHES, TUNABLES
from cairn.system.runtime_folder import VARIABLE, check_length, private_folder

ENTRY = "cairn.processes.component_process:main"
"""What every component's process runs."""
TRACEBACK_SIGNAL = signal.SIGUSR1
"""A component's process that receives it logs the stacks of all of its threads."""
_TRACEBACK_POLL_S = 0.01
_TRACEBACK = b"(most recent call first)"
_PAGE_BYTES = os.sysconf("SC_PAGESIZE")
_KILL_LIMIT_S = 5.0
_EXIT_AFTER_ERROR_S = 0.2  # a component that refuses a request ends soon after
_LEAVING_LIMIT_S = 5.0  # between the end of its channel and that of the process
_POLL_S = 0.05
_LONGEST_STEP_S = 0.25
"""A wait is made in steps of `_POLL_S`; one that took longer, because this process could not run,
counts as at most so long."""
_PIECE_S = 0.25
_KILLED_LIMIT_S = 10.0  # for killed processes to end, on a computer without processor time
_SEND_LIMIT = struct.pack("ll", 5, 0)  # struct timeval [s, us]
# glibc would map and unmap memory for each image, which takes longer than all the rest: so it keeps
# freed memory for the next one, but not more than this in each heap. See lab/history.md.
_KEPT_BYTES = str(32 << 20)
# All threads of a process share one heap. Otherwise each thread that happens to make a call keeps
# the memory of the largest one in a heap of its own: the localizer took 18 MiB instead of 7 after
# nine kidnappings.
_MALLOC = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": _KEPT_BYTES,
    "MALLOC_TRIM_THRESHOLD_": _KEPT_BYTES,
    "MALLOC_TOP_PAD_": str(1 << 20),
    TUNABLES: SMALL_THREAD_CACHES,
}
# A process with threads must not fork, and numpy's OpenBLAS would start some when imported.
_SINGLE_THREADED = {"OPENBLAS_NUM_THREADS": "1"}
_KEEP_MARK = {"SPT_NOENV": "1"}  # setproctitle would overwrite the environment, and the mark in it


class ZygoteProcess:
    """A running zygote, as the process sees it that started it: the root of the tree.

    When the root ends, in whatever way, the zygote kills all processes and ends.
    """

    def __init__(
        self, process: "subprocess.Popen[bytes]", socket_path: Path, log_file: Path, mark: str
    ) -> None:
        self.process = process
        self.socket_path = socket_path
        self.log_file = log_file
        self._mark = mark

    @property
    def stopped(self) -> bool:
        """Whether it has been stopped by a signal (SIGSTOP), so that it does not serve."""
        try:
            return psutil.Process(self.process.pid).status() == psutil.STATUS_STOPPED
        except psutil.NoSuchProcess:
            return False

    def wait_for_imports(self, timeout_s: float) -> None:
        """Wait until the zygote has imported its modules or has ended, at most `timeout_s` [s]."""
        with suppress(CairnError):
            ZygoteClient(self.socket_path, timeout_s=timeout_s).close()

    def close(self, timeout_s: float = 10.0) -> None:
        """End the zygote and all processes of the tree, also if the zygote has been killed.

        The zygote has `timeout_s` [s] to do that itself. Raises `CairnError` if some processes do
        not end by SIGKILL.
        """
        if self.process.stdin is not None:
            self.process.stdin.close()
        self.process.terminate()  # while it imports, it does not watch its standard input
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(_KILLED_LIMIT_S)
        left = kill_marked(self._mark, _KILLED_LIMIT_S)
        self.socket_path.unlink(missing_ok=True)
        if left:
            raise CairnError(f"these processes do not end even by SIGKILL: {left}")


def start_zygote(preload: Sequence[str], runtime_dir: Path) -> ZygoteProcess:
    """Start a zygote that imports these modules and then serves `ZygoteClient`s.

    Returns at once; a client waits for the imports. The runtime directory is created if it does
    not exist; it contains the socket and the log of the zygote. Call it from the main thread,
    before or after opening Zenoh sessions. Raises `CairnError` if the directory is open to other
    users or its path too long.
    """
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("the zygote ends with the thread that starts it: use the main thread")
    private_folder(runtime_dir)
    mark = uuid4().hex
    socket_path = check_length(runtime_dir / f"zygote-{mark[:8]}.sock")
    log_file = runtime_dir / "zygote.log"
    try:
        with (
            socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener,
            log_file.open("ab") as log,
        ):
            listener.bind(os.fspath(socket_path))
            listener.listen(64)
            arguments = map(json.dumps, (os.getpid(), listener.fileno(), list(preload)))
            bootstrap = ["-P", "-c", BOOTSTRAP, json.dumps(sys.path)]
            process = subprocess.Popen(
                [sys.executable, *bootstrap, "cairn.processes.zygote:main", *arguments],
                stdin=subprocess.PIPE,  # the lifeline: it closes when this process ends
                stdout=log,
                stderr=log,
                pass_fds=[listener.fileno()],
                start_new_session=True,  # the terminal's Ctrl-C reaches the root only
                env={**_SINGLE_THREADED, **_MALLOC, **os.environ, **_KEEP_MARK, MARK: mark},
            )
    except OSError as error:
        raise CairnError(
            f"{runtime_dir}: the zygote cannot be started: {explain_os_error(error)}, or set "
            f"{VARIABLE} to another folder"
        ) from error
    return ZygoteProcess(process, socket_path, log_file, mark)


class ChildProcess:
    """A process spawned through the zygote; it leads a process group of its own."""

    def __init__(self, pid: int, send: Callable[[Signal], None]) -> None:
        self.pid = pid
        self.exit: Future[Exited] = Future()
        """How it ended; set on the client's thread."""
        self._send = send

    def wait(self, timeout_s: float) -> Exited | None:
        """Wait for its end and that of its process group; None if it still runs then.

        In short pieces: a pause of this machine, which delays the report, uses up only one of them.
        """
        pieces = max(1, math.ceil(timeout_s / _PIECE_S))
        for _ in range(pieces):
            with suppress(TimeoutError):
                return self.exit.result(timeout_s / pieces)
        return None

    def on_exit(self, call: Callable[[Exited], object]) -> None:
        """Have `call` made when it has ended, on the client's thread; at once if it has.

        `call` must not spawn processes.
        """
        self.exit.add_done_callback(lambda exited: call(exited.result()))

    def signal(self, number: int, *, group: bool = False) -> None:
        """Send a signal to the process, or kill its whole group; no effect if it has ended."""
        if not self.exit.done():
            self._send(Signal(self.pid, number, group))

    def terminate(self) -> None:
        """Ask it to end, by SIGTERM."""
        self.signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill its whole process group."""
        self.signal(signal.SIGKILL, group=True)


class ZygoteClient:
    """A connection to a zygote, which owns the processes spawned over it.

    When it closes, or the process that holds it ends, they are killed with their process groups.
    Any thread may spawn processes. A thread of the client's own calls `ChildProcess.on_exit`
    callbacks, and `on_lost` if the zygote ends, before the exits of all processes that end with it;
    none of them may spawn processes.
    """

    def __init__(
        self,
        socket_path: Path,
        on_lost: Callable[[ZygoteLost], None] = lambda _: None,
        canceled: Callable[[], bool] = lambda: False,
        timeout_s: float = 60.0,
    ) -> None:
        """Connect, and wait at most `timeout_s` seconds for the zygote's imports.

        Once `canceled()`, nothing is waited for any more. Raises `ZygoteLost` if no zygote listens
        there or it ends, `ChildUnavailable` at the time limit, `CairnError` if canceled.
        """
        self._path = socket_path
        self._on_lost = on_lost
        self._canceled = canceled
        self._lock = threading.Lock()
        self._closed: CairnError | None = None  # why no more processes can be spawned
        self._numbers = itertools.count(1)
        ready: Future[ChildProcess] = Future()
        self._pending = {0: ready}  # answers by request
        self._children: dict[int, ChildProcess] = {}
        self._socket = _connect(socket_path, timeout_s)
        self._reader = threading.Thread(target=self._read, name="zygote client", daemon=True)
        self._reader.start()
        try:
            self._wait(0, ready, timeout_s, "finish its imports")
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
        channel: socket.socket | None = None,
        timeout_s: float = 10.0,
    ) -> ChildProcess:
        """Start a process that calls `entry` ("package.module:function") with a JSON-able dict.

        Its output is appended to the log file. It ends with exit code 0 when the entry returns, 1
        with a traceback in the log when it raises. With `fresh` it gets a new interpreter instead
        of a fork of the zygote; otherwise the zygote must have imported the modules in `needs`. The
        entry gets a copy of the socket `channel`, if there is one, as second argument.

        Raises `ZygoteLost`, `CairnError` with the reason if the zygote refuses, `ChildUnavailable`
        at the time limit; if the process is started after that, it is killed. Raises `TypeError` or
        `ValueError` for arguments of wrong form.
        """
        number = next(self._numbers)
        log = os.fspath(log_file)
        passed = channel is not None
        request = Spawn(number, name, entry, dict(argument), log, fresh, tuple(needs), passed)
        answer: Future[ChildProcess] = Future()
        with self._lock:
            if self._closed is not None:
                raise self._closed
            self._pending[number] = answer
        self._send(request, channel)
        return self._wait(number, answer, timeout_s, f"start {name}")

    def close(self, timeout_s: float = 5.0) -> None:
        """Kill all processes spawned here, and wait at most `timeout_s` seconds for their end."""
        with self._lock:
            self._closed = self._closed or CairnError(f"the connection to {self._path} is closed")
            with suppress(OSError):  # the zygote was the first to close it
                self._socket.shutdown(socket.SHUT_WR)
        self._reader.join(timeout_s)
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _wait(
        self, number: int, answer: "Future[ChildProcess]", timeout_s: float, step: str
    ) -> ChildProcess:
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = deadline - time.monotonic()
            with suppress(TimeoutError):
                return answer.result(max(0.0, min(left_s, _PIECE_S)))
            if left_s > _PIECE_S and not self._canceled():
                continue
            with self._lock:
                unanswered = self._pending.pop(number, None) is not None
            if not unanswered:  # the reader has just taken the answer
                return answer.result()
            if left_s > _PIECE_S:
                raise CairnError("a stop was requested")
            raise ChildUnavailable(
                f"the zygote on {self._path} did not {step} within {timeout_s:g} s; "
                "reduce the load of this computer"
            )

    def _send(self, request: Spawn | Signal, channel: socket.socket | None = None) -> None:
        line = encode(request)
        descriptors = [] if channel is None else [channel.fileno()]
        try:
            with self._lock:
                if self._closed is None:  # otherwise all processes are killed anyway
                    sent = socket.send_fds(self._socket, [line], descriptors)
                    self._socket.sendall(line[sent:])
        except OSError:  # ended, or stuck with half a line sent: the reader reports it
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _read(self) -> None:
        reason = "it has closed the connection"
        try:
            with self._socket.makefile("rb") as lines:
                for line in lines:
                    message = ANSWER.validate_json(line)
                    if isinstance(message, Exited):
                        self._on_exited(message)
                    else:
                        self._on_answer(message)
        except (OSError, ValueError) as error:
            reason = str(error)
        self._on_end(ZygoteLost(f"zygote lost: {self._path}: {reason}"))

    def _on_answer(self, answer: Answer) -> None:
        child = ChildProcess(answer.pid, self._send)
        with self._lock:
            pending = self._pending.pop(answer.request, None)
            if pending is not None and answer.pid:
                self._children[answer.pid] = child
        if pending is None:  # the request has timed out
            if answer.pid:
                child.kill()
        elif answer.error:
            pending.set_exception(CairnError(answer.error))
        else:
            pending.set_result(child)

    def _on_exited(self, exited: Exited) -> None:
        child = self._children.pop(exited.pid, None)
        if child is not None:
            child.exit.set_result(exited)

    def _on_end(self, lost: ZygoteLost) -> None:
        with self._lock:
            closed, self._closed = self._closed is not None, self._closed or lost
            pending, self._pending = list(self._pending.values()), {}
            self._socket.close()
        for answer in pending:
            answer.set_exception(self._closed)
        for pid in self._children:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # their death signal spares grandchildren
        try:
            if not closed:
                self._on_lost(lost)
        finally:
            for pid in list(self._children):
                self._on_exited(Exited(pid, -signal.SIGKILL))


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


class ProcessHandle:
    """A component in a process of its own, which `launch` starts; see `ChildHandle`."""

    def __init__(self, launch: LaunchRequest) -> None:
        self._launch = launch
        self._log = ExitLog(Path(launch.context.log_folder) / f"{launch.name}.log")
        self._channel: SupervisorChannel  # set by `launch`
        self._reported = 0  # heartbeats that `heartbeat` has returned
        self._process: ChildProcess | None = None
        self._starting = True
        self._canceled = False

    def launch(self, zygote: ZygoteClient, on_exit: Callable[[], None]) -> None:
        """Start the process and wait until it accepts requests: for its first heartbeat.

        See `SupervisorHost.launch_child`.
        """
        launch, timeout_s = self._launch, self._launch.spec.start_limit_s
        fresh = launch.spec.interpreter == "fresh"
        own, passed = channel_pair()
        self._channel = SupervisorChannel(own)
        with passed:
            self._process = process = zygote.spawn(
                launch.name,
                ENTRY,
                launch.model_dump(mode="json"),
                self._log.file,
                fresh=fresh,
                needs=[] if fresh else [find_plugin(launch.spec.plugin).partition(":")[0]],
                channel=passed,
                timeout_s=timeout_s,
            )
        process.on_exit(lambda _: on_exit())
        try:
            if self._receive_until(lambda: self._channel.heartbeat is not None, timeout_s):
                return
        except ChildUnavailable:
            process.kill()
            process.wait(_KILL_LIMIT_S)
            raise
        exited = process.wait(_LEAVING_LIMIT_S if self._channel.closed else 0)
        if exited is None:
            process.kill()
            if process.wait(_KILL_LIMIT_S) is None:
                return  # with its time used up; `Child` must not start another one meanwhile
            raise ChildUnavailable(
                f"it did not accept requests within {timeout_s:g} s; log: {self._log.file}"
            )
        reason = self._log.report(exited.pid, exited.code).reason
        raise ChildUnavailable(reason) if exited.code < 0 else CairnError(reason)

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition; see `ChildHandle`. `cancel_start` cuts a start short."""
        self._starting = verb in ("configure", "activate")
        sent = self._channel.request(verb)
        if sent:
            self._receive_until(lambda: self._channel.answer is not None, timeout_s)
        answer = self._channel.answer
        if answer is None:
            if self._starting and self._canceled:
                raise CairnError("a stop was requested")
            # A component that has ended by itself takes no requests any more. Then its end of the
            # channel closes, and then its process exits.
            leaving_s = 0.0 if sent else min(timeout_s, _LEAVING_LIMIT_S)
            report = self.wait(_LEAVING_LIMIT_S if self._channel.closed else leaving_s)
            if report is None:
                raise ChildUnavailable(f"no answer within {timeout_s:.1f} s{self._where()}")
            if not report.normal or verb != "shutdown":
                raise ChildUnavailable(report.reason)
        elif answer.error:  # the component's own
            self.wait(_EXIT_AFTER_ERROR_S)
            raise CairnError(answer.error)
        self._starting = verb == "configure"  # the next step follows

    def cancel_start(self) -> None:
        """Cut short the start in progress, and ask the process to end; from any thread."""
        if self._starting:
            self._canceled = True
            self.terminate()

    def memory(self) -> int:
        """Return the memory [bytes] that its process has in RAM; what it shares counts as well."""
        with suppress(OSError):  # it has just ended
            if self._process is not None:
                statm = Path(f"/proc/{self._process.pid}/statm").read_text(encoding="ascii")
                return int(statm.split()[1]) * _PAGE_BYTES
        return 0

    def expect_stop(self, limit_s: float) -> None:
        """Announce a stop, and cut short a start in progress; see `ChildHandle`."""
        if self._starting:
            self._canceled = True
        self._channel.announce_stop(limit_s)

    def heartbeat(self) -> Heartbeat | None:
        """Return the newest heartbeat since the last call; see `ChildHandle`."""
        self._receive(0.0)
        if self._channel.heartbeats == self._reported:
            return None
        self._reported = self._channel.heartbeats
        return self._channel.heartbeat

    def is_stopped(self) -> bool:
        """Return whether a signal such as SIGSTOP has stopped its process."""
        return self._process is not None and _threads_of(self._process.pid).stopped

    def terminate(self) -> None:
        """Ask its process to end."""
        if self._process is not None:
            self._process.terminate()

    def kill(self, log_limit_s: float) -> None:
        """Kill its process group, after its process has logged the stacks of its threads."""
        if self._process is not None:
            before, end = _threads_of(self._process.pid), self._log.end()
            deadline = time.monotonic()
            if before.handling:  # otherwise it has just started, or is about to end
                self._process.signal(TRACEBACK_SIGNAL)
                deadline += log_limit_s
            while self._process.wait(_TRACEBACK_POLL_S) is None and time.monotonic() < deadline:
                has_begun = self._log.has_since(end, _TRACEBACK)  # before the threads are read
                now = _threads_of(self._process.pid)
                if now.stopped:
                    break
                # The kernel blocks the signal in the thread that handles it.
                if has_begun and now.blocking <= before.blocking:
                    break
            self._process.kill()

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for its end; see `ChildHandle`."""
        exited = None if self._process is None else self._process.wait(timeout_s)
        if exited is None:
            return None
        self._channel.close()
        return self._log.report(exited.pid, exited.code)

    def _receive_until(self, arrived: Callable[[], bool], timeout_s: float) -> bool:
        """Receive messages until `arrived()`; return whether it has.

        It has not when the time is up, when a start is canceled, or when the process has ended.
        """
        while True:
            ended = self._process is None or self._process.exit.done()
            began = time.monotonic()
            self._receive(0.0 if ended else min(timeout_s, _POLL_S))
            if arrived():
                return True
            if ended or self._channel.closed or (self._starting and self._canceled):
                return False
            timeout_s -= min(time.monotonic() - began, _LONGEST_STEP_S)
            if timeout_s <= 0:
                return False

    def _receive(self, timeout_s: float) -> None:
        try:
            self._channel.receive(timeout_s)
        except InvalidPacket as error:
            raise ChildUnavailable(
                f"its channel to its supervisor is disturbed: {error}"
            ) from error

    def _where(self) -> str:
        heartbeat = self._channel.heartbeat
        return f"; it is in {heartbeat.handler}" if heartbeat and heartbeat.handler else ""


@dataclass(frozen=True)
class _Threads:
    """The threads of a process: whether a signal stops it, and which block `TRACEBACK_SIGNAL`.

    `handling` is whether the process logs its stacks on that signal.
    """

    stopped: bool
    blocking: frozenset[str]
    handling: bool


def _threads_of(pid: int) -> _Threads:
    stopped, blocking, handling = False, set(), False
    for thread in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(OSError):  # it has just ended
            status = thread.read_text(encoding="utf-8", errors="replace")
            fields = dict(re.findall(r"^(\w+):\s+(\S+)", status, re.MULTILINE))
            stopped |= fields["State"] in "Tt"
            bit = TRACEBACK_SIGNAL - 1
            handling |= bool(int(fields["SigCgt"], 16) >> bit & 1)
            if int(fields["SigBlk"], 16) >> bit & 1:
                blocking.add(thread.parent.name)
    return _Threads(stopped, frozenset(blocking), handling)
