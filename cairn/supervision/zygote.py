"""The zygote: imports what components need, then forks them and ends them with their owners."""

import contextlib
import gc
import json
import os
import select
import selectors
import signal
import socket
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import psutil
from setproctitle import setproctitle

from cairn.supervision.groups import ended_child, group_exists, group_of, kill, kill_group
from cairn.supervision.job import Job, become_fresh, begin, sever
from cairn.supervision.linux import become_subreaper, peer_of, set_parent_death_signal
from cairn.supervision.owner import Owner
from cairn.supervision.preload import Preloaded, preload
from cairn.supervision.zygote_protocol import (
    Done,
    Ended,
    Hello,
    ProtocolError,
    Refused,
    Request,
    Signal,
    Spawn,
    Spawned,
    read_request,
)

_LEFTOVERS_LIMIT_S = 1.0  # killed helpers of an ended process may take this long to vanish
_END_LIMIT_S = 5.0

Handler = Callable[[], Job | None]


def main() -> None:
    """Serve until the process that started the zygote ends; in a forked child, do its job.

    Arguments: the process id of the starter, the listening socket's file descriptor, and the
    modules to import as JSON. Standard input is a pipe whose other end only the starter holds.
    """
    starter, listener, modules = (json.loads(word) for word in sys.argv[2:5])
    setproctitle("cairn: zygote")
    gc.disable()
    os.set_inheritable(listener, False)
    set_parent_death_signal(signal.SIGKILL)  # while imports keep the pipe from being watched
    if os.getppid() != starter:
        return
    preloaded = preload(modules)
    for module, error in preloaded.failures.items():
        _log(f"cannot import {module}: {error}")
    for module, threads in preloaded.threads.items():
        _log(f"{module} starts threads when imported, which forked processes lack: {threads}")
    gc.collect()
    gc.freeze()
    listening = socket.socket(fileno=listener)
    socket_path = Path(listening.getsockname())
    job = Zygote(listening, preloaded).serve()
    if job is None:
        _tidy(socket_path)
    else:
        begin(job)
        job.run()


