"""The zygote with real processes: how they start and end, and which clients it rejects."""

import errno
import json
import math
import os
import signal
import socket
import stat
import sys
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cairn import CairnError
from cairn.processes import zygote as zygote_module
from cairn.processes.child import ZygoteLost
from cairn.processes.child_channel import channel_pair
from cairn.processes.launcher import ChildProcess, ZygoteClient, ZygoteProcess, start_zygote
from cairn.processes.zygote import Exited, Spawn, _open_log, encode
from tests.patience import LIMIT_S
from tests.sweeps import sampled
from tests.wording import words_in_order

from . import zygote_children
from .reports import Tree
from .zygote_owner import Owner

pytestmark = pytest.mark.processes


CHILDREN = zygote_children.__name__
FRESH = pytest.mark.parametrize("fresh", sampled([False, True]), ids=["shared", "fresh"])


@FRESH
def test_process_inherits_no_files_signal_handlers_or_threads_of_the_zygote(
    owner: Owner, fresh: bool
) -> None:
    child = owner.spawn("describe", fresh=fresh, text=["a", math.inf, {"b": None}])
    facts = owner.reports.of("driver").facts
    assert facts["pid"] == facts["group"] == child.pid
    assert facts["passed"]["text"] == ["a", math.inf, {"b": None}]
    assert facts["title"] == "cairn: driver"
    assert facts["descriptors"] == {"0": "/dev/null", "1": str(owner.log), "2": str(owner.log)}
    assert (facts["sigterm"], facts["sigchld"], facts["sigint"]) == (True, True, True)
    assert facts["blocked"] == []
    assert facts["threads"] == 1
    assert facts["malloc"] == str(1 << 20)
    assert facts["path"] == sys.path


def test_threads_of_a_process_use_the_same_free_memory(owner: Owner) -> None:
    owner.spawn("use_memory_in_each_thread")
    assert owner.reports.of("driver").facts["grown"] < 8.0


@FRESH
def test_process_gets_its_end_of_a_channel_and_its_helpers_do_not(
    owner: Owner, fresh: bool
) -> None:
    own, passed = channel_pair()
    with own, passed:
        child = owner.client.spawn(
            "driver",
            f"{CHILDREN}:answer_over_channel",
            {},
            owner.log,
            fresh=fresh,
            channel=passed,
            timeout_s=LIMIT_S,
        )
        passed.close()
        own.settimeout(LIMIT_S)
        assert json.loads(own.recv(1000)) == {"pid": child.pid, "inherited": []}
        assert own.recv(1000) == b"", "a helper holds the channel open"
    child.kill()
    assert child.wait(LIMIT_S) is not None


@FRESH
def test_process_that_returns_ends_normally_with_its_output_logged(
    owner: Owner, fresh: bool
) -> None:
    child = owner.spawn("write_output", text="hello", fresh=fresh)
    ended = child.wait(LIMIT_S)
    assert ended == owner.exits.get(timeout=LIMIT_S) == child.wait(0)
    assert ended == Exited(child.pid, 0)
    assert sorted(owner.log.read_text().splitlines()) == ["stderr hello", "stdout hello"]


@FRESH
def test_process_that_raises_ends_with_code_1_and_a_traceback(owner: Owner, fresh: bool) -> None:
    ended = owner.spawn("fail", device="/dev/ttyUSB0", fresh=fresh).wait(LIMIT_S)
    assert ended is not None
    assert ended.code == 1
    assert owner.log.read_text().endswith("ValueError: no device /dev/ttyUSB0\n")


@FRESH
def test_crash_is_reported_by_its_signal(owner: Owner, fresh: bool) -> None:
    ended = owner.spawn("crash", fresh=fresh).wait(LIMIT_S)
    assert ended is not None
    assert ended.code == -signal.SIGSEGV
    assert "Segmentation fault" in owner.log.read_text()


@FRESH
def test_signal_reaches_a_process_that_has_just_started(owner: Owner, fresh: bool) -> None:
    for _ in range(5):
        child = owner.spawn("run_until_killed", fresh=fresh)
        child.terminate()
        ended = child.wait(LIMIT_S)
        assert ended is not None
        assert ended.code == -signal.SIGTERM


