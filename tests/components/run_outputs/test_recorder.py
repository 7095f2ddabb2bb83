import itertools
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.processes.lockstep import LockstepRun
from cairn.processes.run_plan import with_recorder
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.robot import Robot
from cairn.testing.rerun import assert_rerun_equal

TICKER = ChildSpec(
    plugin="tests.components.run_outputs.ticker:Ticker", restart="transient", significant=True
)
DEPLOYMENT = Deployment(cairn=1, robot=Robot(name="turtle"), components={"ticker": TICKER})


def recorded_run(file: Path) -> None:
    run = LockstepRun(with_recorder(DEPLOYMENT, file), seed=3)
    assert run.run(lambda: None).normal


def test_lockstep_recording_has_everything_and_is_repeatable(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    recorded_run(tmp_path / "a" / "run.mcap")
    recorded_run(tmp_path / "b" / "run.mcap")

    with (tmp_path / "a" / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
        attached = {one.name: json.loads(one.data) for one in reader.iter_attachments()}
    numbers = [(time, one.data) for topic, time, one in messages if topic == "/turtle/number"]
    assert [int(text) for _, text in numbers] == list(range(1, 31))
    times = [time for time, _ in numbers]
    assert {after - before for before, after in itertools.pairwise(times)} == {100_000_000}
    assert ("/turtle/name_plate", 0, "ticker") in [
        (topic, time, one.data) for topic, time, one in messages if topic == "/turtle/name_plate"
    ]
    states = [one.state for topic, _, one in messages if topic == "/turtle/component_status"]
    assert states.count("finalized") == 1  # the ticker's last one
    assert attached["run.json"] == {
        "robot": "turtle", "domain": 0, "seed": 3, "lockstep": True, "clock": "system",
    }  # fmt: skip
    assert "ticker" in attached["deployment.json"]["components"]
    assert attached["parameters.json"]["recorder"]["compression"] == "lz4"
    contents = [contents_of(tmp_path / name / "run.mcap") for name in ("a", "b")]
    assert contents[0] == contents[1]


def contents_of(path: Path) -> Counter[tuple[object, ...]]:
    """Return the messages but those whose content names processes and files."""
    with path.open("rb") as file:
        return Counter(
            (channel.topic, channel.metadata["gid"], one.sequence, one.log_time, one.publish_time)
            for _, channel, one in make_reader(file).iter_messages()
        )


@pytest.mark.parametrize(
    ("parameters", "call_log", "expected"),
    [
        ({}, None, True),
        ({"exclude": ["camera/**"]}, None, True),
        ({"last_s": 30.0}, None, True),
        ({"topics": ["scan", "/**"]}, None, True),
        ({"topics": ["scan", "odom"]}, None, False),
        ({"topics": ["scan", "odom"]}, True, True),
        ({}, False, False),
    ],
)
def test_deployment_has_a_call_log_if_it_records_all_topics(
    tmp_path: Path, parameters: dict[str, Any], call_log: bool | None, *, expected: bool
) -> None:
    file = tmp_path / "run.mcap"
    recorder = ChildSpec(plugin="recorder", parameters={"file": str(file), **parameters})
    deployment = DEPLOYMENT.model_copy(
        update={"components": {"keeper": recorder, "ticker": TICKER}, "call_log": call_log}
    )
    published: set[str] = set()
    run = LockstepRun(deployment, seed=3)
    run.bus.taps.append(lambda publisher, _: published.add(publisher.topic))
    assert run.run(lambda: None).normal
    assert ("/turtle/ticker/call_log" in published) is expected


def test_recording_of_a_component_recorder_can_be_re_run(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    recorder = ChildSpec(plugin="recorder", parameters={"file": str(file)})
    components = {"keeper": recorder, "ticker": TICKER}
    run = LockstepRun(DEPLOYMENT.model_copy(update={"components": components}), seed=3)
    assert run.run(lambda: None).normal
    assert_rerun_equal(file, "ticker")


def test_second_recorder_of_a_deployment_is_refused(tmp_path: Path) -> None:
    twice = with_recorder(DEPLOYMENT, tmp_path / "run.mcap")
    with pytest.raises(CairnError, match="recorder"):
        with_recorder(twice, tmp_path / "run.mcap")
