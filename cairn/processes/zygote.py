"""The zygote: a process that imports what components need, then forks and ends them.

Each connection of a client (`launcher.py`) owns the processes that were spawned over it. When
a connection closes, however its process ended, the zygote kills these processes. The messages are
one JSON object per line on a Unix socket.
"""

import contextlib
import faulthandler
import gc
import importlib
import json
import os
import select
import selectors
import signal
import socket
import struct
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, cast

from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass
from setproctitle import setproctitle

from cairn.processes.orphan_cleanup import (
    become_subreaper,
    ended_child,
    group_exists,
    kill_descendants,
    kill_group,
    kill_orphans,
    set_parent_death_signal,
)
from cairn.runtime.process_exit import end_process
from cairn.system.files import TAKES_NO_DATA
from cairn.system.kernel_compilation import (
    COMPILATION_LIMIT_S,
    before_compilation,
    compile_deferred,
    defer_compilation,
)

BOOTSTRAP = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
    "from importlib import import_module; module, _, function = sys.argv[1].partition(':'); "
    "getattr(import_module(module), function)()"
)
"""Calls a function ("module:function") of a new interpreter, with the caller's search path."""

_END_LIMIT_S = 5.0  # killed processes may take so long to vanish, on a starved computer
_TRACEBACK_LINES = 12
_LONGEST_LINE = 16 << 20  # bytes; a deployment's largest argument is some kilobytes
_LONGEST_LOG = 1_000_000  # bytes; a client that sends garbage again and again logs a line each time
_DESCRIPTORS = 16  # of one client that wait for the end of their message
_UCRED = struct.Struct("3i")  # pid, uid, gid: unix(7), SO_PEERCRED
# Python itself ignores the first two and expects that; the others cannot be changed.
_UNCHANGED_SIGNALS = {signal.SIGPIPE, signal.SIGXFSZ, signal.SIGKILL, signal.SIGSTOP}


@dataclass(frozen=True)
class Spawn:
    """Client: start a process of this name that calls `entry` with `argument`.

    With `channel`, a file descriptor of a socket accompanies the message; the process calls `entry`
    with that socket as well. The zygote refuses if one of the modules in `needs` could not be
    imported.
    """

    request: int  # from 1
    name: str
    entry: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    argument: dict[str, Any]
    log_file: str
    fresh: bool
    needs: tuple[str, ...]
    channel: bool = False
    kind: Literal["spawn"] = "spawn"


@dataclass(frozen=True)
class Signal:
    """Client: send a signal to one of its processes, or kill that process's whole group."""

    pid: int
    signal: int
    group: bool
    kind: Literal["signal"] = "signal"


@dataclass(frozen=True)
class Answer:
    """Zygote: the requested process runs, or why not; for request 0: the imports are finished."""

    request: int
    pid: int = 0
    error: str = ""
    kind: Literal["answer"] = "answer"


@dataclass(frozen=True)
class Exited:
    """Zygote: a process of the client ended with this exit code, -N by signal N.

    Its whole process group has ended: its devices and ports are free.
    """

    pid: int
    code: int
    kind: Literal["exited"] = "exited"


REQUEST: TypeAdapter[Spawn | Signal] = TypeAdapter(
    Annotated[Spawn | Signal, Field(discriminator="kind")],
    config=ConfigDict(hide_input_in_errors=True),  # an argument contains secrets; errors are logged
)
ANSWER: TypeAdapter[Answer | Exited] = TypeAdapter(
    Annotated[Answer | Exited, Field(discriminator="kind")]
)


def encode(message: Spawn | Signal | Answer | Exited) -> bytes:
    """Encode a message as a line. Raises `TypeError` if its argument cannot be JSON."""
    return json.dumps(asdict(message)).encode() + b"\n"  # keeps NaN, unlike pydantic


