"""Exact re-runs: what was recorded is published again, and the first difference is named."""

import ast
import json
import os
import signal
import subprocess
import sys
import time
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml
from typer.testing import CliRunner

from cairn import to_ns
from cairn.bus.bus import MessageId
from cairn.cli.main import build
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.processes.run_plan import with_recorder
from cairn.recording.reader import McapRecording
from cairn.recording.rewrite import rewrite
from cairn.rerun import cli
from cairn.rerun.call_logs import component_starts
from cairn.rerun.comparison import first_difference
from cairn.rerun.engine import Payload, Rerun
from cairn.rerun.files import with_files
from cairn.rerun.result import RerunResult
from cairn.rerun.run import CALL_BATCH, chosen_starts, prepared_rerun, starts_in
from cairn.runtime.call_records import RecordEncoder, StartInfo
from cairn.runtime.call_records import RecordKind as Kind
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.input_files import content_digest
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import CallBatch
from cairn.schemas.geometry_msgs import Twist, TwistStamped, Vector3
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header, String
from cairn.testing.lockstep import DeploymentHarness
from cairn.testing.rerun import assert_rerun_equal, rerun_messages
from tests.cairn.rerun.walkers import CHANGE, Fragile, Walker
from tests.cairn.runtime.test_services_and_actions import Adder, Counter, Starter
from tests.commands import cairn
from tests.patience import LIMIT_S
from tests.sweeps import sampled
from tests.wording import assert_words

PLUGIN = f"{Walker.__module__}:Walker"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two walkers: one pushes the other, which fails, is restarted and reads its state."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "names.txt").write_text("five!")
    page = {
        "cairn": 1,
        "external_topics": ["nothing"],
        "components": {
            "first": {"plugin": PLUGIN, "topics": {"position": "pushes", "push": "nothing"},
                      "parameters": {"names": str(folder / "names.txt")}},
            "second": {"plugin": PLUGIN, "topics": {"push": "pushes", "corner": "corner2"},
                       "parameters": {"state_file": str(folder / "state")}},
        },
    }  # fmt: skip
    file = folder / "walkers.yaml"
    file.write_text(yaml.safe_dump(page))
    out = folder / "recording.mcap"
    with DeploymentHarness(with_recorder(load_deployment(file), out), seed=3) as run:
        run.run_for(1.0)
        run.request("second", "jump", by=2.5)
        run.set_parameters("second", {"step": 0.5})
        run.run_for(1.0)
        run.request("second", "fail")
        run.run_for(1.0)
    return out