class Zygote:
    """Processes and their owners; every connection owns what it has spawned."""

    def __init__(self, listener: socket.socket, preloaded: Preloaded) -> None:
        self._pid = os.getpid()
        self._preloaded = preloaded
        self._names: dict[int, str] = {}
        self._owners: dict[int, Owner] = {}  # by process
        self._leftovers: dict[int, tuple[Ended, float]] = {}  # process groups without a leader
        self._connections: set[Owner] = set()
        self._selector = selectors.DefaultSelector()
        self._woken, self._wakeup = socket.socketpair()
        self._listener = listener
        for watched in (self._woken, self._wakeup, self._listener):
            watched.setblocking(False)
        self._selector.register(0, selectors.EVENT_READ, self._end_everything)
        self._selector.register(self._woken, selectors.EVENT_READ, self._signaled)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._serving = True

    def serve(self) -> Job | None:
        """Serve until told to end (None), or, in a forked child, until it has become one."""
        become_subreaper()
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, lambda *_: None)  # the wake-up socket tells of them
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.set_wakeup_fd(self._wakeup.fileno(), warn_on_full_buffer=False)
        set_parent_death_signal(signal.SIGTERM)
        self._reap()  # what ended before signals were watched
        while self._serving:
            wait_s = 0.1 if self._leftovers else None
            for key, _ in self._selector.select(wait_s):
                handler: Handler = key.data
                job = handler()
                if job is not None or not self._serving:
                    return job
            if self._leftovers:
                self._report_ended()
        return None

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:  # the client has given up
            return
        pid, uid = peer_of(connection)
        if uid != os.geteuid():
            _log(f"refused a connection of process {pid} of user {uid}")
            connection.close()
            return
        owner = Owner(connection, pid, self._selector)
        owner.watch(lambda: self._serve(owner))
        self._connections.add(owner)
        owner.send(Hello(self._pid, self._preloaded.failures, self._preloaded.threads))

    def _serve(self, owner: Owner) -> Job | None:
        try:
            requests = [read_request(line) for line in owner.receive()]
        except ProtocolError as error:
            _log(str(error))
            owner.gone = True
            requests = []
        for request in requests:
            job = self._answer(owner, request)
            if job is not None:
                return job
        if owner.gone:
            self._abandon(owner)
        return None

    def _answer(self, owner: Owner, request: Request) -> Job | None:
        try:
            match request:
                case Spawn():
                    return self._spawn(owner, request)
                case Signal():
                    self._send_signal(owner, request)
        except OSError as error:
            owner.send(Refused(request.request, f"the zygote could not do it: {error}"))
        return None

    def _spawn(self, owner: Owner, request: Spawn) -> Job | None:
        refusal = "" if request.fresh else self._preloaded.refusal(request.needs)
        if refusal:
            owner.send(Refused(request.request, refusal))
            return None
        log = os.open(request.log_file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o640)
        every = signal.valid_signals()
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, every)  # until the child can take them
        try:
            pid = os.fork()
            if pid == 0:
                return self._become(request, log)
            with contextlib.suppress(PermissionError, ProcessLookupError):  # already done, or over
                os.setpgid(pid, pid)  # the child does it too: whoever comes first
        finally:
            if os.getpid() == self._pid:
                os.close(log)
                signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        self._names[pid] = request.name
        self._owners[pid] = owner
        owner.processes.add(pid)
        owner.send(Spawned(request.request, pid))
        return None

    def _become(self, request: Spawn, log: int) -> Job:
        try:
            sever(self._pid, log)
            for owner in self._connections:
                owner.connection.close()
            for inherited in (self._selector, self._listener, self._woken, self._wakeup):
                inherited.close()
            job = Job(request.name, request.entry, request.argument)
            if request.fresh:
                become_fresh(job)
        except BaseException:  # must not return into the zygote's loop
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)
        return job

    def _send_signal(self, owner: Owner, request: Signal) -> None:
        if request.pid in owner.processes and request.pid in self._names:
            if request.group:
                kill_group(request.pid)
            else:
                os.kill(request.pid, request.signal)
        owner.send(Done(request.request))

    def _abandon(self, owner: Owner) -> None:
        """The owner is gone: so are its processes, whose own processes follow in turn."""
        owner.gone = True
        for pid in owner.processes & self._names.keys():
            kill_group(pid)
        if owner.settle():
            self._connections.discard(owner)

    def _signaled(self) -> None:
        if signal.SIGTERM in self._woken.recv(4096):
            self._end_everything()
        else:
            self._reap()

    def _reap(self) -> None:
        """Take note of ended processes, and kill what they leave behind."""
        reaped = False
        while (pid := ended_child()) is not None:
            if pid in self._names:
                kill_group(pid)  # its id is its group's as long as it is not reaped
            _, status = os.waitpid(pid, 0)
            reaped = True
            if pid in self._names:
                code = os.waitstatus_to_exitcode(status)
                ended = Ended(
                    pid,
                    self._names.pop(pid),
                    code if code >= 0 else None,
                    -code if code < 0 else None,
                )
                self._leftovers[pid] = (ended, time.monotonic() + _LEFTOVERS_LIMIT_S)
            for owner in [owner for owner in self._connections if owner.pid == pid]:
                self._abandon(owner)  # even if a fork of it holds the connection open
        if reaped:
            self._kill_strays()
            self._report_ended()

    def _kill_strays(self) -> None:
        """Kill adopted orphans unless they are in the group of a process that runs."""
        for child in psutil.Process(self._pid).children():
            group = group_of(child.pid)
            if child.pid not in self._names and group not in self._names:
                kill(child.pid, group)

    def _report_ended(self) -> None:
        """Tell of ended processes whose group is empty: their devices and ports are free."""
        for pid, (ended, deadline) in list(self._leftovers.items()):
            if group_exists(pid) and time.monotonic() < deadline:
                continue
            del self._leftovers[pid]
            owner = self._owners.pop(pid)
            owner.processes.discard(pid)
            owner.send(ended)
            if owner.gone and owner.settle():
                self._connections.discard(owner)

    def _end_everything(self) -> None:
        """Kill all descendants, wait for their end, and stop serving."""
        self._serving = False
        deadline = time.monotonic() + _END_LIMIT_S
        while children := psutil.Process(self._pid).children():
            for child in children:
                kill(child.pid, group_of(child.pid))
            if time.monotonic() > deadline:
                _log(f"these processes do not end even by SIGKILL: {children}")
                break
            if ended_child() is None and select.select([self._woken], [], [], 0.1)[0]:
                self._woken.recv(4096)
            while (pid := ended_child()) is not None:
                os.waitpid(pid, 0)


def _tidy(socket_path: Path) -> None:
    """Remove the socket and its folder, unless the log in there has something to tell."""
    with contextlib.suppress(OSError):  # whoever started the zygote may be tidying as well
        socket_path.unlink(missing_ok=True)
        for log in socket_path.parent.glob("*.log"):
            if log.stat().st_size == 0:
                log.unlink()
        socket_path.parent.rmdir()


def _log(text: str) -> None:
    with contextlib.suppress(OSError):  # a full disk must not end the robot
        sys.stderr.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S')} zygote: {text}\n")
        sys.stderr.flush()
