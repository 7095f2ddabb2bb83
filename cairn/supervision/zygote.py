"""The zygote: a process that imports what components need, then forks and ends them.

Each connection of a client owns the processes that were spawned over it. When a connection closes,
however its process ended, the zygote kills these processes.
"""

import contextlib
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
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from setproctitle import setproctitle

from cairn.supervision.child_bootstrap import detach, run_entry, run_in_fresh_interpreter
from cairn.supervision.orphan_cleanup import (
    become_subreaper,
    ended_child,
    group_exists,
    kill_descendants,
    kill_group,
    kill_orphans,
    set_parent_death_signal,
)
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
    decode_request,
    encode_answer,
)

_GROUP_LIMIT_S = 1.0  # killed helpers of an ended process may take this long to vanish
_END_LIMIT_S = 5.0
_TRACEBACK_LINES = 12
_UCRED = struct.Struct("3i")  # pid, uid, gid: unix(7), SO_PEERCRED

Handler = Callable[[], Spawn | None]


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
    preloaded = preload(modules)
    for module, error in preloaded.failures.items():
        _log(f"import failed: {module}: {error}")
    for module, threads in preloaded.threads.items():
        _log(f"module starts threads: {module}: forked processes lack these: {threads}")
    gc.collect()
    gc.freeze()
    listening = socket.socket(fileno=listener)
    socket_path = Path(listening.getsockname())
    spawn = Zygote(listening, preloaded).serve()
    if spawn is None:
        _remove_socket(socket_path)
    else:
        run_entry(spawn.name, spawn.entry, spawn.argument)


@dataclass
class Preloaded:
    """The result of importing modules."""

    failures: dict[str, str] = field(default_factory=dict)  # module: error and traceback's tail
    threads: dict[str, list[str]] = field(default_factory=dict)  # module: names of threads it left

    def refusal(self, needs: Iterable[str]) -> str:
        """Return why a process that needs these modules cannot start, "" if it can."""
        return "; ".join(
            f"the module {module} cannot be imported: {self.failures[module]}"
            for module in needs
            if module in self.failures
        )


def preload(modules: Iterable[str]) -> Preloaded:
    """Import modules; a module that fails does not keep the others from being imported."""
    preloaded = Preloaded()
    before = _threads()
    for module in modules:
        try:
            importlib.import_module(module)
        except (Exception, SystemExit) as error:  # a plugin's module may fail in any way
            trace = "".join(traceback.format_exception(error)).rstrip().splitlines()
            tail = "\n".join(trace[-_TRACEBACK_LINES:])
            preloaded.failures[module] = f"{type(error).__name__}: {error}\n{tail}"
        after = _threads()
        started = [after[thread] for thread in sorted(after.keys() - before.keys())]
        if started:
            preloaded.threads[module] = started
        before = after
    return preloaded


def _threads() -> dict[int, str]:
    """Return thread id and name of all other threads of this process, native ones included."""
    names: dict[int, str] = {}
    for entry in Path("/proc/self/task").iterdir():
        try:
            names[int(entry.name)] = (entry / "comm").read_text().strip()
        except (FileNotFoundError, ProcessLookupError):  # it has just ended
            continue
    names.pop(os.getpid(), None)
    return names


