"""The effects of an emulated device on its host: in normal operation, and with each fault."""

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.driver.emulator import Emulator, FrameFault
from cairn.driver.emulator_lines import LineEnd, PtyEnd, SerialEnd, TcpEnd
from cairn.driver.errors import LinkLost
from cairn.driver.serial_and_tcp import Link, SerialLink, TcpLink
from tests.cairn.driver.parrot import (
    Parrot,
    read_count,
    read_until,
    read_until_quiet,
    request,
)
from tests.patience import LIMIT_S
from tests.wording import words_in_order

Opening = Callable[[], Link]


@contextmanager
def _plugged(kind: str, folder: Path) -> Iterator[tuple[LineEnd, Opening]]:
    """A line of a kind, and the function that opens its other end."""
    if kind == "tcp":
        end = TcpEnd(0)
        yield end, lambda: TcpLink("127.0.0.1", end.port)
        return
    path = folder / "line"
    if kind == "pty":
        yield PtyEnd(path), lambda: SerialLink(str(path), 9600)
        return
    # A real port, as a pseudo-terminal whose other end is the host's.
    host, port = os.openpty()
    try:
        yield SerialEnd(os.ttyname(port), 9600), lambda: _Descriptor(host)
    finally:
        os.close(host)
        os.close(port)


class _Descriptor:
    """A line by its file descriptor, whose owner closes it."""

    name = "descriptor"
    paced = False

    def __init__(self, descriptor: int) -> None:
        self._file = os.fdopen(os.dup(descriptor), "r+b", buffering=0)

    def read(self, timeout_s: float) -> bytes:
        return self._file.read(65536) or b""

    def write(self, data: bytes) -> None:
        self._file.write(data)

    def set_baud(self, baud: int) -> None:
        pass

    def discard(self) -> None:
        pass

    def close(self) -> None:
        self._file.close()


