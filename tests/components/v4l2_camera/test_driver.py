"""The driver publishes pairs, gets over every fault of a camera, and tells how cameras are."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from cairn import CairnError, to_ns
from cairn.driver.diagnostics import ERROR, OK
from tests.components.v4l2_camera.driving import Driver
from tests.components.v4l2_camera.fakes import ONE, TWO, FakeCamera, FakeCameras, level


def test_a_single_camera_has_the_left_ports_alone(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        taken = time.monotonic_ns() - 10_000_000
        left.send(7, taken=taken)
        image = driver.await_one("left_image")
        [info] = driver.taken("left_info")
        others = driver.taken("right_image") + driver.taken("right_info")

    assert (image.width, image.height, image.encoding, level(image)) == (64, 48, "mono8", 7)
    assert (info.width, info.height) == (64, 48)
    assert info.header == image.header
    assert image.header.frame_id == "left_camera_optical_frame"
    assert others == []
    system = taken + time.time_ns() - time.monotonic_ns()
    assert to_ns(image.header.stamp) == pytest.approx(system, abs=1e6)


def test_pictures_of_two_cameras_are_paired_and_have_the_left_ones_stamp(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:
        begin(driver, left, right)
        now = time.monotonic_ns()
        left.send(1, taken=now - 9_000_000)
        right.send(2, taken=now - 4_000_000)
        image = driver.await_one("left_image", lambda image: level(image) == 1)
        other = driver.await_one("right_image", lambda image: level(image) == 2)
        infos = [driver.taken(port)[-1] for port in ("left_info", "right_info")]

    assert {to_ns(one.header.stamp) for one in (image, other, *infos)} == {
        to_ns(image.header.stamp)
    }
    assert other.header.frame_id == infos[1].header.frame_id == "right_camera_optical_frame"


def test_pictures_more_than_half_a_period_apart_are_not_published(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:
        begin(driver, left, right)
        now = time.monotonic_ns()
        left.send(1, taken=now - 100_000_000)
        right.send(2, taken=now - 75_000_000)
        left.send(3, taken=now - 60_000_000)
        image = driver.await_one("left_image")

    assert level(image) == 3


def test_side_by_side_pictures_are_parted(left: FakeCamera) -> None:
    with Driver(**ONE, side_by_side=True) as driver:
        left.send(5)
        images = [driver.await_one(port) for port in ("left_image", "right_image")]

    assert [(image.width, image.height) for image in images] == [(32, 48), (32, 48)]
    assert images[0].header.stamp == images[1].header.stamp


def test_what_is_no_whole_picture_is_left_out_and_counted(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        levels = [level(driver.await_one("left_image"))]
        left.send(2, short=1)
        left.send(3, is_damaged=True)
        left.lose(5)
        left.send(4, taken=None)
        levels.append(level(driver.await_one("left_image")))
        told = driver.await_values(lambda told: told["pictures"] == "2")

    assert levels == [1, 4]
    counted = {name: told[name] for name in ("short", "marked", "lost", "unstamped")}
    assert counted == {"short": "1", "marked": "1", "lost": "5", "unstamped": "1"}


def test_no_stamp_is_of_the_future(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1, taken=time.monotonic_ns() + 30_000_000)
        image = driver.await_one("left_image")
        now = time.time_ns()

    assert to_ns(image.header.stamp) <= now


def test_the_stamp_can_be_set_back_while_it_runs(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        driver.set(stamp_delay_s=0.5)
        taken = time.monotonic_ns()
        left.send(1, taken=taken)
        image = driver.await_one("left_image")

    system = taken + time.time_ns() - time.monotonic_ns()
    assert to_ns(image.header.stamp) == pytest.approx(system - 500_000_000, abs=1e6)


def test_a_stream_that_breaks_off_is_started_anew_without_opening_the_device(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        driver.await_one("left_image")
        left.fail()
        left.send(2)
        assert level(driver.await_one("left_image")) == 2
        told = driver.values()

    assert (told["restarts"], told["returns"]) == ("1", "0")
    assert left.streams == ["start", "stop", "start", "stop", "close"]


def test_a_stream_that_breaks_off_again_and_again_has_its_device_opened_anew(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        for _ in range(4):
            left.fail()
        left.send(2)
        driver.await_one("left_image")
        told = driver.values()

    assert (told["restarts"], told["returns"]) == ("3", "1")


def test_a_stream_that_falls_silent_is_started_anew(left: FakeCamera) -> None:
    with Driver(**ONE, silence_s=0.2) as driver:
        left.send(1)
        driver.await_one("left_image")
        driver.await_values(lambda told: int(told["restarts"]) >= 1)
        driver.await_values(lambda told: told["level"] == str(ERROR))
        left.send(2)
        driver.await_one("left_image")


def test_a_stream_of_nothing_but_damaged_pictures_is_started_anew(left: FakeCamera) -> None:
    left.spoils = True
    with Driver(**ONE, silence_s=0.2) as driver:
        driver.await_values(lambda told: int(told["restarts"]) >= 1)
        left.spoils = False
        left.send(2)
        driver.await_one("left_image")


def test_a_camera_that_comes_back_is_taken_up_with_the_controls_of_now(left: FakeCamera) -> None:
    with Driver(**ONE, controls={"gain": 20, "exposure_time_absolute": 7}) as driver:
        left.send(1)
        driver.await_one("left_image")
        left.unplug()
        told = driver.await_values(lambda told: "no such camera" in told["message"])
        assert told["level"] == str(ERROR)
        assert left.opened == 0
        driver.set(controls__gain=30)

        left.plug_in()
        left.send(2)

        assert level(driver.await_one("left_image")) == 2
        assert left.values == {"gain": 30, "exposure_time_absolute": 7}
        assert driver.await_values(lambda told: told["level"] != str(ERROR))["returns"] == "1"


def test_another_camera_of_another_size_is_not_taken_for_the_one_that_went(
    left: FakeCamera,
) -> None:
    with Driver(**ONE) as driver:
        left.unplug()
        driver.await_values(lambda told: "no such camera" in told["message"])
        left.size = (32, 24)
        left.plug_in()
        told = driver.await_values(lambda told: "32 x 24" in told["message"])

    assert "is it another camera?" in told["message"]


def test_while_the_right_camera_is_away_the_left_one_is_published_alone(
    left: FakeCamera, right: FakeCamera
) -> None:
    with Driver(**TWO) as driver:
        begin(driver, left, right)
        right.unplug()
        driver.await_values(lambda told: told["level"] == str(ERROR), index=1)
        left.send(3)
        alone = driver.await_one("left_image", lambda image: level(image) == 3)
        assert alone.header.stamp not in {one.header.stamp for one in driver.taken("right_image")}
        right.plug_in()
        begin(driver, left, right)


def test_one_camera_by_two_names_is_refused(cameras: FakeCameras, tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "video0")
    names = [str(tmp_path / name) for name in ("video0", "by-id")]
    for name in names:
        cameras.add(name)

    with pytest.raises(CairnError, match=r"device and right_device are both .*video0: name two"):
        Driver(**{**ONE, "device": names[0], "right_device": names[1]})


def test_after_deactivation_it_does_not_stream_but_stays_open(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.send(1)
        driver.await_one("left_image")
        driver.go("deactivate")
        assert left.streams == ["start", "stop", "close"]
        assert left.opened == 1
        driver.go("activate")
        left.send(2)
        assert level(driver.await_one("left_image")) == 2

    assert left.opened == 0


def test_a_mistake_in_the_driver_fails_it_and_lets_go_of_the_camera(left: FakeCamera) -> None:
    with Driver(**ONE) as driver:
        left.fail(ZeroDivisionError("a mistake"))
        driver.await_end()

    assert "a mistake" in driver.ends[0].reason
    assert left.opened == 0


def test_a_camera_that_hangs_does_not_keep_the_other_one(
    left: FakeCamera, right: FakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.driver.device_thread._STOP_LIMIT_S", 0.5)
    with Driver(**TWO) as driver:
        begin(driver, left, right)
        over = left.hang()
        with pytest.raises(CairnError, match="camera left: its thread does not end"):
            driver.go("deactivate")
        over.set()

    assert (left.opened, right.opened) == (0, 0)
    assert right.streams[-1] == "close"


def test_cameras_that_make_pairs_are_told_to_be_well(left: FakeCamera, right: FakeCamera) -> None:
    with Driver(**TWO) as driver:
        begin(driver, left, right)
        driver.tell()  # what was until now
        now = time.monotonic_ns()
        left.send(1, taken=now - 2_000_000)
        right.send(2, taken=now)
        driver.await_one("right_image", lambda image: level(image) == 2)
        driver.tell()
        told = [message.status[2] for message in driver.taken("diagnostics")]

    assert (OK, "right +2.00 ms after left") in {(one.level, one.message) for one in told}


def begin(driver: Driver, left: FakeCamera, right: FakeCamera) -> None:
    """Have both cameras stream: a right picture is published of a pair alone.

    These pictures are old enough not to be taken for the others of those that follow.
    """
    while not driver.taken("right_image"):
        taken = time.monotonic_ns() - 500_000_000
        left.send(0, taken=taken)
        right.send(0, taken=taken)
        driver.await_one("left_image")
    driver.taken("left_image")
