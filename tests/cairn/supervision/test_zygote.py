"""The zygote with real processes: how they start, how they end, and what ends with them."""

import math
import os
import queue
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from reports import LIMIT_S, Report, Reports, Tree

from cairn.errors import CairnError
from cairn.supervision.child_process import ChildExit, ChildProcess
from cairn.supervision.zygote_client import SpawnFailed, ZygoteClient, ZygoteLost
from cairn.supervision.zygote_process import ZygoteProcess, start_zygote

FRESH = pytest.mark.parametrize("fresh", [False, True], ids=["shared", "fresh"])
HIDDEN = pytest.mark.parametrize("how", ["same group", "own session", "daemon"])


class Owner:
    """A client of the zygote, as a test uses it."""

    def __init__(self, zygote: ZygoteProcess, reports: Reports, log: Path) -> None:
        self.exits: queue.Queue[ChildExit] = queue.Queue()
        self.losses: queue.Queue[ZygoteLost] = queue.Queue()
        self.client = ZygoteClient(zygote.socket_path, self.exits.put, self.losses.put)
        self.reports = reports
        self.log = log
        self.facts = {"reports": reports.path, "zygote": str(zygote.socket_path), "log": str(log)}

    def spawn(self, entry: str, name: str = "driver", **argument: Any) -> ChildProcess:
        fresh = argument.pop("fresh", False)
        return self.client.spawn(
            name,
            f"zygote_children:{entry}",
            {"name": name, **self.facts, **argument},
            self.log,
            fresh=fresh,
        )

    def running(self, entry: str, name: str = "driver", **argument: Any) -> Report:
        """The report of a process just spawned."""
        self.spawn(entry, name, **argument)
        return self.reports.of(name)


@pytest.fixture
def make_owner(
    zygote: ZygoteProcess, reports: Reports, tmp_path: Path
) -> Iterator[Callable[[], Owner]]:
    owners: list[Owner] = []

    def make() -> Owner:
        owners.append(Owner(zygote, reports, tmp_path / "driver.log"))
        return owners[-1]

    yield make
    for owner in owners:
        owner.client.close()


@pytest.fixture
def owner(make_owner: Callable[[], Owner]) -> Owner:
    return make_owner()


@FRESH
def test_a_process_has_nothing_of_the_zygote(owner: Owner, fresh: bool) -> None:
    child = owner.spawn("describe", fresh=fresh, said=["a", math.inf, {"b": None}])
    facts = owner.reports.of("driver").facts
    assert facts["pid"] == facts["group"] == child.pid
    assert facts["given"]["said"] == ["a", math.inf, {"b": None}]
    assert facts["title"] == "cairn: driver"
    assert facts["descriptors"] == {"0": "/dev/null", "1": str(owner.log), "2": str(owner.log)}
    assert (facts["sigterm"], facts["sigchld"], facts["sigint"]) == (True, True, True)
    assert facts["blocked"] == []
    assert facts["threads"] == 1
    assert facts["malloc"] == "33554432"
    assert facts["path"] == sys.path


@FRESH
def test_a_process_that_returns_ends_normally_with_its_output_logged(
    owner: Owner, fresh: bool
) -> None:
    child = owner.spawn("speak", said="hello", fresh=fresh)
    ended = child.wait(LIMIT_S)
    assert ended == owner.exits.get(timeout=LIMIT_S) == child.exit
    assert ended == ChildExit(child.pid, "driver", 0, None)
    assert ended.normal
    assert sorted(owner.log.read_text().splitlines()) == ["murmured hello", "said hello"]


@FRESH
def test_a_process_that_raises_ends_with_code_1_and_a_traceback(owner: Owner, fresh: bool) -> None:
    ended = owner.spawn("fail", device="/dev/ttyUSB0", fresh=fresh).wait(LIMIT_S)
    assert ended is not None
    assert (ended.code, ended.normal) == (1, False)
    assert str(ended) == f"driver (process {ended.pid}) ended with exit code 1"
    assert owner.log.read_text().endswith("ValueError: no device /dev/ttyUSB0\n")


@FRESH
def test_a_fault_is_told_by_its_signal(owner: Owner, fresh: bool) -> None:
    ended = owner.spawn("crash", fresh=fresh).wait(LIMIT_S)
    assert ended is not None
    assert str(ended) == f"driver (process {ended.pid}) was killed by SIGSEGV"
    assert "Segmentation fault" in owner.log.read_text()


@FRESH
def test_a_signal_reaches_a_process_however_young(owner: Owner, fresh: bool) -> None:
    for _ in range(5):
        child = owner.spawn("stay", fresh=fresh)
        child.terminate()
        ended = child.wait(LIMIT_S)
        assert ended is not None
        assert ended.signal == signal.SIGTERM


