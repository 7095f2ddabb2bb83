"""`cairn emulate` as users run it: a process, with orders on its stdin."""

import json
import queue
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.driver.emulate_command import Place, fault_shares
from cairn.driver.link import SerialLink, TcpLink
from cairn.testing.launching import CAIRN
from tests.cairn.driver.parrot import read_until
from tests.commands import cairn
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


class Emulator:
    """A running `cairn emulate`."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        self._lines: queue.Queue[str] = queue.Queue()
        self._thread = threading.Thread(target=self._collect, daemon=True)
        self._thread.start()
        self.where = self.line()
        self.line()  # how it is used

    def _collect(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.rstrip("\n"))

    def line(self) -> str:
        """The next line of its output."""
        return self._lines.get(timeout=LIMIT_S)

    def order(self, text: str) -> str:
        """Its answer to an order."""
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        return self.line()

    def end(self) -> int:
        """Its exit status, once it has ended."""
        return self.process.wait(LIMIT_S)


@contextmanager
def _emulator(*words: str, stdin: int = subprocess.PIPE) -> Iterator[Emulator]:
    process = subprocess.Popen(
        [CAIRN, "emulate", *words],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield Emulator(process)
    finally:
        process.kill()
        process.wait(LIMIT_S)
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()


def test_faults_are_ordered_while_it_runs(tmp_path: Path) -> None:
    path, record = tmp_path / "scanner", tmp_path / "sent.jsonl"
    with _emulator("hokuyo", "--pty", str(path), "--record", str(record)) as emulator:
        assert emulator.where == f"a UTM-30LX is on {path} (a serial port in software)"
        link = SerialLink(str(path), 115200)
        link.write(b"VV\n")
        assert b"PROD:SOKUIKI Sensor TOP-URG UTM-30LX;" in read_until(link, b"\n\n")
        assert emulator.order("drop 1") == "drop: the next one"
        link.write(b"PP\nVV\n")
        assert read_until(link, b"SERI").startswith(b"VV")
        assert emulator.order("trouble 0m 2") == "status 0M in place of 2 of the next scans"
        link.write(b"MD0000108001003\n")
        assert read_until(link, b"MD0000108001000\n99b\n").count(b"\n0Mm\n") == 2
        assert emulator.order("bad_sum few") == "not done: 'few' is no number of frames"
        assert emulator.order("dance") == "not done: there is no order dance; help lists all"
        assert "spoilt: drop 1" in emulator.order("status")
        assert emulator.order("unplug") == "unplugged"
        assert not path.is_symlink()
        assert emulator.order("plug") == "plugged in"
        assert path.is_symlink()
        link.close()
        emulator.process.stdin.write("quit\n")  # type: ignore[union-attr]
        emulator.process.stdin.flush()  # type: ignore[union-attr]
        assert emulator.end() == 0
    assert not path.is_symlink()
    sent = [json.loads(line) for line in record.read_text().splitlines()]
    assert [len(scan["distances"]) for scan in sent] == [1081] * 3
    assert {scan["command"] for scan in sent} == {"MD"}


def test_without_a_stdin_it_runs_until_a_signal(tmp_path: Path) -> None:
    path = tmp_path / "scanner"
    with _emulator("pbs-03jn", "--pty", str(path), stdin=subprocess.DEVNULL) as emulator:
        link = SerialLink(str(path), 57600)
        link.write(b"\x02H&DX40\x03")
        assert read_until(link, b"\x03").startswith(b"\x02H&")
        emulator.process.send_signal(signal.SIGTERM)
        assert emulator.end() == 0
        link.close()
    assert not path.is_symlink()


def test_a_free_tcp_port_is_told() -> None:
    with _emulator("hokuyo", "--model", "UST-10LX", "--tcp", "0") as emulator:
        host, _, port = emulator.where.removeprefix("a UST-10LX is on ").partition(":")
        link = TcpLink(host, int(port.partition(" ")[0]))
        link.write(b"PP\n")
        assert b"MODL:UST-10LX" in read_until(link, b"\n\n")
        link.close()
        emulator.process.send_signal(signal.SIGINT)
        assert emulator.end() == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("hokuyo", "one of --pty PATH, --tcp PORT, --serial PORT"),
        ("hokuyo --pty a --tcp 0", "one of --pty PATH, --tcp PORT, --serial PORT"),
        ("hokuyo --tcp 0 --model URG", "--model URG: it is one of URG-04LX, "),
        ("hokuyo --tcp 0 --scip1", "--scip1: a UTM-30LX speaks SCIP 2 alone"),
        ("hokuyo --tcp 0 --rs232 19200", "--rs232 19200: a UTM-30LX has no RS-232 line"),
        ("hokuyo --tcp 0 --record /nowhere/a", "--record /nowhere/a cannot be written: No such"),
    ],
)
def test_what_cannot_be_is_told_in_a_sentence(words: str, told: str) -> None:
    answer = cairn("emulate", *words.split())
    assert answer.code == 1
    assert told in answer.err


def test_shares_of_faults_are_read() -> None:
    assert fault_shares("bad_sum=0.01,cut=1") == {"bad_sum": 0.01, "cut": 1.0}
    assert fault_shares("") == {}
    for text in ("bad_sum", "bad_sum=2", "bad_sum=-0.1", "sad_bum=0.1", "drop=x", "drop=nan"):
        with pytest.raises(CairnError, match=f"--faults {text}: write FAULT=SHARE"):
            fault_shares(text)


def test_a_place_is_one_of_three() -> None:
    assert Place(tcp=0).end(None).where == "127.0.0.1:0 (TCP)"
    with pytest.raises(CairnError, match="say where it is to be"):
        Place().end(None)
