"""Computers and a cable between them: network namespaces, and a relay that delays, loses and cuts.

Each namespace has one end of a TUN device; this process passes packets from one to the other. So no
module of the kernel for emulated networks is needed.
"""

import ctypes
import fcntl
import heapq
import itertools
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from secrets import token_hex

_TUNSETIFF = 0x400454CA  # linux/if_tun.h
_IFF_TUN_NO_PI = 0x0001 | 0x1000
_CLONE_NEWNET = 0x40000000
_LONGEST_PACKET = 65_536


def missing() -> str:
    """Return what this computer lacks for namespaces, "" if it has all."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if not os.access("/dev/net/tun", os.R_OK | os.W_OK):
        return "there is no /dev/net/tun"
    name = f"cairn-probe-{token_hex(3)}"
    try:
        subprocess.run(["ip", "netns", "add", name], check=True, capture_output=True)
        subprocess.run(["ip", "netns", "del", name], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return f"no network namespace can be made: {error}"
    return ""


class Computer:
    """A network namespace with one end of the cable."""

    def __init__(self, name: str, address: str, device: str) -> None:
        self.name = name
        self.address = address
        self.device = device

    def enter(self) -> None:
        """Put this thread into the namespace: for `preexec_fn` of a process."""
        descriptor = os.open(f"/run/netns/{self.name}", os.O_RDONLY)
        if ctypes.CDLL(None, use_errno=True).setns(descriptor, _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), "setns")
        os.close(descriptor)


class Cable:
    """Passes packets between two computers; its faults may be set at any time."""

    def __init__(self, ends: tuple[int, int], seed: int = 0) -> None:
        """`ends` are the descriptors of the TUN devices."""
        self.delay_s = 0.0
        self.loss = 0.0
        self.is_cut = False
        self._ends = ends
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, int, bytes]] = []
        self._numbers = itertools.count()
        self._closed, self._bell = os.pipe()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop passing packets, and remove the devices."""
        os.write(self._bell, b"x")
        self._thread.join()
        for descriptor in (*self._ends, self._closed, self._bell):
            os.close(descriptor)

    def _run(self) -> None:
        while True:
            now = time.monotonic()
            while self._waiting and self._waiting[0][0] <= now:
                _, _, to, packet = heapq.heappop(self._waiting)
                self._send(to, packet)
            wait_s = self._waiting[0][0] - now if self._waiting else None
            readable = select.select([*self._ends, self._closed], [], [], wait_s)[0]
            if self._closed in readable:
                return
            for end in readable:
                other = self._ends[1] if end == self._ends[0] else self._ends[0]
                self._pass_on(os.read(end, _LONGEST_PACKET), other)

    def _pass_on(self, packet: bytes, to: int) -> None:
        if self.is_cut or self._random.random() < self.loss:
            return
        if self.delay_s == 0 and not self._waiting:
            self._send(to, packet)
        else:
            due = time.monotonic() + self.delay_s
            heapq.heappush(self._waiting, (due, next(self._numbers), to, packet))

    def _send(self, to: int, packet: bytes) -> None:
        if not self.is_cut:
            os.write(to, packet)


@contextmanager
def two_computers() -> Iterator[tuple[Computer, Computer, Cable]]:
    """Yield two computers and the cable between them."""
    with _namespaces() as (first, second), ExitStack() as stack:
        ends = []
        for computer in (first, second):
            ends.append(_tun(computer.device))
            _connect(computer)
        cable = Cable((ends[0], ends[1]))
        stack.callback(cable.close)
        yield first, second, cable


@contextmanager
def wired_computers() -> Iterator[tuple[Computer, Computer]]:
    """Yield two computers that the kernel connects, without a delay of this process."""
    with _namespaces() as (first, second):
        _ip("link", "add", first.device, "type", "veth", "peer", "name", second.device)
        for computer in (first, second):
            _connect(computer)
        yield first, second


@contextmanager
def _namespaces() -> Iterator[tuple[Computer, Computer]]:
    mark = token_hex(3)
    first, second = (
        Computer(f"cairn-test-{mark}-{number}", f"10.83.0.{number}", f"ct{mark}{number}")
        for number in (1, 2)
    )
    with ExitStack() as stack:
        for computer in (first, second):
            _ip("netns", "add", computer.name)
            stack.callback(_ip, "netns", "del", computer.name)
        yield first, second


def _connect(computer: Computer) -> None:
    """Give a computer its device, which exists."""
    _ip("link", "set", computer.device, "netns", computer.name)
    _ip("-n", computer.name, "addr", "add", f"{computer.address}/24", "dev", computer.device)
    _ip("-n", computer.name, "link", "set", computer.device, "up")
    _ip("-n", computer.name, "link", "set", "lo", "up")


def _tun(name: str) -> int:
    """Make a TUN device; return its descriptor, with which it ends."""
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_CLOEXEC)
    fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN_NO_PI))
    return descriptor


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, timeout=30)


def eventually(condition: Callable[[], bool], limit_s: float, what: str) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"not within {limit_s:g} s: {what}"
        time.sleep(0.05)
