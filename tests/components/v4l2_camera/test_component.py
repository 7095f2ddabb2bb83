"""The driver publishes images and pairs, recovers from faults of cameras, and reports health."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from cairn import CairnError, to_ns
from cairn.driver.device_clock import ahead_of_monotonic
from cairn.driver.diagnostics import ERROR, OK
from tests.components.v4l2_camera.driver import Driver
from tests.components.v4l2_camera.fake_cameras import ONE, TWO, FakeCamera, FakeCameras, level
from tests.wording import words_in_order


def test_single_camera_uses_the_left_ports_only(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        taken = time.monotonic_ns() - 10_000_000
        left.send(7, captured=taken)
        image = driver.await_one("left_image")
        [info] = driver.take("left_info")
        others = driver.take("right_image") + driver.take("right_info")

    assert (image.width, image.height, image.encoding, level(image)) == (64, 48, "mono8", 7)
    assert (info.width, info.height) == (64, 48)
    assert info.header == image.header
    assert image.header.frame_id == "left_camera_optical_frame"
    assert others == []
    assert to_ns(image.header.stamp) == pytest.approx(
        taken + ahead_of_monotonic(time.time_ns), abs=1e6
    )


def test_paired_images_have_the_stamp_of_the_left_one(left: FakeCamera, right: FakeCamera) -> None:
    with Driver(**TWO) as driver:
        stream_pairs(driver, left, right)
        now = time.monotonic_ns()
        left.send(1, captured=now - 9_000_000)
        right.send(2, captured=now - 4_000_000)
        image = driver.await_one("left_image", lambda image: level(image) == 1)
        other = driver.await_one("right_image", lambda image: level(image) == 2)
        infos = [driver.take(port)[-1] for port in ("left_info", "right_info")]

    assert {to_ns(one.header.stamp) for one in (image, other, *infos)} == {
        to_ns(image.header.stamp)
    }
    assert other.header.frame_id == infos[1].header.frame_id == "right_camera_optical_frame"


def test_images_more_than_half_a_period_apart_are_not_published(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:
        stream_pairs(driver, left, right)
        now = time.monotonic_ns()
        left.send(1, captured=now - 100_000_000)
        right.send(2, captured=now - 75_000_000)
        left.send(3, captured=now - 60_000_000)
        image = driver.await_one("left_image")

    assert level(image) == 3


def test_side_by_side_images_are_split(left: FakeCamera) -> None:
    with Driver(**ONE, side_by_side=True) as driver:
        left.send(5)
        images = [driver.await_one(port) for port in ("left_image", "right_image")]

    assert [(image.width, image.height) for image in images] == [(32, 48), (32, 48)]
    assert images[0].header.stamp == images[1].header.stamp


def test_incomplete_images_are_dropped_and_counted(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        levels = [level(driver.await_one("left_image"))]
        left.send(2, short=1)
        left.send(3, is_damaged=True)
        left.lose(5)
        left.send(4, captured=None)
        levels.append(level(driver.await_one("left_image")))
        values = driver.await_values(lambda values: values["images"] == "2")

    assert levels == [1, 4]
    counted = {name: values[name] for name in ("short", "marked", "lost", "unstamped")}
    assert counted == {"short": "1", "marked": "1", "lost": "5", "unstamped": "1"}


def test_stamps_are_not_in_the_future(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1, captured=time.monotonic_ns() + 30_000_000)
        image = driver.await_one("left_image")
        now = time.time_ns()

    assert to_ns(image.header.stamp) <= now


def test_stamp_delay_can_be_changed_while_it_runs(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        driver.set(stamp_delay_s=0.5)
        taken = time.monotonic_ns()
        left.send(1, captured=taken)
        image = driver.await_one("left_image")

    delayed = taken + ahead_of_monotonic(time.time_ns) - 500_000_000
    assert to_ns(image.header.stamp) == pytest.approx(delayed, abs=1e6)


def test_failed_stream_is_restarted_without_reopening_the_device(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        driver.await_one("left_image")
        left.fail()
        left.send(2)
        assert level(driver.await_one("left_image")) == 2
        values = driver.values()

    assert (values["restarts"], values["reopened"]) == ("1", "0")
    assert left.streams == ["start", "stop", "start", "stop", "close"]


def test_stream_that_fails_repeatedly_reopens_the_device(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        for _ in range(4):
            left.fail()
        left.send(2)
        driver.await_one("left_image")
        values = driver.values()

    assert (values["restarts"], values["reopened"]) == ("3", "1")


def test_silent_stream_is_restarted(left: FakeCamera) -> None:
    with Driver(**ONE, silence_s=0.2) as driver:
        left.send(1)
        driver.await_one("left_image")
        driver.await_values(lambda values: int(values["restarts"]) >= 1)
        driver.await_values(lambda values: values["level"] == str(ERROR))
        left.send(2)
        driver.await_one("left_image")


def test_stream_of_damaged_images_is_restarted(left: FakeCamera) -> None:
    left.damages_all = True
    with Driver(**ONE, silence_s=0.2) as driver:
        driver.await_values(lambda values: int(values["restarts"]) >= 1)
        left.damages_all = False
        left.send(2)
        driver.await_one("left_image")


def test_camera_that_returns_gets_the_current_controls(left: FakeCamera) -> None:
    with Driver(**ONE, controls={"gain": 20, "exposure_time_absolute": 7}) as driver:
        left.send(1)
        driver.await_one("left_image")
        left.unplug()
        values = driver.await_values(lambda values: "no such camera" in values["message"])
        assert values["level"] == str(ERROR)
        assert left.opened == 0
        driver.set(controls__gain=30)

        left.plug_in()
        left.send(2)

        assert level(driver.await_one("left_image")) == 2
        assert left.values == {"gain": 30, "exposure_time_absolute": 7}
        assert driver.await_values(lambda values: values["level"] != str(ERROR))["reopened"] == "1"


def test_camera_of_another_size_does_not_replace_an_unplugged_one(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        left.unplug()
        driver.await_values(lambda values: "no such camera" in values["message"])
        left.size = (32, 24)
        left.plug_in()
        values = driver.await_values(lambda values: "32 x 24" in values["message"])

    assert "is it another camera?" in values["message"]


def test_left_images_are_published_while_the_right_camera_is_away(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:
        stream_pairs(driver, left, right)
        right.unplug()
        driver.await_values(lambda values: "no such camera" in values["message"], index=1)
        # So old that it cannot be paired with those that follow.
        left.send(3, captured=time.monotonic_ns() - 2_000_000_000)
        alone = driver.await_one("left_image", lambda image: level(image) == 3)
        assert alone.header.stamp not in {one.header.stamp for one in driver.take("right_image")}
        right.plug_in()
        stream_pairs(driver, left, right)


def test_left_image_published_alone_is_not_published_again_in_a_pair(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:  # the right camera does not stream before its first image
        now = time.monotonic_ns()
        left.send(1, captured=now - 200_000_000)
        levels = [level(driver.await_one("left_image"))]
        left.send(2, captured=now - 150_000_000)
        levels.append(level(driver.await_one("left_image")))
        right.send(0, captured=now - 200_000_000)
        driver.await_values(lambda values: values["pairs"] == "1", index=2)
        left.send(3, captured=now - 50_000_000)
        right.send(4, captured=now - 50_000_000)
        while levels[-1] != 3:
            levels.append(level(driver.await_one("left_image")))

    assert levels == [1, 2, 3]


def test_one_camera_with_two_names_is_rejected(cameras: FakeCameras, tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "video0")
    names = [str(tmp_path / name) for name in ("video0", "by-id")]
    for name in names:
        cameras.add(name)

    with pytest.raises(CairnError, match=words_in_order("device", "right_device", "video0")):
        Driver(**{**ONE, "device": names[0], "right_device": names[1]})


def test_deactivated_camera_stays_open_without_streaming(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        driver.await_one("left_image")
        driver.request("deactivate")
        assert left.streams == ["start", "stop", "close"]
        assert left.opened == 1
        driver.request("activate")
        left.send(2)
        assert level(driver.await_one("left_image")) == 2

    assert left.opened == 0


def test_bug_in_the_driver_fails_it_and_closes_the_camera(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.fail(ZeroDivisionError("a mistake"))
        driver.join()

    assert "a mistake" in str(driver.end)
    assert left.opened == 0


def test_hanging_camera_does_not_keep_the_other_one_open(
    left: FakeCamera, right: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.driver.device_thread._STOP_LIMIT_S", 0.5)
    with Driver(**TWO) as driver:
        stream_pairs(driver, left, right)
        over = left.hang()
        with pytest.raises(CairnError, match=words_in_order("camera left", "did not stop")):
            driver.request("deactivate")
        right.await_closed_stream()
        assert (left.opened, right.opened) == (0, 0)
        over.set()


def test_cameras_with_pairs_are_healthy(left: FakeCamera, right: FakeCamera) -> None:
    with Driver(**TWO) as driver:
        stream_pairs(driver, left, right)
        driver.publish_health()  # what was until now
        now = time.monotonic_ns()
        left.send(1, captured=now - 2_000_000)
        right.send(2, captured=now)
        driver.await_one("right_image", lambda image: level(image) == 2)
        driver.publish_health()
        statuses = [message.status[2] for message in driver.take("diagnostics")]

    assert (OK, "right +2.00 ms after left") in {
        (status.level, status.message) for status in statuses
    }


def stream_pairs(driver: Driver, left: FakeCamera, right: FakeCamera) -> None:
    """Send one pair of images, and wait until it is published: then both cameras stream.

    The right one comes first: a left image that comes first is published alone. Both are too old
    to be paired with images that follow.
    """
    taken = time.monotonic_ns() - 500_000_000
    count = int(driver.values(index=1)["images"])
    right.send(0, captured=taken)
    driver.await_values(lambda values: int(values["images"]) > count, index=1)
    left.send(0, captured=taken)
    driver.await_one("right_image")
    driver.take("left_image")
