"""`cairn tf`: the tree of frames and transforms of a robot on the bus."""

import json
import math
import re
import signal
import subprocess
from collections.abc import Iterator

import pytest

from cairn import LATCHED
from cairn.cli.transforms import _drawn
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.tf2_msgs import TFMessage
from cairn.terminal import completion
from cairn.testing.launching import CAIRN
from cairn.tf import Buffer, Transform
from tests.cairn.bus.network import Network
from tests.cairn.client.published_frames import await_announced, frames_on_bus, stamped
from tests.commands import Answer, await_answer, cairn
from tests.patience import LIMIT_S
from tests.wording import assert_words, words_in_order

pytestmark = pytest.mark.processes

TREE = """\
frame              transform     Hz  age s  publisher
map
└── odom           changing    N.NN   N.NN  localizer
    └── base_link  changing   NN.NN   N.NN  base
        └── laser  static                   robot_frames
"""
WAIT = ("--wait", str(LIMIT_S))
FRAMES = ["map", "odom", "base_link", "laser"]


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with frames_on_bus() as (network, _):
        yield network.endpoint


def test_tree_shows_publisher_rate_and_age(endpoint: str) -> None:
    answer = await_answer(
        lambda: cairn("tf", "tree", "--seconds", "0.6", *WAIT, connect=endpoint),
        lambda answer: squeezed(answer.out) == squeezed(TREE),
    )

    assert (answer.code, answer.err) == (0, "")


def squeezed(table: str) -> str:
    """A table with any numbers, and with columns of any width."""
    return re.sub(r"  +", "  ", re.sub(r"[\dN]+\.[\dN]+", "N.N", table))


def test_tree_as_json_has_full_names(endpoint: str) -> None:
    def are_all_seen(answer: Answer) -> bool:
        found = {row["frame"]: row["transforms"] for row in answer.json}
        return set(found) == set(FRAMES) and found["base_link"] >= 2

    rows = await_answer(
        lambda: cairn("tf", "tree", "--json", "--seconds", "0.6", *WAIT, connect=endpoint),
        are_all_seen,
    ).json

    assert [(row["frame"], row["parent"], row["depth"], row["static"]) for row in rows] == [
        ("map", None, 0, None),
        ("odom", "map", 1, False),
        ("base_link", "odom", 2, False),
        ("laser", "base_link", 3, True),
    ]
    base = rows[2]
    assert base["publisher"] == "/robot/base"
    assert 0 < base["rate_hz"] <= 60
    assert 0 <= base["age_s"] < LIMIT_S
    assert (rows[3]["rate_hz"], rows[3]["age_s"]) == (None, None)


def test_echo_prints_the_newest_transform_once(endpoint: str) -> None:
    answer = cairn("tf", "echo", "map", "laser", "--once", *WAIT, connect=endpoint)

    assert (answer.code, answer.err) == (0, "")
    assert_words(
        answer.out, "target: map", "source: laser", "stamp: {sec:", "age_s:",
        "translation: {x: 3.720506, y: 3.486219, z: 0.2}",
        "rotation: {x: 0.0, y: 0.0, z: 0.247404, w: 0.968912}",
        "roll_pitch_yaw: {roll: 0.0, pitch: 0.0, yaw: 0.5}", "---\n",
    )  # fmt: skip


def test_echo_prints_until_ctrl_c(endpoint: str) -> None:
    words = [CAIRN, "tf", "echo", "base_link", "map", "--rate", "100", "--json", *WAIT]
    with subprocess.Popen(
        [*words, "--connect", endpoint], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        lines = [json.loads(process.stdout.readline()) for _ in range(3)]
        process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT_S) == 130

    assert [one["roll_pitch_yaw"]["yaw"] for one in lines] == pytest.approx([-0.5] * 3)
    length = math.hypot(1 + 3 * math.cos(0.5), 2 + 3 * math.sin(0.5))
    for one in lines:
        assert math.hypot(*one["translation"].values()) == pytest.approx(length)
    times = [one["stamp"]["sec"] + one["stamp"]["nanosec"] / 1e9 for one in lines]
    assert times == sorted(times)