def test_signals_to_a_process_that_has_ended_have_no_effect(owner: Owner) -> None:
    child = owner.spawn("write_output", text="")
    child.wait(LIMIT_S)
    child.terminate()
    child.kill()
    child.signal(signal.SIGHUP)


def test_killing_ends_even_a_stopped_process_that_ignores_sigterm(owner: Owner) -> None:
    child = owner.spawn("ignore_sigterm")
    owner.reports.of("driver")
    child.terminate()
    child.signal(signal.SIGSTOP)
    child.kill()
    ended = child.wait(LIMIT_S)
    assert ended is not None
    assert ended.code == -signal.SIGKILL


def test_exit_that_is_reported_as_a_pause_of_the_machine_ends_is_not_missed() -> None:
    class Paused(Future[Exited]):
        """In a pause the time limit passes and the exit is reported, both unnoticed."""

        def result(self, timeout: float | None = None) -> Exited:
            if self.done():
                return super().result(timeout)
            self.set_result(Exited(1, 0))
            raise TimeoutError

    child = ChildProcess(1, lambda _: None)
    child.exit = Paused()

    assert child.wait(LIMIT_S) == Exited(1, 0)


def test_module_that_cannot_be_imported_fails_only_processes_that_need_it(
    tree: Tree, tmp_path: Path
) -> None:
    zygote = start_zygote(["no_such_module", "json"], tmp_path / "run")
    client = ZygoteClient(zygote.socket_path)
    assert zygote.log_file.read_text().count("import failed: no_such_module: ") == 1
    log = tmp_path / "driver.log"
    with pytest.raises(
        CairnError,
        match=words_in_order("no_such_module", "ModuleNotFoundError", str(log)),
    ):
        client.spawn("driver", f"{CHILDREN}:write_output", {}, log, needs=["no_such_module"])
    assert "Traceback" in log.read_text()
    other = client.spawn("other", f"{CHILDREN}:write_output", {"text": ""}, log, needs=["json"])
    ended = other.wait(LIMIT_S)
    assert ended is not None
    assert ended.code == 0
    client.close()
    zygote.close()


