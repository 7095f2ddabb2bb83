"""An emulated device on a line: what its host sees, in good order and with each fault."""

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.driver.emulated_lines import LineEnd, PtyEnd, TcpEnd
from cairn.driver.emulated_serial_port import SerialEnd
from cairn.driver.emulation import Emulation
from cairn.driver.errors import LinkLost
from cairn.driver.faults import FrameFault
from cairn.driver.link import Link, SerialLink, TcpLink
from tests.cairn.driver.parrot import Parrot, asked, read_count, read_until
from tests.patience import LIMIT_S

Opening = Callable[[], Link]


@contextmanager
def _plugged(kind: str, folder: Path) -> Iterator[tuple[LineEnd, Opening]]:
    """A line of a kind, and how its other end is opened."""
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

    def read(self, limit_s: float) -> bytes:
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


@pytest.mark.parametrize("kind", ["pty", "tcp", "serial"])
def test_what_is_asked_is_answered(kind: str, tmp_path: Path) -> None:
    with _plugged(kind, tmp_path) as (end, opened), Emulation(Parrot(), end):
        link = opened()
        assert asked(link, b"polly") == b"polly\n"
        link.write(b"count\n")
        assert read_until(link, b"2\n").startswith(b"count\n1\n2\n")
        link.close()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_second_client_finds_it_as_the_first_one_left_it(kind: str, tmp_path: Path) -> None:
    parrot = Parrot()
    with _plugged(kind, tmp_path) as (end, opened), Emulation(parrot, end):
        first = opened()
        asked(first, b"count")
        first.close()
        second = opened()
        assert b"hello\n" in asked(second, b"hello")
        assert parrot.power_ons == 1
        assert parrot.hang_ups == (kind == "tcp")  # a serial line does not tell
        second.close()


def test_tcp_takes_one_client_at_a_time(tmp_path: Path) -> None:
    end = TcpEnd(0)
    with Emulation(Parrot(), end):
        first = TcpLink("127.0.0.1", end.port)
        asked(first, b"hello")
        second = TcpLink("127.0.0.1", end.port)
        with pytest.raises(LinkLost, match="closed the connection"):
            second.read(LIMIT_S)
        asked(first, b"still here")
        first.close()


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_unplugged_it_is_gone_and_plugged_in_again_it_is_new(kind: str, tmp_path: Path) -> None:
    parrot = Parrot()
    with _plugged(kind, tmp_path) as (end, opened), Emulation(parrot, end) as emulation:
        link = opened()
        asked(link, b"hello")
        emulation.unplug()
        with pytest.raises(LinkLost):
            read_count(link, 1)
        link.close()
        with pytest.raises(LinkLost):
            opened()
        assert not (tmp_path / "line").is_symlink()
        emulation.plug_in()
        link = opened()
        assert asked(link, b"again") == b"again\n"
        assert parrot.power_ons == 2
        link.close()


def test_it_may_come_back_by_itself(tmp_path: Path) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulation(Parrot(), end) as emulation:
        emulation.unplug(0.05)
        assert not emulation.plugged_in
        _await((tmp_path / "line").is_symlink)
        link = SerialLink(str(tmp_path / "line"), 9600)
        asked(link, b"hello")
        link.close()


def test_hanging_it_is_silent_and_deaf(tmp_path: Path) -> None:
    parrot = Parrot()
    end = PtyEnd(tmp_path / "line")
    with Emulation(parrot, end) as emulation:
        link = SerialLink(str(tmp_path / "line"), 9600)
        asked(link, b"count")
        emulation.hang()
        link.discard()
        link.write(b"lost\n")
        assert link.read(0.1) == b""
        emulation.hang(0)
        asked(link, b"hello")
        assert b"lost" not in parrot.heard
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
def test_frames_are_spoilt_as_ordered(
    fault: FrameFault, expected: Callable[[bytes], bool], tmp_path: Path
) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulation(Parrot(), end) as emulation:
        link = SerialLink(str(tmp_path / "line"), 9600)
        emulation.spoil(fault)
        link.write(b"x" * 39 + b"\nend\n")
        data = read_until(link, b"end\n")
        assert expected(data.removesuffix(b"end\n")), data
        assert emulation.spoilt == {fault: 1}
        assert emulation.frames_sent == 2
        link.close()


def test_shares_of_frames_are_spoilt_and_a_seed_repeats_it(tmp_path: Path) -> None:
    def spoilt() -> bytes:
        end = PtyEnd(tmp_path / "line")
        with Emulation(Parrot(), end, shares={"drop": 0.5}, seed=7):
            link = SerialLink(str(tmp_path / "line"), 9600)
            for number in range(40):
                link.write(b"%d\n" % number)
            link.write(b"end\n" * 10)
            data = read_until(link, b"end\n")
            link.close()
            return data.partition(b"end")[0]

    first = spoilt()
    assert 5 < first.count(b"\n") < 35
    assert spoilt() == first