def test_a_process_that_has_ended_can_be_signalled_in_vain(owner: Owner) -> None:
    child = owner.spawn("speak", said="")
    child.wait(LIMIT_S)
    child.terminate()
    child.kill()
    owner.client.signal(child.pid, signal.SIGTERM)


def test_killing_takes_even_a_stopped_process_that_ignores_sigterm(owner: Owner) -> None:
    child = owner.spawn("ignore_sigterm")
    owner.reports.of("driver")
    child.terminate()
    child.signal(signal.SIGSTOP)
    child.kill()
    ended = child.wait(LIMIT_S)
    assert ended is not None
    assert ended.signal == signal.SIGKILL


@HIDDEN
def test_what_a_process_leaves_behind_is_killed_when_it_returns(owner: Owner, how: str) -> None:
    owner.spawn("leave_helper", how=how)
    assert owner.exits.get(timeout=LIMIT_S).normal
    # It may have been killed before it could report: the fixture `tree` sees that it is gone.


@HIDDEN
@FRESH
def test_the_helpers_of_a_killed_process_are_killed(owner: Owner, how: str, fresh: bool) -> None:
    driver = owner.running("keep_helper", how=how, fresh=fresh)
    helper = owner.reports.of("driver's helper")
    os.kill(driver.pid, signal.SIGKILL)
    helper.await_end()


def test_a_daemon_of_a_living_process_dies_no_later_than_that(owner: Owner) -> None:
    driver = owner.running("keep_helper", how="daemon")
    helper = owner.reports.of("driver's helper")
    owner.client.kill(driver.pid)
    helper.await_end()


def test_closing_a_connection_ends_its_processes_and_no_others(
    make_owner: Callable[[], Owner],
) -> None:
    first, second = make_owner(), make_owner()
    driver = first.running("keep_helper", how="own session")
    helper = first.reports.of("driver's helper")
    other = second.running("stay", "other")
    first.client.close()
    driver.await_end()
    helper.await_end()
    assert first.exits.get_nowait().signal == signal.SIGKILL
    assert first.losses.empty()
    with pytest.raises(CairnError, match="is closed"):
        first.spawn("stay")
    os.kill(other.pid, 0)
    assert second.exits.empty()


def test_the_processes_of_an_owner_that_is_killed_vanish_with_it(owner: Owner) -> None:
    middle = owner.running("own", "middle")
    leaf, helper = owner.reports.of("leaf"), owner.reports.of("leaf's helper")
    bystander = owner.running("stay", "bystander")
    os.kill(middle.pid, signal.SIGKILL)
    leaf.await_end()
    helper.await_end()
    os.kill(bystander.pid, 0)


def test_a_fork_of_a_dead_owner_does_not_keep_its_processes_alive(owner: Owner) -> None:
    middle = owner.running("own_and_fork", "middle")
    leaf, fork = owner.reports.of("leaf"), owner.reports.of("fork")
    os.kill(middle.pid, signal.SIGKILL)
    leaf.await_end()
    fork.await_end()


def test_a_module_that_cannot_be_imported_fails_only_what_needs_it(
    tree: Tree, tmp_path: Path
) -> None:
    zygote = start_zygote(["no_such_module", "json"], tmp_path / "run")
    client = ZygoteClient(zygote.socket_path)
    assert list(client.preload_failures) == ["no_such_module"]
    log = tmp_path / "driver.log"
    with pytest.raises(
        SpawnFailed,
        match=r"(?s)^driver could not be started: the module no_such_module cannot be imported: "
        r"ModuleNotFoundError: No module named 'no_such_module'.*Traceback",
    ):
        client.spawn("driver", "zygote_children:speak", {}, log, needs=["no_such_module"])
    other = client.spawn("other", "zygote_children:speak", {"said": ""}, log, needs=["json"])
    ended = other.wait(LIMIT_S)
    assert ended is not None
    assert ended.normal
    client.close()
    zygote.close()


def test_a_module_that_starts_threads_when_imported_is_named(
    tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starts_thread.py").write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    zygote = start_zygote(["json", "starts_thread", "numpy"], tmp_path / "run")
    client = ZygoteClient(zygote.socket_path)
    assert {module: len(names) for module, names in client.preload_threads.items()} == {
        "starts_thread": 1
    }
    assert "starts_thread starts threads when imported" in zygote.log_file.read_text()
    client.close()
    zygote.close()


def test_a_root_killed_during_the_imports_leaves_nothing(tree: Tree, tmp_path: Path) -> None:
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    (tmp_path / "imports_slowly.py").write_text(f"open({str(gate)!r}).read()\n")
    program = (
        f"import sys; sys.path[:] = {[str(tmp_path), *sys.path]!r}\n"
        "from pathlib import Path\n"
        "from cairn.supervision.zygote_process import start_zygote\n"
        f"zygote = start_zygote(['imports_slowly'], Path({str(tmp_path / 'run')!r}))\n"
        "sys.stdin.read()\n"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE) as root,
        gate.open("w"),  # opens when the zygote reads
    ):
        root.kill()
        root.wait(LIMIT_S)
        tree.await_end()


