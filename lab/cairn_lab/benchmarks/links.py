"""Links between component processes over Unix sockets: how soon, how surely, after pauses."""

import multiprocessing
import os
import signal
import statistics
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import zenoh

from cairn.bus.session import open_peer, open_router
from cairn_lab.benchmarks.result import Metric

PEERS = 8
ROUNDS = 10
PAUSES_S = (1.0, 5.0, 10.0)
"""The lease of a link is 5 s: a peer that pauses longer loses its links and links again."""
_LIMIT_S = 5.0
_PERIOD_S = 0.01


def measure() -> list[Metric]:
    """Measure the time until peers that start together are all linked, and after pauses."""
    times, missing = [], 0
    for _ in range(ROUNDS):
        linked = _start_together()
        times += [one for one in linked if one is not None]
        missing += sum(one is None for one in linked)
    return [
        Metric(f"{PEERS} peers start together: peers without all links within {_LIMIT_S:g} s",
               float(missing), f"of {PEERS * ROUNDS}", at_most=0),
        Metric("until a peer has all links, median", statistics.median(times) * 1e3, "ms",
               at_most=200, note=f"longest {max(times) * 1e3:.0f} ms"),
        *(Metric(f"first message after a pause of {pause_s:g} s", _after_pause(pause_s) * 1e3, "ms",
                 at_most=500) for pause_s in PAUSES_S),
    ]  # fmt: skip


def _start_together() -> list[float | None]:
    """Return for each peer the time [s] until it has a link to each other one; None if not."""
    context = multiprocessing.get_context("spawn")
    with TemporaryDirectory() as folder, open_router(Path(folder) / "router.sock"):
        pipes = [context.Pipe() for _ in range(PEERS)]
        peers = [context.Process(target=_link, args=(folder, pipe[1])) for pipe in pipes]
        for peer in peers:
            peer.start()
        for ours, _ in pipes:
            ours.recv()  # imported
        for ours, _ in pipes:
            ours.send("start")
        found = [ours.recv() for ours, _ in pipes]
        for (ours, _), peer in zip(pipes, peers, strict=True):
            ours.send("end")
            peer.join()
    return found


def _link(folder: str, parent: Connection) -> None:
    parent.send("imported")
    parent.recv()
    began = time.perf_counter()
    socket = Path(folder) / f"{os.getpid()}.sock"
    with open_peer([f"unixsock-stream/{folder}/router.sock"], socket) as session:
        changed = threading.Event()
        callback: Any = zenoh.handlers.Callback(lambda _: changed.set(), indirect=False)
        listener = session.info.declare_transport_events_listener(callback, history=True)
        while len(list(session.info.peers_zid())) < PEERS - 1:
            if not changed.wait(began + _LIMIT_S - time.perf_counter()):
                parent.send(None)
                break
            changed.clear()
        else:
            parent.send(time.perf_counter() - began)
        parent.recv()
        listener.undeclare()


def _after_pause(pause_s: float) -> float:
    """Return the time [s] from the end of a peer's pause to its first message at another one."""
    context = multiprocessing.get_context("spawn")
    with TemporaryDirectory() as name, open_router(Path(name) / "router.sock"):
        endpoint = f"unixsock-stream/{name}/router.sock"
        with open_peer([endpoint], Path(name) / "reader.sock") as session:
            received: Any = session.declare_subscriber("beat", zenoh.handlers.RingChannel(1))
            sender = context.Process(target=_send, args=(endpoint, name), daemon=True)
            sender.start()
            try:
                received.recv()
                os.kill(sender.pid or 0, signal.SIGSTOP)
                time.sleep(pause_s)  # the benchmark measures what follows such a pause
                while received.try_recv() is not None:
                    pass
                began = time.perf_counter()
                os.kill(sender.pid or 0, signal.SIGCONT)
                received.recv()
                return time.perf_counter() - began
            finally:
                sender.kill()
                sender.join()


def _send(endpoint: str, folder: str) -> None:
    with open_peer([endpoint], Path(folder) / "sender.sock") as session:
        while True:
            session.put("beat", b"")
            time.sleep(_PERIOD_S)  # a sender with a period