def change_walker(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the walker publish positions that differ a little from 1.5 s on."""
    stamped = Walker._at

    def changed(self: Walker, x: float) -> TwistStamped:
        message = stamped(self, x)
        if to_ns(message.header.stamp) < 1_500_000_000:
            return message
        return replace(message, twist=Twist(linear=Vector3(x=x + 1e-6, y=self.config.step)))

    monkeypatch.setattr(Walker, "_at", changed)


def rerun_all(path: Path, *names: str) -> Iterator[tuple[str, int, RerunResult]]:
    with McapRecording(path) as opened:
        for start in chosen_starts(starts_in(opened), names):
            with prepared_rerun(opened, start) as rerun:
                yield start.component, start.incarnation, rerun.run()


def test_unchanged_components_publish_the_same_bytes(recording: Path) -> None:
    results = {(name, start): result for name, start, result in rerun_all(recording)}
    assert set(results) == {("first", 1), ("second", 1), ("second", 2)}
    for result in results.values():
        assert result.equal, (result.first, result.incomplete)
        assert not result.notes
    assert results["first", 1].topics["/robot/pushes"].compared == 30
    assert results["second", 1].topics["/robot/corner2"].compared > 20


def test_servers_and_clients_of_actions_are_re_run(tmp_path: Path) -> None:
    plugins = {"counter": Counter, "starter": Starter}
    components = {
        name: ChildSpec(plugin=f"{plugin.__module__}:{plugin.__name__}")
        for name, plugin in plugins.items()
    }
    deployment = Deployment(cairn=1, external_topics=("word",), components=components)
    out = tmp_path / "recording.mcap"
    with DeploymentHarness(with_recorder(deployment, out)) as run:
        run.run_for(0.5)
        run.publish("word", String(data="3"))
        run.run_for(1.0)

    results = {name: result for name, _, result in rerun_all(out)}
    assert all(one.equal for one in results.values()), results
    assert results["counter"].topics["/robot/fibonacci/_action/feedback"].compared == 2
    assert results["starter"].topics["/robot/answer"].compared == 3


def test_run_with_events_of_services_is_exact(tmp_path: Path) -> None:
    adding = f"{Adder.__module__}:"
    page = {
        "cairn": 1,
        "external_topics": ["word"],
        "components": {
            "adder": {"plugin": f"{adding}Adder"},
            "asker": {"plugin": f"{adding}Asker"},
        },
    }
    file, out = tmp_path / "adding.yaml", tmp_path / "recording.mcap"
    file.write_text(yaml.safe_dump(page))
    with DeploymentHarness(with_recorder(load_deployment(file), out)) as run:
        run.run_for(0.5)
        for name in ("adder", "asker"):
            run.set_parameters(name, {"service_introspection": "contents"})
        for word in ("1 2", "-1 2"):
            run.publish("word", String(data=word))
            run.run_for(1.0)

    with McapRecording(out) as opened:
        events = [one for one in opened.messages() if one.channel.topic.endswith("/_service_event")]
    assert len(events) == 4 + 2, "the second call is refused"
    for name in ("adder", "asker"):
        assert_rerun_equal(out, name)


def test_first_difference_is_named_by_topic_time_and_field(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_walker(monkeypatch)
    with pytest.raises(AssertionError) as caught:
        assert_rerun_equal(recording, "first")
    words = ("first", "/robot/pushes", "twist.linear.x", "recorded", "at 1.5", "a timer")
    assert_words(str(caught.value), *words)


def test_message_that_is_not_published_and_one_more_are_differences(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Walker, "receive_push", lambda self, push: None)
    (first, *_) = [result for _, _, result in rerun_all(recording, "second")]
    assert first.topics["/robot/corner2"].missing > 20
    assert not first.equal


def test_recorded_failure_is_a_regression_test(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Walker, "_fail", lambda self: None)
    with pytest.raises(AssertionError) as caught:
        assert_rerun_equal(recording, "second")
    assert_words(str(caught.value), "second", "does not end", "broken at")


def test_saved_test_runs_elsewhere_and_is_small(recording: Path, tmp_path: Path) -> None:
    arguments = ["rerun", str(recording), "--component", "second", "--until", "1.2"]
    arguments += ["--save-test", str(tmp_path), "--json"]
    result = CliRunner().invoke(build(), arguments)
    assert result.exit_code == 0, result.output
    (excerpt,) = tmp_path.glob("*.mcap")
    (test,) = tmp_path.glob("test_*.py")
    assert "assert_rerun_equal" in test.read_text()
    compile(test.read_text(), test, "exec")
    assert excerpt.stat().st_size < recording.stat().st_size
    assert_rerun_equal(excerpt)
    times = [time_ns for _, time_ns, _ in rerun_messages(excerpt, "second")]
    assert max(times) < 1_200_000_000


def test_input_files_are_those_of_the_recording(recording: Path) -> None:
    names = recording.with_name("names.txt")
    names.write_text("changed since")
    try:
        with McapRecording(recording) as opened:
            assert any(one.name.endswith("/names.txt") for one in opened.attachments)
        assert_rerun_equal(recording, "first")
    finally:
        names.write_text("five!")


def test_missing_part_of_the_log_ends_the_rerun(recording: Path, tmp_path: Path) -> None:
    with McapRecording(recording) as opened:
        batches = [m for m in opened.messages() if m.channel.type == CALL_BATCH
                   and m.channel.topic.endswith("first/call_log")]  # fmt: skip
        lost = tmp_path / "lost.mcap"
        rewrite(opened, lost, wanted=lambda one: one.data != batches[1].data)
    ((_, _, result),) = rerun_all(lost, "first")
    assert result.first is None
    assert result.calls > 3
    assert_words(result.incomplete, "records", "not recorded")


def test_missing_input_ends_the_rerun(recording: Path, tmp_path: Path) -> None:
    lost = tmp_path / "lost.mcap"
    with McapRecording(recording) as opened:
        rewrite(
            opened, lost,
            wanted=lambda one: not (one.channel.topic == "/robot/pushes" and one.sequence == 5),
        )  # fmt: skip
    first, *_ = [result for _, _, result in rerun_all(lost, "second")]
    assert_words(first.incomplete, "/robot/pushes", "message 5", "not in the recording")
    (result,) = [result for _, _, result in rerun_all(lost, "first")]
    assert result.equal
    assert result.topics["/robot/pushes"].not_recorded == 1


def test_component_without_call_log_is_refused(recording: Path) -> None:
    with McapRecording(recording) as opened, pytest.raises(CairnError) as caught:
        chosen_starts(starts_in(opened), ["camera"], ["/robot/camera"])
    assert_words(str(caught.value), "camera", "no call log", "device", "second")


def test_output_is_as_the_documentation_shows_it(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = Path("docs/how-to/rerun.md").read_text()
    monkeypatch.chdir(recording.parent)
    command = "rerun recording.mcap --component first"
    equal = cairn(*command.split())
    assert (equal.code, equal.err) == (0, "")
    assert f"$ cairn {command}\n{equal.out}```" in page

    change_walker(monkeypatch)
    ((*_, result),) = rerun_all(recording, "first")
    monkeypatch.setattr(cli, "rerun_in_processes", lambda *_: [result])
    different = cairn(*command.split())
    assert different.code == 1
    assert f"```text\n{different.out}```" in page, different.out


@pytest.fixture(scope="module")
def fragile_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 3 s of a component that the environment can break."""
    out = tmp_path_factory.mktemp("fragile") / "recording.mcap"
    spec = ChildSpec(plugin=f"{Fragile.__module__}:Fragile")
    deployment = Deployment(cairn=1, components={"walker": spec})
    with DeploymentHarness(with_recorder(deployment, out), seed=3) as run:
        run.run_for(3.0)
    return out


@pytest.mark.parametrize(
    ("change", "words"),
    sampled([
        ("raise", ["walker: DIFFERENT", "at 1.5", "a timer", "the component ends",
                   "ValueError: it has become fragile"]),
        ("crash", ["walker: not re-run completely", "status -11", "in a timer, at 1.5",
                   "Segmentation fault", "walkers.py", "in tick"]),
    ]),
)  # fmt: skip
def test_component_that_breaks_while_it_is_re_run_is_reported_with_the_time(
    fragile_recording: Path, monkeypatch: pytest.MonkeyPatch, change: str, words: list[str]
) -> None:
    assert cairn("rerun", str(fragile_recording)).code == 0
    monkeypatch.setenv(CHANGE, change)

    answer = cairn("rerun", str(fragile_recording))

    assert answer.code == 1
    assert_words(answer.out, *words)


def test_component_that_hangs_while_it_is_re_run_is_ended_at_the_time_limit(
    fragile_recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CHANGE, "hang")

    for limit_s in ("5", "20", "60"):  # a busy computer may not reach the handler in 5 s
        answer = cairn("rerun", str(fragile_recording), "--time-limit", limit_s)
        if "in hang" in answer.out:
            break

    assert answer.code == 1
    words = ("in a timer, at 1.5", "--time-limit", "walkers.py", "in hang")
    assert_words(answer.out, "walker: not re-run completely", f"longer than {limit_s} s", *words)


@pytest.mark.processes
@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGKILL]))
def test_interrupted_rerun_leaves_no_process(fragile_recording: Path, number: int) -> None:
    command = [sys.executable, "-m", "cairn.cli.program", "rerun", str(fragile_recording)]
    with subprocess.Popen(command, env={**os.environ, CHANGE: "hang"}) as process:
        deadline = time.monotonic() + LIMIT_S
        while not (workers := psutil.Process(process.pid).children()):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        process.send_signal(number)

        process.wait(LIMIT_S)
        assert psutil.wait_procs(workers, LIMIT_S)[1] == []


