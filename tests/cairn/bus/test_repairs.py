"""Messages of other programs: what is redundant is repaired, and only what misleads is rejected."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cairn.bus.codec import Codec
from cairn.schemas.geometry_msgs import (
    PoseWithCovariance,
    Transform,
    TransformStamped,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.message import InvalidMessage, repairs_of
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid, Odometry
from cairn.schemas.sensor_msgs import (
    BatteryState,
    Image,
    LaserEcho,
    LaserScan,
    MultiEchoLaserScan,
)
from cairn.schemas.tf2_msgs import TFMessage
from tests.wording import assert_words

NAN, INF = math.nan, math.inf
STEP = math.radians(0.5)
RANGES = np.linspace(1.0, 5.0, 719).astype(np.float32)
SCAN = LaserScan(
    angle_min=-math.pi, angle_max=-math.pi + 718 * STEP, angle_increment=STEP, time_increment=1e-4,
    scan_time=0.1, range_min=0.1, range_max=12.0, ranges=RANGES,
)  # fmt: skip
IMAGE = Image(height=4, width=5, encoding="bgra8", step=20, data=np.arange(80, dtype=np.uint8))
NOT_KNOWN = [0.0] * 36


def broken(message: Any, **fields: Any) -> Any:
    """Return a message with fields that its class does not allow."""
    made = replace(message)
    made.__dict__.update(fields)
    return made


def received(message: Any) -> Any:
    """Return what a subscriber gets of a message of another program."""
    codec = Codec()
    return codec.decode(type(message), codec.encode(message))


def covariance(**entries: float) -> Any:
    """Return the identity with other numbers at some places."""
    numbers = np.eye(6).ravel()
    for place, number in entries.items():
        numbers[int(place[1:])] = number
    return numbers


@pytest.mark.parametrize(
    ("sent", "repaired", "said"),
    [
        ({"angle_max": math.pi + 5 * STEP}, {}, "angle_max is not that of the last beam"),
        ({"angle_max": NAN}, {}, "angle_max is not that of the last beam"),
        ({"angle_increment": 0.0}, {}, "angle_increment is not set"),
        ({"angle_increment": NAN}, {}, "angle_increment is not set"),
        ({"angle_min": INF}, {}, "angle_min is not a finite number"),
        ({"intensities": np.zeros(5, "f4")}, {}, "intensities left out"),
        ({"intensities": np.zeros(1440, "f4")}, {}, "intensities left out"),
        ({"time_increment": NAN}, {"time_increment": 0.0}, "time_increment is not a finite"),
        ({"scan_time": -INF}, {"scan_time": 0.0}, "scan_time is not a finite"),
        ({"range_min": NAN}, {"range_min": 0.0}, "range_min is not a finite"),
        ({"range_min": -0.1}, {"range_min": 0.0}, "range_min is not a finite number of at least 0"),
        ({"range_min": 150.0}, {"range_min": 0.0}, "range_min is above range_max"),
        ({"range_max": 0.0}, {"range_max": 100.0}, "range_max is not set"),
        ({"range_max": INF}, {"range_max": 100.0}, "range_max is not set"),
        ({"range_max": NAN}, {"range_max": 100.0}, "range_max is not set"),
        ({"range_max": -1.0}, {"range_max": 100.0}, "range_max is not set"),
    ],
)
def test_beams_of_a_scan_are_those_of_its_ranges_and_first_angle(
    sent: dict[str, Any], repaired: dict[str, Any], said: str
) -> None:
    scan = received(broken(SCAN, **sent))

    assert_words(" ".join(repairs_of(scan)), said)
    for name in ("angle_min", "angle_max", "angle_increment", "time_increment", "range_max"):
        assert getattr(scan, name) == pytest.approx(repaired.get(name, getattr(SCAN, name)))
    assert scan.ranges.tolist() == RANGES.tolist()
    assert scan.intensities.size == 0


def test_beam_without_a_return_tells_nothing_if_the_reach_is_not_known() -> None:
    ranges = np.array([INF, 2.0, 150.0], np.float32)
    fields = {"angle_max": SCAN.angle_min + 2 * STEP, "ranges": ranges, "range_max": INF}

    scan = received(broken(SCAN, **fields))

    assert np.isnan(scan.ranges[0])
    assert scan.ranges[1:].tolist() == [2.0, 150.0]
    assert scan.range_max > 150.0


def test_single_beam_needs_no_increment() -> None:
    one = {"angle_min": -0.1, "angle_max": 0.1, "ranges": RANGES[:1]}
    for step in (0.0, NAN):
        scan = received(broken(SCAN, **one, angle_increment=step))
        assert scan.angle_min == scan.angle_max == np.float32(-0.1)


@pytest.mark.parametrize(
    "angles",
    [
        {"angle_min": -180.0, "angle_max": 179.0, "angle_increment": 0.5},
        {"angle_min": -math.pi, "angle_max": math.pi, "angle_increment": 0.5},
        {"angle_min": -180.0, "angle_max": 180.0, "angle_increment": 0.0},
    ],
    ids=["degrees", "increment in degrees", "degrees without increment"],
)
def test_scan_with_angles_in_degrees_is_rejected(angles: dict[str, float]) -> None:
    with pytest.raises(InvalidMessage, match=r"LaserScan: angle_increment = 0.5.* not in deg"):
        received(broken(SCAN, **angles))


def test_scan_with_several_echoes_is_used_as_one_with_one() -> None:
    echoes = tuple(LaserEcho(echoes=np.ones(k, np.float32)) for k in (1, 0, 2))
    scan = MultiEchoLaserScan(angle_increment=STEP, range_max=9.0, ranges=echoes)

    got = received(broken(scan, intensities=echoes[:2], time_increment=NAN, angle_max=3.0))

    assert [echo.echoes.size for echo in got.ranges] == [1, 0, 2]
    assert (got.intensities, got.time_increment) == ((), 0.0)
    assert got.angle_max == pytest.approx(2 * STEP)
    assert len(repairs_of(got)) == 3


@pytest.mark.parametrize(
    ("fields", "step", "said"),
    [
        ({"step": 0}, 20, "step is less than a row"),
        ({"step": 5}, 20, "step is less than a row"),
        ({"data": np.arange(93, dtype=np.uint8)}, 20, "bytes behind the last row left out"),
        (
            {"step": 24, "data": np.tile(np.arange(24, dtype=np.uint8), 4)[:92]},
            24,
            "padding of the last row added",
        ),
    ],
)
def test_rows_of_an_image_follow_from_its_size_and_encoding(
    fields: dict[str, Any], step: int, said: str
) -> None:
    image = received(broken(IMAGE, **fields))

    assert (image.step, image.data.size) == (step, 4 * step)
    sent = fields.get("data", IMAGE.data)
    assert image.data[: 3 * step + 20].tolist() == sent[: 3 * step + 20].tolist()
    assert_words(" ".join(repairs_of(image)), said)


def test_image_that_lacks_pixels_is_rejected() -> None:
    with pytest.raises(InvalidMessage, match="must have height \\* step = 80 bytes"):
        received(broken(IMAGE, data=IMAGE.data[:79]))


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (covariance(_14=NAN, _21=INF), covariance(_14=0.0, _21=0.0).tolist()),
        (covariance(_35=NAN), NOT_KNOWN),
        (np.full(36, NAN), NOT_KNOWN),
    ],
    ids=["out of the plane", "of the heading", "all"],
)
def test_numbers_of_a_covariance_that_are_not_known_become_0(
    numbers: Any, expected: list[float]
) -> None:
    odom = Odometry(
        pose=broken(PoseWithCovariance(), covariance=numbers),
        twist=broken(TwistWithCovariance(), covariance=numbers),
    )

    got = received(odom)

    assert got.pose.covariance.tolist() == got.twist.covariance.tolist() == expected
    assert [text.split(".")[0] for text in repairs_of(got)] == ["pose", "twist"]


def test_cells_outside_the_format_are_unknown_or_occupied() -> None:
    info = MapMetaData(resolution=0.1, width=4, height=1)
    grid = OccupancyGrid(info=info, data=np.zeros(4, np.int8))

    got = received(broken(grid, data=np.array([-128, -1, 100, 127], np.int8)))

    assert got.data.tolist() == [-1, -1, 100, 100]


def test_transforms_beside_an_invalid_one_are_used() -> None:
    lost = Transform(translation=broken(Vector3(), z=NAN))
    good, bad = TransformStamped(child_frame_id="laser"), TransformStamped(child_frame_id="arm")
    both = (broken(bad, transform=lost), good)

    got = received(broken(TFMessage(), transforms=both))

    assert got.transforms == (good,)
    assert repairs_of(got) == ("invalid transforms left out",)
    with pytest.raises(InvalidMessage, match=r"transforms\[0\].transform.translation.z = nan"):
        received(broken(TFMessage(), transforms=both[:1]))


def test_what_is_valid_is_not_repaired() -> None:
    unknown = BatteryState()  # NaN is the standard's "not measured"
    for message in (SCAN, IMAGE, Odometry(), unknown):
        assert received(message) == message
        assert repairs_of(received(message)) == ()