def test_echo_of_a_static_transform_has_no_stamp(endpoint: str) -> None:
    arguments = ("tf", "echo", "base_link", "laser", "--once", "--json", *WAIT)
    value = cairn(*arguments, connect=endpoint).json

    assert (value["stamp"], value["age_s"]) == (None, None)
    assert value["translation"] == {"x": 0.1, "y": 0.0, "z": 0.2}


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (("map", "lasr"), ("no frame lasr", "did you mean laser")),
        (("/map", "laser"), ("'/map'", "slash")),
    ],
)
def test_wrong_frame_is_an_error_with_a_remedy(
    endpoint: str, frames: tuple[str, str], words: tuple[str, ...]
) -> None:
    answer = await_answer(  # until the frame with a similar name has arrived
        lambda: cairn("tf", "echo", *frames, "--once", "--wait", "0.5", connect=endpoint),
        lambda answer: bool(re.search(words_in_order("cairn: ", *words), answer.err)),
    )

    assert answer.code == 1


def test_missing_frame_is_reported_with_those_that_exist(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(completion, "_LIMIT_S", LIMIT_S)  # on a busy computer, too
    answer = await_answer(
        lambda: cairn("tf", "echo", "map", connect=endpoint),
        lambda answer: all(frame in answer.err for frame in FRAMES),
    )

    assert answer.code == 2
    assert_words(answer.err, "Missing argument 'SOURCE'", "There are: ", "base_link", "odom")


def test_several_trees_and_invalid_transforms_are_noted() -> None:
    with frames_on_bus() as (network, frames):
        dock = stamped(0, "dock", "charger", Transform())
        wrong = stamped(0, "dock", "dock", Transform())
        frames.publisher("dock", static=True).publish(TFMessage(transforms=(dock, wrong)))

        answer = await_answer(
            lambda: cairn("tf", "tree", "--seconds", "0.6", *WAIT, connect=network.endpoint),
            lambda answer: all(frame in answer.out for frame in [*FRAMES, "charger"]),
        )

    assert answer.code == 0
    assert_words(answer.out, "dock\n└── charger", "map\n└── odom")
    assert_words(answer.err, "2 trees", "dock, map", "'dock' -> 'dock'", "its own parent")


def test_silent_robot_is_an_error_with_a_remedy() -> None:
    network = Network()
    try:
        node = network.bus().node("/rover/base", print)
        node.advertise("/rover/component_status", ComponentStatus, LATCHED)
        await_announced(network, "rover")
        for command in (("tree",), ("echo", "map", "base_link")):
            answer = cairn("tf", *command, "--wait", "0.1", connect=network.endpoint)
            assert answer.code == 1
            assert_words(answer.err, "no transform within 0.1 s", "/rover/tf_static", "start")
    finally:
        network.close()


def drawn(*edges: tuple[str, str]) -> str:
    buffer = Buffer()
    for parent, child in edges:
        buffer.set_transform(stamped(1, parent, child, Transform()))
    return "\n".join(line for _, line, _ in _drawn(buffer.frames()))


def test_tree_is_drawn_with_lines() -> None:
    edges = (("a", "b"), ("a", "c"), ("b", "d"), ("b", "e"), ("x", "y"))

    assert drawn(*edges) == "\n".join(
        ["a", "├── b", "│   ├── d", "│   └── e", "└── c", "x", "└── y"]
    )


def test_loop_of_frames_is_drawn_once() -> None:
    assert drawn(("a", "b"), ("b", "c"), ("c", "a")) == "a\n└── b\n    └── c"


def test_long_chain_of_frames_is_drawn_with_bounded_indentation() -> None:
    lines = drawn(*((f"f{n}", f"f{n + 1}") for n in range(3000))).splitlines()

    assert len(lines) == 3001
    assert max(map(len, lines)) < 130