def main() -> None:
    """Serve until the process that started the zygote ends; in a forked child, run its entry.

    Arguments: the process id of the starter, the listening socket's file descriptor, and the
    modules to import as JSON. Standard input is a pipe whose other end only the starter holds.
    """
    starter, listener, modules = (json.loads(word) for word in sys.argv[2:5])
    setproctitle("cairn: zygote")
    gc.disable()
    os.set_inheritable(listener, False)
    set_parent_death_signal(signal.SIGKILL)  # during the imports the pipe is not watched
    if os.getppid() != starter:
        return
    zygote = os.getpid()
    before_compilation(_compile_in_helper)
    import_failures = preload(modules)
    if os.getpid() != zygote:
        compiled = compile_deferred(partial(set_parent_death_signal, signal.SIGKILL))
        os._exit(0 if compiled else 1)  # the helper: all kernels are in the cache
    gc.collect()
    gc.freeze()
    listening = socket.socket(fileno=listener)
    socket_path = Path(listening.getsockname())
    spawn = None
    try:
        spawn = Zygote(listening, import_failures).serve()
    finally:
        if spawn is None:  # this is not a fork: it ends, or fails, with an exit code of its own
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if spawn is None:
        _remove_socket(socket_path)
        end_process(0)
    else:
        request, channel = spawn
        _run_entry(request.name, request.entry, request.argument, channel)


def preload(modules: Iterable[str]) -> dict[str, str]:
    """Import modules; return the errors, with the tail of a traceback, of those that fail."""
    failures = {}
    before = _threads()
    for module in modules:
        try:
            importlib.import_module(module)
        except (Exception, SystemExit) as error:  # a plugin's module may fail in any way
            trace = "".join(traceback.format_exception(error)).rstrip().splitlines()
            tail = "\n".join(trace[-_TRACEBACK_LINES:])
            failures[module] = f"{type(error).__name__}: {error}\n{tail}"
            _log(f"import failed: {module}: {failures[module]}")
        after = _threads()
        started = [after[thread] for thread in sorted(after.keys() - before.keys())]
        if started:
            _log(f"module starts threads: {module}: forked processes lack these: {started}")
        before = after
    return failures


def _compile_in_helper() -> None:
    """Fork a helper process, which continues the imports, then fills the cache with all kernels.

    Returns in both: in the zygote when the helper has ended, so that it loads the kernels from the
    cache. A compiler keeps about 200 MiB, which the zygote would share with all its forks. If the
    helper fails, the zygote compiles.
    """
    began, zygote = time.monotonic(), os.getpid()
    try:
        helper = os.fork()
    except OSError as error:
        _log(f"compiling kernels in this process: a helper cannot be started: {error}")
        return
    if helper == 0:
        set_parent_death_signal(signal.SIGKILL)
        if os.getppid() != zygote:
            os._exit(1)
        os.setpgid(0, 0)
        setproctitle("cairn: compiler")
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)  # the zygote imports the same modules, and reports the same failures
        os.dup2(nothing, 2)
        defer_compilation()
        return
    with contextlib.suppress(PermissionError, ProcessLookupError):
        os.setpgid(helper, helper)  # the helper does the same: the first of the two counts
    descriptor = os.pidfd_open(helper)
    ended, _, _ = select.select([descriptor], [], [], COMPILATION_LIMIT_S)
    os.close(descriptor)
    kill_group(helper)  # what the modules have started; the helper too, if it has not ended
    _, status = os.waitpid(helper, 0)
    took_s, code = time.monotonic() - began, os.waitstatus_to_exitcode(status)
    if ended and code == 0:
        _log(f"compiled kernels: {took_s:.1f} s in a helper process; they are in the cache now")
    else:
        how = f"exit code {code}" if ended else "not ready"
        _log(f"compiling kernels in this process: helper process: {how} after {took_s:.1f} s")


def _threads() -> dict[int, str]:
    """Return thread id and name of all other threads of this process, native ones included."""
    names: dict[int, str] = {}
    for entry in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
            names[int(entry.name)] = (entry / "comm").read_text().strip()
    names.pop(os.getpid(), None)
    return names


