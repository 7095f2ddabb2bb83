"""`cairn emulate` as users run it: a process that reads fault commands from stdin."""

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
from cairn.driver.emulator_cli import LineOptions, fault_shares
from cairn.driver.serial_and_tcp import SerialLink, TcpLink
from cairn.testing.launching import CAIRN
from tests.cairn.driver.parrot import read_until
from tests.commands import cairn
from tests.patience import LIMIT_S
from tests.wording import assert_words

pytestmark = pytest.mark.processes


class RunningEmulator:
    """A running `cairn emulate`."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        self._lines: queue.Queue[str] = queue.Queue()
        self._thread = threading.Thread(target=self._collect, daemon=True)
        self._thread.start()
        self.address = self.line()
        self.line()  # how to use it

    def _collect(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.rstrip("\n"))

    def line(self) -> str:
        """Return the next line of its output."""
        return self._lines.get(timeout=LIMIT_S)

    def execute(self, text: str) -> str:
        """Return its answer to a fault command."""
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        return self.line()

    def end(self) -> int:
        """Wait for its end; return its exit status."""
        return self.process.wait(LIMIT_S)


@contextmanager
def _emulator(*words: str, stdin: int = subprocess.PIPE) -> Iterator[RunningEmulator]:
    process = subprocess.Popen(
        [CAIRN, "emulate", *words],
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield RunningEmulator(process)
    finally:
        process.kill()
        process.wait(LIMIT_S)
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()


def test_fault_commands_take_effect_while_it_runs(tmp_path: Path) -> None:
    path, record = tmp_path / "scanner", tmp_path / "sent.jsonl"
    with _emulator("hokuyo", "--pty", str(path), "--record", str(record)) as emulator:
        assert_words(emulator.address, "UTM-30LX", str(path), "pseudo-terminal")
        link = SerialLink(str(path), 115200)
        link.write(b"VV\n")
        assert b"PROD:SOKUIKI Sensor TOP-URG UTM-30LX;" in read_until(link, b"\n\n")
        assert emulator.execute("drop 1") == "drop: next frame"
        link.write(b"PP\nVV\n")
        assert read_until(link, b"SERI").startswith(b"VV")
        assert_words(emulator.execute("scan_status 0m 2"), "status 0M", "2 scans")
        link.write(b"MD0000108001003\n")
        assert read_until(link, b"MD0000108001000\n99b\n").count(b"\n0Mm\n") == 2
        assert_words(emulator.execute("bad_sum few"), "error", "'few'", "number")
        assert_words(emulator.execute("dance"), "error", "dance", "`help`")
        assert "damaged: drop 1" in emulator.execute("status")
        assert emulator.execute("unplug") == "unplugged"
        assert not path.is_symlink()
        assert emulator.execute("plug") == "plugged in"
        assert path.is_symlink()
        link.close()
        emulator.process.stdin.write("quit\n")  # type: ignore[union-attr]
        emulator.process.stdin.flush()  # type: ignore[union-attr]
        assert emulator.end() == 0
    assert not path.is_symlink()
    sent = [json.loads(line) for line in record.read_text().splitlines()]
    assert [len(scan["distances"]) for scan in sent] == [1081] * 3
    assert {scan["command"] for scan in sent} == {"MD"}


def test_emulator_without_stdin_runs_until_a_signal(tmp_path: Path) -> None:
    path = tmp_path / "scanner"
    with _emulator("pbs-03jn", "--pty", str(path), stdin=subprocess.DEVNULL) as emulator:
        link = SerialLink(str(path), 57600)
        link.write(b"\x02H&DX40\x03")
        assert read_until(link, b"\x03").startswith(b"\x02H&")
        emulator.process.send_signal(signal.SIGTERM)
        assert emulator.end() == 0
        link.close()
    assert not path.is_symlink()


def test_port_0_takes_a_free_tcp_port_and_prints_it() -> None:
    with _emulator("hokuyo", "--model", "UST-10LX", "--tcp", "0") as emulator:
        host, _, port = emulator.address.removeprefix("a UST-10LX is on ").partition(":")
        link = TcpLink(host, int(port.partition(" ")[0]))
        link.write(b"PP\n")
        assert b"MODL:UST-10LX" in read_until(link, b"\n\n")
        link.close()
        emulator.process.send_signal(signal.SIGINT)
        assert emulator.end() == 0


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("hokuyo", "one of --pty PATH, --tcp PORT, --serial PORT"),
        ("hokuyo --pty a --tcp 0", "one of --pty PATH, --tcp PORT, --serial PORT"),
        ("hokuyo --tcp 0 --model URG", "--model URG: unknown model; give one of URG-04LX, "),
        ("hokuyo --tcp 0 --scip1", "--scip1: a UTM-30LX has SCIP 2 only"),
        ("hokuyo --tcp 0 --rs232 19200", "--rs232 19200: a UTM-30LX has no RS-232 line"),
        (
            "hokuyo --tcp 0 --record /nowhere/a",
            "--record /nowhere/a: the file cannot be written",
        ),
    ],
)
def test_invalid_options_are_named_with_the_remedy(words: str, error: str) -> None:
    answer = cairn("emulate", *words.split())
    assert answer.code == 1
    assert error in answer.err


def test_fault_shares_are_parsed_and_invalid_ones_rejected() -> None:
    assert fault_shares("bad_sum=0.01,cut=1") == {"bad_sum": 0.01, "cut": 1.0}
    assert fault_shares("") == {}
    for text in ("bad_sum", "bad_sum=2", "bad_sum=-0.1", "sad_bum=0.1", "drop=x", "drop=nan"):
        with pytest.raises(CairnError, match=f"--faults {text}: .* write FAULT=SHARE"):
            fault_shares(text)


def test_exactly_one_line_option_is_required() -> None:
    assert LineOptions(tcp=0).end(None).address == "127.0.0.1:0 (TCP)"
    with pytest.raises(CairnError, match="give one of --pty PATH"):
        LineOptions().end(None)
