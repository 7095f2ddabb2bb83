"""Fields of messages by path, and messages of plain values, as users write them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cairn import CairnError
from cairn.cli.topic_plot import _drawn, _FieldSeries
from cairn.cli.topics import _Refusals
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus
from cairn.schemas.geometry_msgs import PoseStamped, Twist
from cairn.schemas.nav_msgs import Path
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.terminal.fields import field_path, field_paths, message_of
from tests.wording import assert_words

SCAN = LaserScan(header=Header(), range_max=9.0, ranges=np.arange(8, dtype=np.float32))
PATH = Path(poses=(PoseStamped(), message_of(PoseStamped, {"pose": {"position": {"x": 3}}})))


@pytest.mark.parametrize(
    ("message", "path", "value"),
    [
        (SCAN, "range_max", 9.0),
        (SCAN, "ranges[2]", 2.0),
        (SCAN, "ranges.2", 2.0),
        (SCAN, "ranges[-1]", 7.0),
        (SCAN, "ranges[9]", None),
        (SCAN, "ranges[1:6:2]", [1.0, 3.0, 5.0]),
        (PATH, "poses[1].pose.position.x", 3.0),
        (PATH, "poses[:].pose.position.x", [0.0, 3.0]),
    ],
)
def test_path_leads_to_the_value(message: Any, path: str, value: object) -> None:
    found = field_path(type(message), path).value(message)

    assert (found.tolist() if isinstance(found, np.ndarray) else found) == value


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("rangs", ("no field rangs", "did you mean ranges?")),
        ("ranges.x", ("ranges of sensor_msgs/msg/LaserScan is a sequence",)),
        ("range_max[0]", ("range_max", "not a sequence")),
        ("range_max.x", ("float32", "no fields")),
        ("header.stamp.seconds", ("builtin_interfaces/msg/Time", "sec, nanosec")),
        ("ranges[x]", ("is not a field", "ranges[0]")),
        ("ranges[::0]", ("step",)),
    ],
)
def test_wrong_path_is_rejected_with_what_is_allowed(path: str, words: tuple[str, ...]) -> None:
    with pytest.raises(CairnError) as rejected:
        field_path(LaserScan, path)

    assert_words(str(rejected.value), *words)


def test_every_listed_path_is_valid() -> None:
    for path in field_paths(LaserScan):
        assert not path.is_sequence


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"linaer": {}}, ("linaer", "did you mean linear?")),
        ({"linear": {"x": "a"}}, ("linear.x = 'a'", "number")),
        ({"linear": 3}, ("linear = 3", "mapping")),
    ],
)
def test_message_of_wrong_values_is_rejected_with_the_field(
    values: object, words: tuple[str, ...]
) -> None:
    with pytest.raises(CairnError) as rejected:
        message_of(Twist, values)

    assert_words(str(rejected.value), *words)


def test_plot_fits_the_terminal() -> None:
    series = _FieldSeries(
        [field_path(LaserScan, "range_max"), field_path(LaserScan, "ranges[3]")], 10.0
    )
    for _ in range(5):
        series.add(SCAN)

    rows = _drawn(series, (60, 14), colored=False).rstrip("\n").split("\n")

    assert len(rows) == 14
    assert max(map(len, rows)) <= 60
    assert any("range_max" in row for row in rows)


def test_publication_that_an_exclusive_input_refuses_is_an_error() -> None:
    refused = iter([0, 0, 2])

    def statuses() -> dict[str, ComponentStatus]:
        ports = (
            PortStatus(port="cmd_vel", topic="/r/cmd_vel", direction=PortStatus.OUT),
            PortStatus(
                port="cmd_vel", topic="/r/cmd_vel", direction=PortStatus.IN, refused=next(refused)
            ),
        )
        return {"/r/base": ComponentStatus(header=Header(), component="base", ports=ports)}

    client: Any = SimpleNamespace(connection=SimpleNamespace(statuses=statuses))
    refusals = _Refusals(client)

    with pytest.raises(CairnError, match="/r/cmd_vel: refused"):
        refusals.check("/r/cmd_vel")
    refusals.check("/r/other")  # no component publishes it: it has no other writer