class Zygote:
    """Accepts clients, spawns and signals processes for them, and reports their exits."""

    def __init__(self, listener: socket.socket, import_failures: dict[str, str]) -> None:
        self._pid = os.getpid()
        self._import_failures = import_failures
        self._owners: dict[int, ClientConnection] = {}  # by process whose exit is not reported
        self._emptying: dict[int, tuple[Exited, float]] = {}  # groups whose leader has ended
        self._connections: set[ClientConnection] = set()
        self._selector = selectors.DefaultSelector()
        self._signals, self._wakeup = socket.socketpair()
        self._listener = listener
        for watched in (self._signals, self._wakeup, self._listener):
            watched.setblocking(False)
        self._watch(0, self._end_everything)  # standard input
        self._watch(self._signals, self._on_signal)
        self._watch(self._listener, self._accept)
        self._serving = True
        self._forked: tuple[Spawn, int | None] | None = None  # in a forked child: what to run

    def serve(self) -> tuple[Spawn, int | None] | None:
        """Serve until asked to end (returns None).

        In a forked child, return what to run, and the descriptor of its channel if it has one.
        """
        become_subreaper()
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)  # the wake-up socket reports them
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.set_wakeup_fd(self._wakeup.fileno(), warn_on_full_buffer=False)
        set_parent_death_signal(signal.SIGTERM)
        self._reap()  # what ended before signals were watched
        while True:
            for key, _ in self._selector.select(0.1 if self._emptying else None):
                key.data()
                if not self._serving:
                    return self._forked
            self._report_exits()

    def _watch(self, source: int | socket.socket, handler: Callable[[], None]) -> None:
        self._selector.register(source, selectors.EVENT_READ, handler)

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except BlockingIOError:  # the client has given up
            return
        credentials = client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
        pid, uid, _ = _UCRED.unpack(credentials)
        if uid != os.geteuid():
            _log(f"connection refused: process {pid} of user {uid}")
            client.close()
            return
        connection = ClientConnection(client, pid)
        self._watch(client, lambda: self._receive(connection))
        self._connections.add(connection)
        connection.send(Answer(0))

    def _receive(self, connection: "ClientConnection") -> None:
        requests = []
        try:
            requests = [REQUEST.validate_json(line) for line in connection.receive()]
        except ValueError as error:
            _log(f"client disconnected: process {connection.pid} sent an invalid request: {error}")
            connection.gone = True
        for request in requests:
            try:
                if isinstance(request, Signal):
                    self._send_signal(connection, request)
                else:
                    self._spawn(connection, request)
            except OSError as error:
                if isinstance(request, Signal):
                    _log(f"signal failed: process {request.pid}: {error}")
                else:
                    connection.send(Answer(request.request, error=f"the zygote failed: {error}"))
            if not self._serving:  # in a forked child
                return
        if connection.gone:
            self._abandon(connection)

    def _spawn(self, connection: "ClientConnection", request: Spawn) -> None:
        channel = connection.take_descriptor() if request.channel else None
        try:
            self._fork(connection, request, channel)
        finally:
            if channel is not None and os.getpid() == self._pid:
                os.close(channel)

    def _fork(self, connection: "ClientConnection", request: Spawn, channel: int | None) -> None:
        log = _open_log(request.log_file)
        every = signal.valid_signals()
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, every)  # until the child is ready
        try:
            missing = next((one for one in request.needs if one in self._import_failures), None)
            if missing is not None:
                self._refuse(connection, request, missing, log)
                return
            pid = os.fork()
            if pid == 0:
                self._become_child(request, log, channel)
                return
            with contextlib.suppress(PermissionError, ProcessLookupError):  # done already, or over
                os.setpgid(pid, pid)  # the child does the same: the first of the two counts
        finally:
            if os.getpid() == self._pid:
                os.close(log)
                signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        self._owners[pid] = connection
        connection.send(Answer(request.request, pid))

    def _refuse(
        self, connection: "ClientConnection", request: Spawn, module: str, log: int
    ) -> None:
        """Report why a module cannot be imported; write all of it, with a traceback, to the log."""
        text = f"the module {module} cannot be imported: {self._import_failures[module]}\n"
        with contextlib.suppress(OSError):  # a full disk
            os.write(log, text.encode())
        reason = f"{text.partition(chr(10))[0]} (log {request.log_file})"
        connection.send(Answer(request.request, error=reason))

    def _become_child(self, request: Spawn, log: int, channel: int | None) -> None:
        """Detach this process, a fork, from the zygote, and have `serve` return what it runs."""
        try:
            _detach(self._pid, log)
            for connection in self._connections:
                connection.close()
            for inherited in (self._selector, self._listener, self._signals, self._wakeup):
                inherited.close()
            if request.fresh:
                _run_in_fresh_interpreter(request, channel)
            self._serving, self._forked = False, (request, channel)
        except BaseException:  # must not return into the zygote's loop
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)

    def _send_signal(self, connection: "ClientConnection", request: Signal) -> None:
        if request.pid in self._running(connection):
            if request.group:
                kill_group(request.pid)
            else:
                os.kill(request.pid, request.signal)

    def _running(self, connection: "ClientConnection | None" = None) -> set[int]:
        """Return the processes that are not reaped yet, of one client or of all."""
        return {
            pid
            for pid, owner in self._owners.items()
            if pid not in self._emptying and connection in (None, owner)
        }

    def _abandon(self, connection: "ClientConnection") -> None:
        """Kill the processes of a client that is gone; their own processes follow in turn."""
        if connection not in self._connections:  # closed by an event of the same turn
            return
        connection.gone = True
        if connection.socket in self._selector.get_map():
            self._selector.unregister(connection.socket)
        for pid in self._running(connection):
            kill_group(pid)
        self._close_if_done(connection)

    def _close_if_done(self, connection: "ClientConnection") -> None:
        if connection.gone and connection not in self._owners.values():
            connection.close()
            self._connections.discard(connection)

    def _on_signal(self) -> None:
        if signal.SIGTERM in self._signals.recv(4096):
            self._end_everything()
        else:
            self._reap()

    def _reap(self) -> None:
        """Reap ended processes, and kill what they leave behind."""
        reaped = False
        while (pid := ended_child()) is not None:
            spawned = pid in self._owners
            if spawned:
                kill_group(pid)  # the id is its group's as long as it is not reaped
            _, status = os.waitpid(pid, 0)
            reaped = True
            if spawned:
                exited = Exited(pid, os.waitstatus_to_exitcode(status))
                self._emptying[pid] = (exited, time.monotonic() + _END_LIMIT_S)
            for connection in [one for one in self._connections if one.pid == pid]:
                self._abandon(connection)  # even if a fork of the client holds it open
        if reaped:
            kill_orphans(self._running())
            self._report_exits()

    def _report_exits(self) -> None:
        """Report ended processes whose group is empty: their devices and ports are free."""
        for pid, (exited, deadline) in list(self._emptying.items()):
            if group_exists(pid) and time.monotonic() < deadline:
                continue
            del self._emptying[pid]
            connection = self._owners.pop(pid)
            connection.send(exited)
            self._close_if_done(connection)

    def _end_everything(self) -> None:
        """Kill all descendants, wait for their end, and stop serving."""
        self._serving = False
        left = kill_descendants(_END_LIMIT_S)
        if left:
            _log(f"processes do not end even by SIGKILL: {left}")


