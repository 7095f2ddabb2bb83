"""The logs of a component are bounded, and nothing that explains its end is lost."""

import logging
import subprocess
import sys
from pathlib import Path

import pytest

from cairn.runtime.log_output import BURST, LONGEST_RECORD, LogLimit, OutputHandler
from cairn.runtime.rate_limited_log import MOST_SUBJECTS, RateLimitedLog
from tests.patience import LIMIT_S


class Time:
    now = 50.0


@pytest.fixture
def log(caplog: pytest.LogCaptureFixture) -> logging.Logger:
    caplog.set_level(logging.INFO)
    return logging.getLogger("cairn.test_log_output")


def churn(log: logging.Logger) -> None:
    for number in range(5000):
        log.warning("client %d connected", number)


def test_flood_of_one_statement_is_limited_counted_and_hides_no_other(
    log: logging.Logger, caplog: pytest.LogCaptureFixture
) -> None:
    limit = LogLimit(log, lambda: Time.now)
    churn(log)
    log.error("tick: ValueError: no device")
    Time.now += 1.0
    churn(log)
    limit.report()  # not yet: some seconds are reported together
    Time.now += 10.0
    limit.report()
    limit.report()
    texts = [record.getMessage() for record in caplog.records]
    flood = [text for text in texts if text.startswith("client ")]
    limit.close()

    assert len(flood) == BURST + 10
    assert "tick: ValueError: no device" in texts
    (suppressed,) = (text for text in texts if text.startswith("suppressed "))
    assert suppressed.startswith(
        f"suppressed {10_000 - BURST - 10} log records of test_log_output.py:"
    )
    assert suppressed.endswith("the last one: client 4999 connected")


def test_continual_records_pass_at_a_limited_rate(
    log: logging.Logger, caplog: pytest.LogCaptureFixture
) -> None:
    limit = LogLimit(log, lambda: Time.now)
    for _ in range(1000):  # 100 s
        Time.now += 0.1
        log.info("once in a while")
    limit.close()

    assert len(caplog.records) == 1000


def test_long_record_is_cut(log: logging.Logger, caplog: pytest.LogCaptureFixture) -> None:
    limit = LogLimit(log)
    log.info("parameters changed: %s", "x" * 1_000_000)
    limit.close()

    text = caplog.records[0].getMessage()
    assert (len(text) < LONGEST_RECORD + 100, "1,000,020 characters" in text) == (True, True)


def test_control_characters_in_a_record_are_replaced(
    log: logging.Logger, caplog: pytest.LogCaptureFixture
) -> None:
    limit = LogLimit(log)
    log.info("pose of %s rejected", "map\x1b[2J\x9b1m")
    limit.close()

    assert caplog.records[0].getMessage() == "pose of map\ufffd[2J\ufffd1m rejected"


def test_warnings_about_invented_names_are_limited_as_one_statement(
    log: logging.Logger, caplog: pytest.LogCaptureFixture
) -> None:
    limit = LogLimit(log, lambda: Time.now)
    warnings, others = RateLimitedLog(log), RateLimitedLog(log)
    for number in range(3 * MOST_SUBJECTS):
        warnings.warn(f"peer {number}", f"refused peer {number}")
    others.warn("disk", "disk is full")
    limit.close()

    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == BURST + 2
    assert "disk is full" in texts
    assert len(warnings._counts) == MOST_SUBJECTS


PROGRAM = """
import os, sys, logging
from pathlib import Path
from cairn.runtime.process_exit import log_reason
from cairn.runtime.log_output import OutputFile, OutputHandler
file = Path(sys.argv[1])
stream = os.open(sys.argv[2], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
os.dup2(stream, 1), os.dup2(stream, 2)
output = OutputFile(file, max_size=10_000, old_files=2)
logging.basicConfig(level=logging.INFO, handlers=[OutputHandler()])
for number in range(1000):
    logging.getLogger().info("record %d", number)
    os.write(1, b"a library prints %d\\n" % number)
    output.check()
log_reason("no device")
"""


def run(file: Path, stream: Path) -> None:
    subprocess.run([sys.executable, "-c", PROGRAM, file, stream], check=True, timeout=LIMIT_S)


@pytest.mark.processes
def test_log_file_of_a_process_is_rotated_and_its_end_is_complete(tmp_path: Path) -> None:
    file = tmp_path / "base.log"
    run(file, file)

    old = sorted(tmp_path.glob("base.log.*"))
    text = b"".join(path.read_bytes() for path in (*reversed(old), file)).decode()
    assert [path.name for path in old] == ["base.log.1", "base.log.2"]
    assert all(10_000 <= path.stat().st_size < 10_200 for path in old)
    lines = text.splitlines()
    assert lines[-1].endswith("ended: no device")
    first = int(lines[1].split()[-1])
    assert lines[1:-1:2] == [f"a library prints {number}" for number in range(first, 1000)]


@pytest.mark.processes
def test_log_file_that_could_not_be_opened_at_the_start_is_opened_later(tmp_path: Path) -> None:
    file = tmp_path / "base.log"
    run(file, Path("/dev/null"))

    assert file.read_text().endswith("ended: no device\n")


def test_records_lost_on_a_full_disk_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Disk:
        full = True
        text = ""

        def write(self, text: str) -> None:
            if self.full:
                raise OSError(28, "No space left on device")
            self.text += text

        def flush(self) -> None:
            """Do nothing."""

    disk = Disk()
    monkeypatch.setattr(sys, "stderr", disk)
    handler = OutputHandler()
    record = logging.LogRecord("base", logging.INFO, "file", 1, "started", (), None)
    for _ in range(3):
        handler.emit(record)
    disk.full = False
    handler.emit(record)
    handler.emit(record)

    assert disk.text.count("started") == 2
    assert disk.text.count("up to 3 log records before this one are missing") == 1