def test_a_log_that_cannot_be_written_fails_the_start(owner: Owner, tmp_path: Path) -> None:
    with pytest.raises(SpawnFailed, match="No such file or directory"):
        owner.client.spawn("driver", "zygote_children:stay", {}, tmp_path / "none" / "log")


def test_a_process_opens_zenoh_sessions_though_its_owner_has_one(owner: Owner) -> None:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        ended = owner.spawn("open_session").wait(LIMIT_S)
    assert ended is not None
    assert ended.normal, owner.log.read_text()


@FRESH
def test_a_zygote_that_is_killed_takes_all_processes_along(
    owner: Owner, zygote: ZygoteProcess, tree: Tree, tmp_path: Path, fresh: bool
) -> None:
    owner.running("keep_helper", how="same group")
    owner.running("own", "middle", leaf_fresh=fresh)
    leaf = owner.reports.of("leaf")
    owner.reports.of("leaf's helper")
    os.kill(zygote.pid, signal.SIGKILL)
    leaf.await_end()
    assert "is lost" in str(owner.losses.get(timeout=LIMIT_S))
    assert {owner.exits.get_nowait().name, owner.exits.get_nowait().name} == {"driver", "middle"}
    with pytest.raises(ZygoteLost):
        owner.spawn("stay")
    zygote.close()
    assert not zygote.alive
    tree.await_end()
    another = start_zygote(["zygote_children"], tmp_path / "run")
    renewed = Owner(another, owner.reports, owner.log)
    renewed.running("stay", "renewed")
    renewed.client.close()
    another.close()


def test_a_zygote_asked_to_end_by_sigterm_leaves_nothing(
    owner: Owner, zygote: ZygoteProcess, tree: Tree
) -> None:
    owner.running("keep_helper", how="daemon")
    owner.reports.of("driver's helper")
    os.kill(zygote.pid, signal.SIGTERM)
    tree.await_end()


def test_ending_the_zygote_leaves_nothing(owner: Owner, zygote: ZygoteProcess, tree: Tree) -> None:
    owner.running("keep_helper", how="daemon")
    owner.reports.of("driver's helper")
    zygote.close()
    tree.await_end()
    assert not zygote.socket_path.exists()


def test_a_zygote_that_does_not_answer_is_reported_and_its_late_process_killed(
    owner: Owner, zygote: ZygoteProcess
) -> None:
    os.kill(zygote.pid, signal.SIGSTOP)
    with pytest.raises(CairnError, match=r"did not start driver within 0\.05 s"):
        owner.client.spawn(
            "driver",
            "zygote_children:stay",
            {"name": "driver", **owner.facts},
            owner.log,
            timeout_s=0.05,
        )
    os.kill(zygote.pid, signal.SIGCONT)
    owner.spawn("speak", said="").wait(LIMIT_S)
    # The late one may be killed before it could report: the fixture `tree` sees that it is gone.


def test_a_client_that_talks_nonsense_loses_its_connection(
    zygote: ZygoteProcess, owner: Owner
) -> None:
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.settimeout(LIMIT_S)
        stranger.connect(str(zygote.socket_path))
        stranger.sendall(b'{"kind": "spawn"}\n')
        while stranger.recv(4096):
            pass
    assert "no valid request" in zygote.log_file.read_text()
    owner.spawn("speak", said="").wait(LIMIT_S)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
def test_another_user_is_refused(zygote: ZygoteProcess, owner: Owner, tmp_path: Path) -> None:
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


def test_a_runtime_directory_open_to_others_is_refused(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    directory.mkdir()
    directory.chmod(0o755)
    with pytest.raises(CairnError, match="can be used by other users"):
        start_zygote([], directory)


def test_the_runtime_directory_is_made_for_its_owner_alone(zygote: ZygoteProcess) -> None:
    assert stat.S_IMODE(zygote.socket_path.parent.stat().st_mode) == 0o700


def test_a_runtime_directory_with_too_long_a_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="shorter runtime directory"):
        start_zygote([], tmp_path / ("x" * 100))


def test_without_a_zygote_there_is_no_connection(tmp_path: Path) -> None:
    with pytest.raises(ZygoteLost, match="no zygote listens on"):
        ZygoteClient(tmp_path / "zygote.sock")