class ClientConnection:
    """A client's connection; the zygote never waits for it."""

    def __init__(self, client: socket.socket, pid: int) -> None:
        self.socket = client
        self.pid = pid
        self.gone = False  # sends no more requests; its processes are being killed
        self._received = b""  # the beginning of a line
        self._descriptors: deque[int] = deque()  # of `Spawn` messages that are not complete yet
        client.setblocking(False)

    def receive(self) -> list[bytes]:
        """Return the lines that are complete now; set `gone` at the end.

        Raises `ValueError` if a line is too long, or too many descriptors came with it.
        """
        data, descriptors = b"", list[int]()
        try:
            data, descriptors, _, _ = socket.recv_fds(self.socket, 1 << 16, _DESCRIPTORS + 1)
        except BlockingIOError:
            return []
        except OSError:
            pass
        for descriptor in descriptors:
            os.set_inheritable(descriptor, False)  # `recv_fds` ignores MSG_CMSG_CLOEXEC
        self._descriptors.extend(descriptors)
        if len(self._descriptors) > _DESCRIPTORS:
            raise ValueError(f"more than {_DESCRIPTORS} file descriptors")
        if not data:
            self.gone = True
        *lines, self._received = (self._received + data).split(b"\n")
        if len(self._received) > _LONGEST_LINE:
            raise ValueError(f"a line exceeds {_LONGEST_LINE} bytes")
        return lines

    def take_descriptor(self) -> int:
        """Return the descriptor that came with a message; the caller closes it.

        Raises `OSError` if there is none.
        """
        if not self._descriptors:
            raise OSError("no file descriptor came with the message")
        return self._descriptors.popleft()

    def close(self) -> None:
        """Close the connection, and the descriptors that came over it and were not used."""
        while self._descriptors:
            os.close(self._descriptors.popleft())
        self.socket.close()

    def send(self, answer: Answer | Exited) -> None:
        """Send an answer; disconnect a client that has not read hundreds of them: it hangs."""
        line = encode(answer)
        try:
            complete = self.socket.send(line) == len(line)
        except BlockingIOError:
            complete = False
        except OSError:  # the client has ended, which `receive` finds
            return
        if not complete:
            _log(f"client disconnected: process {self.pid} does not read its answers")
            self.socket.shutdown(socket.SHUT_RDWR)