def test_thread_of_a_component_does_not_outlive_its_re_run(
    fragile_recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess.Popen, "kill", lambda _: pytest.fail("it does not end"))

    answer = cairn("rerun", str(fragile_recording), "--until", "1.0", "--time-limit", "60")

    assert (answer.code, answer.err) == (0, "")


def test_damaged_call_log_is_rejected() -> None:
    batch = CallBatch(
        header=Header(),
        component="x",
        incarnation=1,
        started=Time(),
        first=0,
        count=2,
        records=np.frombuffer(b"\x04\x63", np.uint8),
    )
    (start,) = component_starts([batch])
    with pytest.raises(CairnError, match="x: its call log is damaged"):
        list(start.calls())


@pytest.mark.parametrize(
    "record",
    [(Kind.TRANSITION, "fly"), (Kind.REQUEST, "jump", "{"), (Kind.CLOCK, 1 << 62)],
    ids=["transition", "request", "clock"],
)
def test_senseless_records_end_the_rerun(record: tuple[Any, ...]) -> None:
    info = {
        "name": "w", "plugin": PLUGIN, "parameters": {}, "topics": {}, "incarnation": 1,
        "robot": "r", "seed": 1, "simulated_time": True, "lockstep": True,
    }  # fmt: skip
    encoder, data = RecordEncoder(), bytearray()
    records = [(Kind.START, json.dumps(info)), (Kind.TRANSITION, "configure"), record]
    for one in records:
        encoder.encode(one, data)
    batch = CallBatch(
        header=Header(), component="w", incarnation=1, started=Time(), first=0,
        count=len(records), records=np.frombuffer(bytes(data), np.uint8),
    )  # fmt: skip
    (start,) = component_starts([batch])
    result = Rerun(start, start.info(), NoMessages()).run()
    assert result.calls == 2
    assert "its call log is damaged" in result.incomplete


