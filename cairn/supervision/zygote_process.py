"""Starts the zygote as a process of its own, and ends it with all processes it has started."""

import json
import os
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from uuid import uuid4

import psutil

from cairn.errors import CairnError
from cairn.supervision.child_bootstrap import BOOTSTRAP
from cairn.supervision.orphan_cleanup import MARK, kill_marked

_LONGEST_SOCKET_PATH = 107  # bytes, unix(7)
# These halve the latency of images: glibc would map and unmap memory for each of them.
_MALLOC = {
    "MALLOC_MMAP_THRESHOLD_": "134217728",
    "MALLOC_TRIM_THRESHOLD_": "268435456",
    "MALLOC_TOP_PAD_": "33554432",
}
# A process with threads must not fork, and numpy's OpenBLAS would start some when imported.
_SINGLE_THREADED = {"OPENBLAS_NUM_THREADS": "1"}


class ZygoteProcess:
    """A running zygote, as the process sees it that started it: the root of the tree.

    When the root ends, in whatever way, the zygote kills all processes and ends.
    """

    def __init__(
        self, process: "subprocess.Popen[bytes]", socket_path: Path, log_file: Path, mark: str
    ) -> None:
        self.socket_path = socket_path
        self.log_file = log_file
        self._process = process
        self._mark = mark

    @property
    def pid(self) -> int:
        """The zygote's process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the zygote runs."""
        return self._process.poll() is None

    @property
    def stopped(self) -> bool:
        """Whether it has been stopped by a signal (SIGSTOP), so that it does not serve."""
        try:
            return psutil.Process(self.pid).status() == psutil.STATUS_STOPPED
        except psutil.NoSuchProcess:
            return False

    def kill(self) -> None:
        """Kill it, and with it all processes that it has started."""
        self._process.kill()

    def wait(self, timeout_s: float) -> bool:
        """Return whether the zygote has ended, or ends within the limit [s]."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self, timeout_s: float = 10.0) -> None:
        """End the zygote and all processes of the tree, also if the zygote has been killed.

        Raises `CairnError` if some do not end by SIGKILL within the time limit [s].
        """
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(timeout_s)
        left = kill_marked(self._mark, timeout_s)
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
    _make_private(runtime_dir)
    mark = uuid4().hex
    socket_path = runtime_dir / f"zygote-{mark[:8]}.sock"
    log_file = runtime_dir / "zygote.log"
    if len(os.fsencode(socket_path)) > _LONGEST_SOCKET_PATH:
        raise CairnError(
            f"the path of the socket {socket_path} exceeds {_LONGEST_SOCKET_PATH} bytes; set "
            "XDG_RUNTIME_DIR to a folder with a shorter path"
        )
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener,
        log_file.open("ab") as log,
    ):
        listener.bind(os.fspath(socket_path))
        listener.listen(64)
        arguments = map(json.dumps, (os.getpid(), listener.fileno(), list(preload)))
        bootstrap = ["-P", "-c", BOOTSTRAP, json.dumps(sys.path)]
        process = subprocess.Popen(
            [sys.executable, *bootstrap, "cairn.supervision.zygote", *arguments],
            stdin=subprocess.PIPE,  # the lifeline: it closes when this process ends
            stdout=log,
            stderr=log,
            pass_fds=[listener.fileno()],
            start_new_session=True,  # the terminal's Ctrl-C reaches the root only
            env=_environment(mark),
        )
    return ZygoteProcess(process, socket_path, log_file, mark)


def _environment(mark: str) -> dict[str, str]:
    keep_environment_readable = {"SPT_NOENV": "1"}  # setproctitle would overwrite the mark
    return {
        **_SINGLE_THREADED,
        **_MALLOC,
        **os.environ,
        **keep_environment_readable,
        MARK: mark,
    }


def _make_private(directory: Path) -> None:
    directory.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
    status = directory.stat()
    if status.st_uid != os.geteuid() or status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise CairnError(
            f"{directory} can be used by other users, who could then start processes as you; "
            f"restrict it to yourself (chmod 700 {directory}) or choose another folder"
        )