def test_module_that_starts_threads_when_imported_is_named(
    tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starts_thread.py").write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    zygote = start_zygote(["json", "starts_thread", "numpy"], tmp_path / "run")
    client = ZygoteClient(zygote.socket_path)
    assert zygote.log_file.read_text().count("module starts threads: ") == 1
    assert "module starts threads: starts_thread: " in zygote.log_file.read_text()
    client.close()
    zygote.close()


@pytest.mark.parametrize("end", ["", "os._exit(3)"], ids=["helper ends", "helper fails"])
def test_kernels_are_compiled_in_a_process_that_ends_before_the_zygote_forks(
    tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    (tmp_path / "has_kernels.py").write_text(
        "import os\n"
        "from pathlib import Path\n"
        "from cairn.system.kernel_compilation import prepare_compilation\n"
        "cached, zygote = Path(__file__).with_name('cached'), os.getpid()\n"
        "if not cached.exists():\n"
        "    prepare_compilation()\n"
        f"    if os.getpid() != zygote: {end or 'pass'}\n"
        "    if not cached.exists():\n"
        "        cached.write_text(str(os.getpid()))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    zygote = start_zygote(["has_kernels", "json"], tmp_path / "run")
    zygote.wait_for_imports(LIMIT_S)
    compiler = int((tmp_path / "cached").read_text())
    assert [process.pid for process in tree.processes()] == [zygote.process.pid]
    assert (compiler == zygote.process.pid) == bool(end)
    log = zygote.log_file.read_text()
    assert ("exit code 3" if end else "compiled kernels: ") in log
    zygote.close()


@pytest.mark.parametrize(
    "first", ["", "import cairn.system.kernel_compilation as c; c.prepare_compilation()\n"]
)
def test_module_that_hangs_when_imported_does_not_delay_a_stop(
    tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: str
) -> None:
    (tmp_path / "hangs_when_imported.py").write_text(f"{first}import time\ntime.sleep(1000)\n")
    monkeypatch.syspath_prepend(tmp_path)
    zygote = start_zygote(["hangs_when_imported"], tmp_path / "run")
    with pytest.raises(CairnError, match="a stop was requested"):
        ZygoteClient(zygote.socket_path, canceled=lambda: True)
    zygote.close(LIMIT_S)
    assert zygote.process.returncode == -signal.SIGTERM  # not by SIGKILL, after the limit


def test_log_that_cannot_be_written_fails_the_start(owner: Owner, tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="No such file or directory"):
        owner.client.spawn("driver", f"{CHILDREN}:run_until_killed", {}, tmp_path / "none" / "log")


def test_process_starts_without_a_log_on_a_full_disk(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    real = os.open

    def full(path: Any, flags: int, *rest: Any) -> int:
        if flags & os.O_CREAT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, flags, *rest)

    monkeypatch.setattr(os, "open", full)
    descriptor = _open_log(str(tmp_path / "base.log"))
    monkeypatch.undo()

    assert os.write(descriptor, b"lost") == 4
    os.close(descriptor)


def test_log_of_the_zygote_is_bounded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    zygote_module._log("client disconnected")
    monkeypatch.setattr(zygote_module, "_LONGEST_LOG", -1)  # any size is beyond
    zygote_module._log("client disconnected")

    assert capsys.readouterr().err.count("client disconnected") == 1


def test_process_can_open_zenoh_sessions_although_its_owner_has_one(owner: Owner) -> None:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        ended = owner.spawn("open_session").wait(LIMIT_S)
    assert ended is not None
    assert ended.code == 0, owner.log.read_text()


def test_client_that_sends_garbage_loses_its_connection(
    zygote: ZygoteProcess, owner: Owner
) -> None:
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.settimeout(LIMIT_S)
        stranger.connect(str(zygote.socket_path))
        stranger.sendall(b'{"kind": "spawn"}\n')
        while stranger.recv(4096):
            pass
    assert "sent an invalid request" in zygote.log_file.read_text()
    owner.spawn("write_output", text="").wait(LIMIT_S)


def test_client_that_does_not_read_its_answers_loses_its_connection(
    zygote: ZygoteProcess, owner: Owner
) -> None:
    request = encode(
        Spawn(1, "driver", f"{CHILDREN}:run_until_killed", {}, "/no/such/log", False, ())
    )
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(LIMIT_S)
        client.connect(str(zygote.socket_path))
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            client.sendall(request * 100_000)
    ended = owner.spawn("write_output", text="").wait(LIMIT_S)
    assert ended is not None
    assert f"process {os.getpid()} does not read its answers" in zygote.log_file.read_text()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
def test_connection_of_another_user_is_rejected(
    zygote: ZygoteProcess, owner: Owner, tmp_path: Path
) -> None:
    for directory in (zygote.socket_path.parent, *zygote.socket_path.parents[1:-2]):
        directory.chmod(0o755)
    zygote.socket_path.chmod(0o777)
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.settimeout(LIMIT_S)
        os.seteuid(65534)
        try:
            stranger.connect(str(zygote.socket_path))
        finally:
            os.seteuid(0)
        assert stranger.recv(10) == b""
    assert "of user 65534" in zygote.log_file.read_text()


def test_runtime_directory_open_to_others_is_rejected(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    directory.mkdir()
    directory.chmod(0o755)
    with pytest.raises(CairnError, match="lets other users in"):
        start_zygote([], directory)


def test_runtime_directory_is_made_for_its_owner_alone(zygote: ZygoteProcess) -> None:
    assert stat.S_IMODE(zygote.socket_path.parent.stat().st_mode) == 0o700


def test_runtime_directory_with_too_long_a_path_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=r"may have 107; set CAIRN_RUNTIME_DIR"):
        start_zygote([], tmp_path / ("x" * 100))


def test_without_a_zygote_there_is_no_connection(tmp_path: Path) -> None:
    with pytest.raises(ZygoteLost, match="no zygote listens on"):
        ZygoteClient(tmp_path / "zygote.sock")