def _await(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not happened():
        assert time.monotonic() < deadline
        os.sched_yield()


def _settle(emulator: Emulator) -> None:
    """Wait until the emulator has read everything that was written before.

    It reads after it has executed calls: at the second call it has read what came before the first.
    """
    for _ in range(2):
        emulator.call(lambda: None)


@pytest.mark.parametrize("kind", ["pty", "tcp", "serial"])
def test_requests_are_answered_on_each_kind_of_line(kind: str, tmp_path: Path) -> None:
    with _plugged(kind, tmp_path) as (end, opened), Emulator(Parrot(), end):
        link = opened()
        assert request(link, b"polly") == b"polly\n"
        link.write(b"count\n")
        assert read_until(link, b"2\n").startswith(b"count\n1\n2\n")
        link.close()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_device_keeps_its_state_between_clients(kind: str, tmp_path: Path) -> None:
    parrot = Parrot()
    with _plugged(kind, tmp_path) as (end, opened), Emulator(parrot, end):
        first = opened()
        request(first, b"count")
        first.close()
        second = opened()
        assert b"hello\n" in request(second, b"hello")
        assert parrot.power_ons == 1
        assert parrot.hang_ups == (kind == "tcp")  # a serial line does not signal it
        second.close()


def test_tcp_takes_one_client_at_a_time(tmp_path: Path) -> None:
    end = TcpEnd(0)
    with Emulator(Parrot(), end):
        first = TcpLink("127.0.0.1", end.port)
        request(first, b"hello")
        second = TcpLink("127.0.0.1", end.port)
        with pytest.raises(LinkLost, match="closed the connection"):
            second.read(LIMIT_S)
        request(first, b"still here")
        first.close()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_unplugged_device_vanishes_and_returns_restarted(kind: str, tmp_path: Path) -> None:
    parrot = Parrot()
    with _plugged(kind, tmp_path) as (end, opened), Emulator(parrot, end) as emulator:
        link = opened()
        request(link, b"hello")
        emulator.unplug()
        with pytest.raises(LinkLost):
            read_count(link, 1)
        link.close()
        with pytest.raises(LinkLost):
            opened()
        assert not (tmp_path / "line").is_symlink()
        emulator.plug_in()
        link = opened()
        assert request(link, b"again") == b"again\n"
        assert parrot.power_ons == 2
        link.close()


def test_device_unplugged_for_a_time_returns_by_itself(tmp_path: Path) -> None:
    parrot = Parrot()
    with Emulator(parrot, PtyEnd(tmp_path / "line")) as emulator:
        lost = SerialLink(str(tmp_path / "line"), 9600)
        emulator.unplug(0.05)
        with pytest.raises(LinkLost):
            read_count(lost, 1)
        lost.close()
        _await((tmp_path / "line").is_symlink)
        link = SerialLink(str(tmp_path / "line"), 9600)
        request(link, b"hello")
        link.close()
    assert parrot.power_ons == 2


def test_hanging_device_neither_sends_nor_receives(tmp_path: Path) -> None:
    parrot = Parrot()
    end = PtyEnd(tmp_path / "line")
    with Emulator(parrot, end) as emulator:
        link = SerialLink(str(tmp_path / "line"), 9600)
        request(link, b"count")
        emulator.hang()
        number = emulator.call(lambda: parrot.number)
        read_until_quiet(link)  # what was on the line already
        link.write(b"lost\n")
        _settle(emulator)
        assert link.read(0.1) == b""
        assert emulator.call(lambda: parrot.number) == number
        emulator.hang(0)
        request(link, b"hello")
        assert b"lost" not in parrot.received
        link.close()


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("bad_sum", lambda data: len(data) == 40 and data != b"x" * 39 + b"\n"),
        ("cut", lambda data: len(data) < 40 and set(data) <= set(b"x\n")),
        ("garbage", lambda data: len(data) > 40 and data.endswith(b"x" * 39 + b"\n")),
        ("drop", lambda data: data == b""),
    ],
)
def test_injected_faults_damage_the_next_frame(
    fault: FrameFault, expected: Callable[[bytes], bool], tmp_path: Path
) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulator(Parrot(), end) as emulator:
        link = SerialLink(str(tmp_path / "line"), 9600)
        emulator.inject(fault)
        link.write(b"x" * 39 + b"\nend\n")
        data = read_until(link, b"end\n")
        assert expected(data.removesuffix(b"end\n")), data
        assert emulator.injected == {fault: 1}
        assert emulator.frames_sent == 2
        link.close()


def test_same_seed_damages_the_same_share_of_frames(tmp_path: Path) -> None:
    def received() -> bytes:
        end = PtyEnd(tmp_path / "line")
        with Emulator(Parrot(), end, shares={"drop": 0.5}, seed=7):
            link = SerialLink(str(tmp_path / "line"), 9600)
            for number in range(40):
                link.write(b"%d\n" % number)
            link.write(b"end\n" * 10)
            data = read_until(link, b"end\n")
            link.close()
            return data.partition(b"end")[0]

    first = received()
    assert 5 < first.count(b"\n") < 35
    assert received() == first


def test_wrong_line_speed_garbles_both_directions(tmp_path: Path) -> None:
    parrot = Parrot(speed=19200)
    end = PtyEnd(tmp_path / "line")
    with Emulator(parrot, end) as emulator:
        link = SerialLink(str(tmp_path / "line"), 9600)
        link.write(b"deaf\n")
        _settle(emulator)
        assert link.read(0.1) == b""
        link.set_baud(19200)
        request(link, b"count")
        link.set_baud(9600)
        while link.read(0.0):
            pass
        assert b"\0" in read_count(link, 40)
        link.close()
    assert parrot.received == [b"count"]


def test_reply_to_a_speed_change_has_the_old_speed(tmp_path: Path) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulator(Parrot(speed=9600), end, paced=True):
        link = SerialLink(str(tmp_path / "line"), 9600)
        assert request(link, b"speak 19200") == b"speak 19200\n"
        link.set_baud(19200)
        assert request(link, b"hello") == b"hello\n"
        link.close()


