"""What processes do in the tests of the zygote; each reports to the test over a socket."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import psutil

from cairn.processes.launcher import ZygoteClient

Argument = dict[str, Any]
GRANDCHILD = (
    "import sys; sys.path[:] = {path!r}; "
    "from {module} import run_until_killed; run_until_killed({argument!r})"
)


def announce(argument: Argument, **facts: Any) -> socket.socket:
    """Report to the test that this process runs; the connection ends with the process."""
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(argument["reports"])
    report = {"name": argument["name"], "pid": os.getpid(), **facts}
    connection.sendall(json.dumps(report).encode() + b"\n")
    return connection


def run_until_killed(argument: Argument) -> None:
    """Run until killed, or until the test closes the connection."""
    announce(argument).recv(1)


def describe(argument: Argument) -> None:
    """Report the state of this process."""
    descriptors = {
        number: os.readlink(f"/proc/self/fd/{number}")
        for number in map(int, os.listdir("/proc/self/fd"))
        if os.path.exists(f"/proc/self/fd/{number}")
    }
    announce(
        argument,
        passed=argument,
        group=os.getpgrp(),
        title=Path("/proc/self/cmdline").read_text().split("\0")[0].strip(),
        descriptors=descriptors,
        sigterm=signal.getsignal(signal.SIGTERM) == signal.SIG_DFL,
        sigchld=signal.getsignal(signal.SIGCHLD) == signal.SIG_DFL,
        sigint=signal.getsignal(signal.SIGINT) == signal.default_int_handler,
        blocked=[*map(int, signal.pthread_sigmask(signal.SIG_BLOCK, []))],
        threads=len(os.listdir("/proc/self/task")),
        malloc=os.environ["MALLOC_TOP_PAD_"],
        path=sys.path,
    )


def use_memory_in_each_thread(argument: Argument) -> None:
    """Report by how many MiB this process grows while 6 threads use 4 MiB each, in turn."""
    turns = [threading.Event() for _ in range(7)]

    def use(turn: int) -> None:
        turns[turn].wait()
        blocks = [bytes(range(256)) * 4096 for _ in range(4)]  # below the threshold of mmap
        blocks.clear()
        turns[turn + 1].set()
        turns[-1].wait()  # a thread that ends would leave its heap to the next one

    threads = [threading.Thread(target=use, args=(turn,)) for turn in range(6)]
    for thread in threads:
        thread.start()
    before = psutil.Process().memory_info().rss
    turns[0].set()
    for thread in threads:
        thread.join()
    announce(argument, grown=(psutil.Process().memory_info().rss - before) / 2**20)


def write_output(argument: Argument) -> None:
    """Write to both streams and return."""
    sys.stdout.write(f"stdout {argument['text']}\n")
    sys.stderr.write(f"stderr {argument['text']}\n")


def answer_over_channel(argument: Argument, channel: socket.socket) -> None:
    """Send to the channel's other end which sockets a helper inherits, and wait."""
    program = "import os; print(*[os.readlink(f'/proc/self/fd/{n}') for n in range(3, 64) if os.path.islink(f'/proc/self/fd/{n}')])"  # noqa: E501 - a program
    listed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, close_fds=False
    )
    inherited = [name for name in listed.stdout.split() if name.startswith("socket")]
    subprocess.Popen(["sleep", "1000"], close_fds=False)
    channel.send(json.dumps({"pid": os.getpid(), "inherited": inherited}).encode())
    channel.close()
    signal.pause()


def fail(argument: Argument) -> None:
    """End by an exception."""
    raise ValueError(f"no device {argument['device']}")


def crash(argument: Argument) -> None:
    """End as by a fault in a library."""
    os.kill(os.getpid(), signal.SIGSEGV)


def ignore_sigterm(argument: Argument) -> None:
    """Run until killed."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    run_until_killed(argument)


def leave_helper(argument: Argument) -> None:
    """Return, but leave a process running, detached as `how` specifies."""
    keep_helper_of(argument)


def keep_helper(argument: Argument) -> None:
    """Run until killed, with a child process, detached as `how` specifies."""
    keep_helper_of(argument)
    run_until_killed(argument)


def own(argument: Argument) -> None:
    """Run until killed, and own a process that has a helper."""
    client = ZygoteClient(Path(argument["zygote"]))
    leaf = {"name": "leaf", "reports": argument["reports"], "how": "same group"}
    fresh = argument.get("leaf_fresh", False)
    client.spawn("leaf", f"{__name__}:keep_helper", leaf, Path(argument["log"]), fresh=fresh)
    run_until_killed(argument)


def own_and_fork(argument: Argument) -> None:
    """Own a process, and have a fork hold the connection open after the owner's end."""
    client = ZygoteClient(Path(argument["zygote"]))
    leaf = {"name": "leaf", "reports": argument["reports"]}
    client.spawn("leaf", f"{__name__}:run_until_killed", leaf, Path(argument["log"]))
    if os.fork() == 0:
        os.setsid()
        run_until_killed({**argument, "name": "fork"})
    run_until_killed(argument)


def open_session(argument: Argument) -> None:
    """Open and close a Zenoh session, which hangs in a fork of a process that had one."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        session.put("cairn/test", b"x")


def keep_helper_of(argument: Argument) -> None:
    """Start a process that runs until killed, detached as `how` specifies."""
    helper = {"name": f"{argument['name']}'s helper", "reports": argument["reports"]}
    program = GRANDCHILD.format(module=__name__, path=sys.path, argument=helper)
    if argument["how"] == "daemon":
        if (middle := os.fork()) == 0:
            os.setsid()
            _popen(program)
            os._exit(0)
        os.waitpid(middle, 0)
    else:
        _popen(program, start_new_session=argument["how"] == "own session")


def _popen(program: str, start_new_session: bool = False) -> None:
    subprocess.Popen([sys.executable, "-c", program], start_new_session=start_new_session)