def _open_log(file: str) -> int:
    """Open a log file to append to it; on a full disk /dev/null, which the process replaces later.

    Raises other `OSError`.
    """
    try:
        return os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o640)
    except OSError as error:
        if error.errno not in TAKES_NO_DATA:
            raise
        _log(f"log file cannot be created: {file}: {error.strerror}; its process starts without")
        return os.open(os.devnull, os.O_WRONLY)


def _detach(zygote: int, log: int) -> None:
    """Detach the calling process, a fork of the zygote; all signals are blocked at the call.

    It becomes the leader of a process group, dies with the zygote, reads nothing, writes to the
    file descriptor `log`, and has the default signal handlers again.
    """
    signal.set_wakeup_fd(-1)
    os.setpgid(0, 0)
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != zygote:  # the zygote ended before the signal was set
        os._exit(1)
    _close_input()
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    for number in signal.valid_signals() - _UNCHANGED_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])


def _run_entry(name: str, entry: str, argument: dict[str, Any], channel: int | None) -> None:
    """Set up the interpreter of a detached process and call `entry` ("package.module:function").

    With a `channel`, the entry gets it as second argument, a socket. An exception of the entry ends
    the process with a traceback and exit code 1.
    """
    setproctitle(f"cairn: {name}")
    cast("Any", sys.stdout).reconfigure(line_buffering=True)
    faulthandler.enable()
    gc.enable()
    module, _, function = entry.partition(":")
    call = getattr(importlib.import_module(module), function)
    if channel is None:
        call(argument)
    else:
        call(argument, socket.socket(fileno=channel))


def _run_in_fresh_interpreter(spawn: Spawn, channel: int | None) -> NoReturn:
    """Replace the calling process, already detached, by a new interpreter that runs the entry.

    The argument may contain secrets: it is passed in memory, not in arguments or the environment.
    """
    passed = os.memfd_create(spawn.name)
    with open(passed, "wb", closefd=False) as file:
        file.write(json.dumps([spawn.name, spawn.entry, spawn.argument, channel]).encode())
    if channel is not None:
        os.set_inheritable(channel, True)
    os.lseek(passed, 0, os.SEEK_SET)
    os.dup2(passed, 0)
    bootstrap = ["-P", "-c", BOOTSTRAP, json.dumps(sys.path)]
    os.execv(sys.executable, [sys.executable, *bootstrap, f"{__name__}:run_passed_entry"])


def run_passed_entry() -> None:
    """Run, in a fresh interpreter, the entry that was passed on standard input."""
    name, entry, argument, channel = json.loads(sys.stdin.buffer.read())
    _close_input()
    if channel is not None:
        os.set_inheritable(channel, False)  # helper processes must not inherit it
    _run_entry(name, entry, argument, channel)


def _close_input() -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)


def _remove_socket(socket_path: Path) -> None:
    """Remove the sockets of the run and their folder; keep the folder if its log is not empty."""
    with contextlib.suppress(OSError):  # the process that started the zygote removes it as well
        for path in (socket_path, *socket_path.parent.glob("*.sock*")):  # Zenoh's with their locks
            path.unlink(missing_ok=True)
        for log in socket_path.parent.glob("*.log"):
            if log.stat().st_size == 0:
                log.unlink()
        socket_path.parent.rmdir()


def _log(text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk must not end the robot
        if os.fstat(2).st_size > _LONGEST_LOG:
            return
        sys.stderr.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S')} zygote: {text}\n")
        sys.stderr.flush()