def start_info(**values: Any) -> StartInfo:
    """Return the start of a walker of a foreign recording."""
    known = {
        "name": "w", "plugin": PLUGIN, "parameters": {}, "topics": {}, "incarnation": 1,
        "robot": "r", "seed": 1, "simulated_time": True, "lockstep": True,
    }  # fmt: skip
    return StartInfo.model_validate({**known, **values})


@pytest.mark.parametrize("prefix", ["/", "//", "../../../.."])
def test_file_of_a_foreign_recording_stays_in_the_folder_of_the_rerun(
    tmp_path: Path, prefix: str
) -> None:
    outside = f"{prefix}{tmp_path.relative_to('/')}/outside/planted"
    content = b"of an attacker"
    file = {
        "path": outside, "size": len(content), "digest": content_digest(content),
        "content": b64encode(content).decode(),
    }  # fmt: skip
    with_files(start_info(files=[file]), tmp_path / "inside", lambda _: None)
    assert not (tmp_path / "outside").exists()
    (copy,) = (one for one in tmp_path.rglob("*") if one.is_file())
    assert copy.is_relative_to(tmp_path / "inside")
    assert copy.read_bytes() == content


def test_rerun_writes_to_no_path_that_a_foreign_recording_names(tmp_path: Path) -> None:
    thesis = tmp_path / "thesis.txt"
    thesis.write_text("years of work")
    parameters = {"state_file": str(thesis)}
    for forged in ({}, {"paths": parameters, "read_paths": ["state_file"]}):
        info, missing = with_files(
            start_info(parameters=parameters, **forged), tmp_path / "inside", lambda _: None
        )
        assert not missing
        assert Path(info.parameters["state_file"]).is_relative_to(tmp_path / "inside")


def test_files_of_a_foreign_recording_that_never_end_are_not_read() -> None:
    zero = {"path": "/dev/zero", "size": 0, "digest": "00"}
    _, missing = with_files(start_info(files=[zero]), Path("/nowhere"), lambda _: None)
    assert_words(missing[0], "/dev/zero", "not attached")


def test_rerun_imports_nothing_from_the_current_folder(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "json.py").write_text("import os; os._exit(77)")
    monkeypatch.chdir(tmp_path)
    result = cairn("rerun", str(recording), "--component", "first")
    assert (result.code, result.err) == (0, ""), result.out


@pytest.mark.accuracy
def test_names_of_a_foreign_recording_are_not_code_of_the_saved_test(
    recording: Path, tmp_path: Path
) -> None:
    foreign = tmp_path / 'run"""; planted = 1; """.mcap'
    foreign.write_bytes(recording.read_bytes())
    result = cairn(
        "rerun", str(foreign), "--component", "first", "--until", "0.5",
        "--save-test", str(tmp_path / "tests"),
    )  # fmt: skip
    assert result.code == 0, result.err
    (test,) = (tmp_path / "tests").glob("test_*.py")
    names = {
        node.id for node in ast.walk(ast.parse(test.read_text())) if isinstance(node, ast.Name)
    }
    assert "planted" not in names


class NoMessages:
    """A recording without messages."""

    def find(self, message: MessageId) -> Payload | None:
        raise AssertionError(message)


def test_difference_names_the_element_of_a_sequence() -> None:
    scan = LaserScan(range_max=9.0, ranges=np.array([1, 2, np.nan], np.float32))
    other = LaserScan(range_max=9.0, ranges=np.array([1, 2.5, np.nan], np.float32))
    assert first_difference(scan, other) == ("ranges[1]", "2.0", "2.5")
    assert first_difference(scan, scan) is None
    assert first_difference(Vector3(x=0.0), Vector3(x=-0.0)) == ("x", "0.0", "-0.0")