class Zygote:
    """Accepts clients, spawns and signals processes for them, and reports their exits."""

    def __init__(self, listener: socket.socket, preloaded: Preloaded) -> None:
        self._pid = os.getpid()
        self._preloaded = preloaded
        self._names: dict[int, str] = {}  # of running processes
        self._owners: dict[int, ClientConnection] = {}  # by process
        self._emptying: dict[int, tuple[Exited, float]] = {}  # groups whose leader has ended
        self._connections: set[ClientConnection] = set()
        self._selector = selectors.DefaultSelector()
        self._signals, self._wakeup = socket.socketpair()
        self._listener = listener
        for watched in (self._signals, self._wakeup, self._listener):
            watched.setblocking(False)
        self._selector.register(0, selectors.EVENT_READ, self._end_everything)
        self._selector.register(self._signals, selectors.EVENT_READ, self._on_signal)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._serving = True

    def serve(self) -> Spawn | None:
        """Serve until asked to end (returns None); in a forked child, return what to run."""
        become_subreaper()
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)  # the wake-up socket reports them
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.set_wakeup_fd(self._wakeup.fileno(), warn_on_full_buffer=False)
        set_parent_death_signal(signal.SIGTERM)
        self._reap()  # what ended before signals were watched
        while self._serving:
            wait_s = 0.1 if self._emptying else None
            for key, _ in self._selector.select(wait_s):
                handler: Handler = key.data
                spawn = handler()
                if spawn is not None or not self._serving:
                    return spawn
            if self._emptying:
                self._report_exits()
        return None

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
        self._selector.register(client, selectors.EVENT_READ, lambda: self._receive(connection))
        self._connections.add(connection)
        connection.send(Hello())

    def _receive(self, connection: "ClientConnection") -> Spawn | None:
        try:
            requests = [decode_request(line) for line in connection.receive()]
        except ProtocolError as error:
            _log(f"client disconnected: process {connection.pid}: {error}")
            connection.gone = True
            requests = []
        for request in requests:
            spawn = self._handle(connection, request)
            if spawn is not None:
                return spawn
        if connection.gone:
            self._abandon(connection)
        return None

    def _handle(self, connection: "ClientConnection", request: Request) -> Spawn | None:
        try:
            match request:
                case Spawn():
                    return self._spawn(connection, request)
                case Signal():
                    self._send_signal(connection, request)
        except OSError as error:
            connection.send(RequestRefused(request.request, f"the zygote failed: {error}"))
        return None

    def _spawn(self, connection: "ClientConnection", request: Spawn) -> Spawn | None:
        refusal = "" if request.fresh else self._preloaded.refusal(request.needs)
        if refusal:
            connection.send(RequestRefused(request.request, refusal))
            return None
        log = os.open(request.log_file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o640)
        every = signal.valid_signals()
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, every)  # until the child is ready
        try:
            pid = os.fork()
            if pid == 0:
                self._become_child(request, log)
                return request
            with contextlib.suppress(PermissionError, ProcessLookupError):  # done already, or over
                os.setpgid(pid, pid)  # the child does the same: the first of the two counts
        finally:
            if os.getpid() == self._pid:
                os.close(log)
                signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        self._names[pid] = request.name
        self._owners[pid] = connection
        connection.processes.add(pid)
        connection.send(Spawned(request.request, pid))
        return None

    def _become_child(self, request: Spawn, log: int) -> None:
        try:
            detach(self._pid, log)
            for connection in self._connections:
                connection.socket.close()
            for inherited in (self._selector, self._listener, self._signals, self._wakeup):
                inherited.close()
            if request.fresh:
                run_in_fresh_interpreter(request.name, request.entry, request.argument)
        except BaseException:  # must not return into the zygote's loop
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)

    def _send_signal(self, connection: "ClientConnection", request: Signal) -> None:
        if request.pid in connection.processes and request.pid in self._names:
            if request.group:
                kill_group(request.pid)
            else:
                os.kill(request.pid, request.signal)
        connection.send(Done(request.request))

    def _abandon(self, connection: "ClientConnection") -> None:
        """Kill the processes of a client that is gone; their own processes follow in turn."""
        if connection not in self._connections:  # closed by an event of the same turn
            return
        connection.gone = True
        if connection.socket in self._selector.get_map():
            self._selector.unregister(connection.socket)
        for pid in connection.processes & self._names.keys():
            kill_group(pid)
        self._close_if_done(connection)

    def _close_if_done(self, connection: "ClientConnection") -> None:
        if connection.gone and not connection.processes:
            connection.socket.close()
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
            if pid in self._names:
                kill_group(pid)  # the id is its group's as long as it is not reaped
            _, status = os.waitpid(pid, 0)
            reaped = True
            if pid in self._names:
                code = os.waitstatus_to_exitcode(status)
                name = self._names.pop(pid)
                exited = (
                    Exited(pid, name, code, None) if code >= 0 else Exited(pid, name, None, -code)
                )
                self._emptying[pid] = (exited, time.monotonic() + _GROUP_LIMIT_S)
            for connection in [one for one in self._connections if one.pid == pid]:
                self._abandon(connection)  # even if a fork of the client holds it open
        if reaped:
            kill_orphans(set(self._names))
            self._report_exits()

    def _report_exits(self) -> None:
        """Report ended processes whose group is empty: their devices and ports are free."""
        for pid, (exited, deadline) in list(self._emptying.items()):
            if group_exists(pid) and time.monotonic() < deadline:
                continue
            del self._emptying[pid]
            connection = self._owners.pop(pid)
            connection.processes.discard(pid)
            connection.send(exited)
            self._close_if_done(connection)

    def _end_everything(self) -> None:
        """Kill all descendants, wait for their end, and stop serving."""
        self._serving = False

        def await_child(timeout_s: float) -> None:
            if select.select([self._signals], [], [], timeout_s)[0]:
                self._signals.recv(4096)

        left = kill_descendants(await_child, _END_LIMIT_S)
        if left:
            _log(f"processes do not end even by SIGKILL: {left}")


class ClientConnection:
    """A client's connection; the zygote never waits for it."""

    def __init__(self, client: socket.socket, pid: int) -> None:
        self.socket = client
        self.pid = pid
        self.processes: set[int] = set()
        self.gone = False  # sends no more requests; its processes are being killed
        self._lines = LineSplitter()
        client.setblocking(False)

    def receive(self) -> list[bytes]:
        """Return the lines that have arrived; set `gone` at the end. Raises `ProtocolError`."""
        try:
            data = self.socket.recv(1 << 16)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.gone = True
        return self._lines.feed(data)

    def send(self, answer: Answer) -> None:
        """Send an answer; disconnect a client that has not read hundreds of them: it hangs."""
        line = encode_answer(answer)
        try:
            complete = self.socket.send(line) == len(line)
        except BlockingIOError:
            complete = False
        except OSError:  # the client has ended, which `receive` finds
            return
        if not complete:
            _log(f"client disconnected: process {self.pid} does not read its answers")
            self.socket.shutdown(socket.SHUT_RDWR)


def _remove_socket(socket_path: Path) -> None:
    """Remove the socket and its folder; keep the folder if the log in it is not empty."""
    with contextlib.suppress(OSError):  # the process that started the zygote removes it as well
        socket_path.unlink(missing_ok=True)
        for log in socket_path.parent.glob("*.log"):
            if log.stat().st_size == 0:
                log.unlink()
        socket_path.parent.rmdir()


def _log(text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk must not end the robot
        sys.stderr.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S')} zygote: {text}\n")
        sys.stderr.flush()