def test_at_the_wrong_speed_it_hears_nothing_and_what_it_says_is_noise(tmp_path: Path) -> None:
    parrot = Parrot(speed=19200)
    end = PtyEnd(tmp_path / "line")
    with Emulation(parrot, end):
        link = SerialLink(str(tmp_path / "line"), 9600)
        link.write(b"deaf\n")
        assert link.read(0.1) == b""
        link.set_baud(19200)
        asked(link, b"count")
        link.set_baud(9600)
        while link.read(0.0):
            pass
        assert b"\0" in read_count(link, 40)
        link.close()
    assert parrot.heard == [b"count"]


def test_a_change_of_speed_is_answered_at_the_old_one(tmp_path: Path) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulation(Parrot(speed=9600), end, paced=True):
        link = SerialLink(str(tmp_path / "line"), 9600)
        assert asked(link, b"speak 19200") == b"speak 19200\n"
        link.set_baud(19200)
        assert asked(link, b"hello") == b"hello\n"
        link.close()


def test_a_slow_line_takes_its_time_and_old_news_are_not_sent(tmp_path: Path) -> None:
    end = PtyEnd(tmp_path / "line")
    with Emulation(Parrot(period_s=0.001), end) as emulation:
        link = SerialLink(str(tmp_path / "line"), 9600)
        emulation.slow(9600)
        began = time.monotonic()
        asked(link, b"x" * 480)  # 0.5 s of 10 bits a byte
        assert time.monotonic() - began > 0.45
        emulation.slow(None)
        asked(link, b"count")
        read_count(link, 100)
        link.close()


def test_what_nobody_reads_does_not_stop_it(tmp_path: Path) -> None:
    parrot = Parrot(period_s=0.0)
    end = PtyEnd(tmp_path / "line")
    with Emulation(parrot, end) as emulation:
        link = SerialLink(str(tmp_path / "line"), 9600)
        link.write(b"count\n")
        link.write((b"y" * 999 + b"\n") * 4)
        read_count(link, 1)
        emulation.hang(0)  # it follows orders
        link.discard()
        assert b"hello\n" in asked(link, b"hello")
        link.close()


def test_what_it_would_say_while_nobody_is_there_is_not_said() -> None:
    parrot = Parrot(period_s=0.0)
    end = TcpEnd(0)
    with Emulation(parrot, end) as emulation:
        link = TcpLink("127.0.0.1", end.port)
        asked(link, b"count")
        link.close()
        _await(lambda: parrot.hang_ups > 0)
        said = emulation.ask(lambda: parrot.number)
        emulation.slow(None)
        assert emulation.ask(lambda: parrot.number) == said
        link = TcpLink("127.0.0.1", end.port)
        read_count(link, 20)
        link.close()


def test_a_real_port_that_goes_and_comes_back_is_opened_again(tmp_path: Path) -> None:
    path, parrot = tmp_path / "port", Parrot()
    host, port = os.openpty()
    path.symlink_to(os.ttyname(port))
    with Emulation(parrot, SerialEnd(str(path), 9600)) as emulation:
        os.close(host)
        os.close(port)
        _await(lambda: not emulation.plugged_in)
        host, port = os.openpty()
        path.unlink()
        path.symlink_to(os.ttyname(port))
        _await(lambda: emulation.plugged_in)
        link = _Descriptor(host)
        assert asked(link, b"again") == b"again\n"
        link.close()
    assert parrot.power_ons == 2
    os.close(host)
    os.close(port)


def test_a_link_of_one_that_was_killed_is_replaced_and_other_files_are_not(tmp_path: Path) -> None:
    path = tmp_path / "line"
    path.symlink_to(tmp_path / "gone")
    with Emulation(Parrot(), PtyEnd(path)):
        assert path.resolve().is_char_device()
    assert not path.is_symlink()
    path.write_text("mine")
    with (
        pytest.raises(CairnError, match="name a path that is free"),
        Emulation(Parrot(), PtyEnd(path)),
    ):
        pass
    assert path.read_text() == "mine"


def test_a_port_that_is_taken_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(CairnError, match=f"127.0.0.1:{port} cannot be listened on"):
            Emulation(Parrot(), TcpEnd(port)).__enter__()


def test_a_device_that_fails_is_not_silent_about_it(tmp_path: Path) -> None:
    emulation = Emulation(Parrot(), PtyEnd(tmp_path / "line")).__enter__()
    link = SerialLink(str(tmp_path / "line"), 9600)
    link.write(b"fail\n")
    deadline = time.monotonic() + LIMIT_S
    with suppress(CairnError):
        while time.monotonic() < deadline:
            emulation.slow(None)
    with pytest.raises(CairnError, match="the emulated device has failed"):
        emulation.slow(None)
    with pytest.raises(RuntimeError, match="the parrot is dead"):
        emulation.__exit__()
    link.close()
    assert not (tmp_path / "line").is_symlink()