def test_slow_line_delays_bytes_according_to_its_speed(tmp_path: Path) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulator(Parrot(period_s=0.001), end) as emulator:
        link = SerialLink(str(tmp_path / "line"), 9600)
        emulator.slow(9600)
        began = time.monotonic()
        request(link, b"x" * 480)  # 0.5 s of 10 bits per byte
        assert time.monotonic() - began > 0.45
        emulator.slow(None)
        request(link, b"count")
        read_count(link, 100)
        link.close()


def test_host_that_does_not_read_does_not_block_the_emulator(tmp_path: Path) -> None:
    parrot = Parrot(period_s=0.0)
    end = PtyEnd(tmp_path / "line")
    with Emulator(parrot, end) as emulator:
        link = SerialLink(str(tmp_path / "line"), 9600)
        link.write(b"count\n")
        link.write((b"y" * 999 + b"\n") * 4)
        read_count(link, 1)
        emulator.hang(0)  # it still executes calls
        link.discard()
        assert b"hello\n" in request(link, b"hello")
        link.close()


def test_nothing_is_sent_while_no_client_is_connected() -> None:
    parrot = Parrot(period_s=0.0)
    end = TcpEnd(0)
    with Emulator(parrot, end) as emulator:
        link = TcpLink("127.0.0.1", end.port)
        request(link, b"count")
        link.close()
        _await(lambda: parrot.hang_ups > 0)
        number = emulator.call(lambda: parrot.number)
        emulator.slow(None)
        assert emulator.call(lambda: parrot.number) == number
        link = TcpLink("127.0.0.1", end.port)
        read_count(link, 20)
        link.close()


def test_real_port_that_vanishes_is_opened_again_when_it_returns(tmp_path: Path) -> None:
    path, parrot = tmp_path / "port", Parrot()
    host, port = os.openpty()
    path.symlink_to(os.ttyname(port))
    with Emulator(parrot, SerialEnd(str(path), 9600)) as emulator:
        path.unlink()  # first: another process may get a pseudo-terminal of the same number
        os.close(host)
        os.close(port)
        _await(lambda: not emulator.plugged_in)
        host, port = os.openpty()
        path.symlink_to(os.ttyname(port))
        _await(lambda: emulator.plugged_in)
        link = _Descriptor(host)
        assert request(link, b"again") == b"again\n"
        link.close()
    assert parrot.power_ons == 2
    os.close(host)
    os.close(port)


def test_link_of_a_killed_emulator_is_replaced_but_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "line"
    path.symlink_to(tmp_path / "gone")
    with Emulator(Parrot(), PtyEnd(path)):
        assert path.resolve().is_char_device()
    assert not path.is_symlink()
    path.write_text("mine")
    with (
        pytest.raises(CairnError, match=words_in_order("name a path")),
        Emulator(Parrot(), PtyEnd(path)),
    ):
        pass
    assert path.read_text() == "mine"


def test_tcp_port_in_use_is_an_error_with_the_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(CairnError, match=f"127.0.0.1:{port} cannot be listened on"):
            Emulator(Parrot(), TcpEnd(port)).__enter__()


def test_failure_of_the_device_is_raised_to_the_caller(tmp_path: Path) -> None:
    emulator = Emulator(Parrot(), PtyEnd(tmp_path / "line")).__enter__()
    link = SerialLink(str(tmp_path / "line"), 9600)
    link.write(b"fail\n")
    deadline = time.monotonic() + LIMIT_S
    with suppress(CairnError):
        while time.monotonic() < deadline:
            emulator.slow(None)
    with pytest.raises(CairnError, match="the emulated device has failed"):
        emulator.slow(None)
    with pytest.raises(RuntimeError, match="the parrot is dead"):
        emulator.__exit__()
    link.close()
    assert not (tmp_path / "line").is_symlink()
