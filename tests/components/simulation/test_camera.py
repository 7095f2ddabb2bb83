"""The simulated stereo camera on the bus: its messages, their times, and its faults."""

import hashlib
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cairn import SECOND, CairnError, ParameterRejected, to_ns
from cairn.bus.codec import Codec
from cairn.components.simulation.camera import SimulatedStereoCamera
from cairn.components.simulation.camera_optics import PinholeCamera
from cairn.components.simulation.rendering import CameraPose
from cairn.components.simulation.textures import drawn_picture
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose, compose
from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.sensor_msgs import Image
from cairn.tf import Transform
from cairn.vision.rectification import Rectifier
from cairn.vision.stereo import StereoRig
from tests.components.simulation.camera_images import cut_out, panel_corners
from tests.components.simulation.simulation_harness import Simulation
from tests.sweeps import sampled
from tests.wording import assert_words

pytestmark = pytest.mark.images


POSTER = {"id": 7, "x": 6.0, "y": 2.0, "theta": math.pi, "width": 0.5, "height": 0.4}
SHARP: dict[str, Any] = {
    "light": {"drift": 0, "spread": 0},
    "sensor": {"vignetting": 0, "defocus": 0, "read_noise": 0, "shot_noise": 0},
}
PORTS = ("left_image", "right_image", "left_info", "right_info")


class CameraSimulation(Simulation):
    """A simulation with a stereo camera."""

    def __init__(self, folder: Path, parameters: dict[str, Any], **world: Any) -> None:
        super().__init__(folder, **{"objects": [POSTER], **world})
        self.camera = self.add(SimulatedStereoCamera, **parameters)

    def stand(self, seconds: float = 1.0) -> None:
        self.drive(seconds, 0.0, 0.0)

    def images(self, port: str = "left_image") -> list[NDArray[np.uint8]]:
        messages = self.camera.take(port)
        return [message.data.reshape(message.height, -1) for message in messages]

    def camera_transforms(self) -> list[TransformStamped]:
        return [one for message in self.camera.take("tf_static") for one in message.transforms]


@pytest.fixture
def simulate_camera(tmp_path: Path) -> Callable[..., CameraSimulation]:
    def make(world: dict[str, Any] | None = None, **parameters: Any) -> CameraSimulation:
        return CameraSimulation(tmp_path, parameters, **(world or {}))

    return make


SimulateCamera = Callable[..., CameraSimulation]


def test_images_and_camera_infos_of_a_pair_have_the_same_stamp(
    simulate_camera: SimulateCamera,
) -> None:
    simulation = simulate_camera(rate=10.0)
    simulation.stand(1.05)
    sent = {port: simulation.camera.take(port) for port in PORTS}

    stamps = {
        port: [to_ns(message.header.stamp) for message in messages]
        for port, messages in sent.items()
    }
    assert stamps["left_image"] == stamps["right_image"] == stamps["left_info"]
    assert stamps["left_info"] == stamps["right_info"]
    assert len(stamps["left_image"]) >= 9
    assert set(np.diff(stamps["left_image"])) == {SECOND // 10}
    assert stamps["left_image"][-1] == 2 * SECOND - round(0.03 * SECOND)
    for side in ("left", "right"):
        image, info = sent[f"{side}_image"][0], sent[f"{side}_info"][0]
        assert (image.encoding, image.width, image.height, image.step) == ("mono8", 640, 480, 640)
        assert image.header.frame_id == info.header.frame_id == f"{side}_camera_optical_frame"
    rig = StereoRig.of(sent["left_info"][0], sent["right_info"][0])
    assert rig.baseline == pytest.approx(0.09)
    assert rig.fx == pytest.approx(320 / math.tan(math.radians(30)))
    assert (rig.cx, rig.cy) == (319.5, 239.5)


def test_image_shows_the_world_from_the_camera_pose_at_its_stamp(
    simulate_camera: SimulateCamera,
) -> None:
    mount = {"x": 0.1, "y": 0.05, "theta": 0.1}
    simulation = simulate_camera(mount=mount, z=1.2, **SHARP)
    simulation.drive(2.0, 0.5, 0.2)
    simulation.drive(2.0, 0.2, -0.4)
    states = simulation.take("world_state")
    stamps = [to_ns(state.header.stamp) for state in states]
    track = np.array([planar_pose(state.robot) for state in states])
    lens = PinholeCamera.of(640, 480, math.radians(60))
    picture = drawn_picture(7, (0.5, 0.4))

    def shown(image: Image, late_s: float) -> float:
        at = to_ns(image.header.stamp) + late_s * SECOND
        x, y, theta = (float(np.interp(at, stamps, column)) for column in track.T)
        pose: Pose = compose((x, y, theta), (mount["x"], mount["y"], mount["theta"]))
        corners = panel_corners((6.0, 2.0, math.pi), (0.5, 0.4), 1.0, CameraPose(pose, 1.2), lens)
        if np.any(corners < 0) or np.any(corners > (639, 479)):
            return math.nan
        flat = cut_out(image.data.reshape(480, 640), corners, 100, 80)
        small = picture.reshape(80, 4, 100, 4).mean(axis=(1, 3))
        return float(np.corrcoef(flat.ravel(), small.ravel())[0, 1])

    images = simulation.camera.take("left_image")
    right = [shown(image, 0.0) for image in images]
    late = [shown(image, 0.03) for image in images]
    assert np.isfinite(right).sum() > 10
    assert np.nanmin(right) > 0.9
    assert np.nanmean(right) > np.nanmean(late) + 0.01


def test_optical_frames_look_along_the_mounts_x_axis(simulate_camera: SimulateCamera) -> None:
    transforms = {one.child_frame_id: one for one in simulate_camera().camera_transforms()}
    assert {one.header.frame_id for one in transforms.values()} == {"camera"}
    left, right = (
        Transform.from_message(transforms[f"{side}_camera_optical_frame"].transform)
        for side in ("left", "right")
    )

    assert left.translation == (0.0, 0.0, 0.0)
    assert right.translation == pytest.approx((0.0, -0.09, 0.0))
    for transform in (left, right):  # x to the right, y down, z ahead
        turned = transform.rotation_matrix()
        assert turned == pytest.approx(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), abs=1e-9)


def test_light_and_sensor_parameters_change_at_run_time(simulate_camera: SimulateCamera) -> None:
    simulation = simulate_camera()
    simulation.stand()
    usual = simulation.images()[-1]
    simulation.camera.set_parameters({"light.level": 0.0})
    simulation.stand()
    dark = simulation.images()[-1]
    simulation.camera.set_parameters({"light.level": 1.0, "sensor.gain": 20.0})
    simulation.stand()
    bright = simulation.images()[-1]

    assert 60 < usual.mean() < 200
    assert dark.mean() < 2.0
    assert dark.max() < 15
    assert (bright == 255).mean() > 0.9


@pytest.mark.accuracy
def test_light_drifts_over_time(simulate_camera: SimulateCamera) -> None:
    still = simulate_camera(light={"drift": 0})
    still.stand(8.0)
    simulation = simulate_camera(light={"drift": 0.3, "drift_s": 1.0})
    simulation.stand(8.0)

    assert np.ptp([image.mean() for image in still.images()]) < 0.5
    assert np.ptp([image.mean() for image in simulation.images()]) > 30


@pytest.mark.parametrize("name", ["width", "baseline", "rate", "z", "mount.x", "distortion"])
def test_other_parameters_of_the_camera_cannot_change_at_run_time(
    simulate_camera: SimulateCamera, name: str
) -> None:
    simulation = simulate_camera()
    value = [0.1] if name == "distortion" else 64 if name == "width" else 0.5

    with pytest.raises(ParameterRejected, match=f"{name.split('.')[0]} cannot change while"):
        simulation.camera.set_parameters({name: value})


@pytest.mark.parametrize(
    ("fault", "ports"),
    [
        ("none", {"left_image", "left_info", "right_image", "right_info"}),
        ("left_missing", {"right_image", "right_info"}),
        ("right_missing", {"left_image", "left_info"}),
    ],
)
def test_missing_camera_publishes_nothing(
    simulate_camera: SimulateCamera, fault: str, ports: set[str]
) -> None:
    simulation = simulate_camera()
    simulation.camera.set_parameters({"fault": fault})
    simulation.stand()

    assert {port for port in PORTS if simulation.camera.take(port)} == ports


def test_frozen_camera_repeats_its_image_with_new_stamps(simulate_camera: SimulateCamera) -> None:
    simulation = simulate_camera(rate=10.0)
    simulation.stand()
    last = {port: simulation.images(port)[-1] for port in ("left_image", "right_image")}
    simulation.camera.set_parameters({"fault": "right_frozen"})
    simulation.stand()
    left, right = simulation.images("left_image"), simulation.images("right_image")
    assert all(np.array_equal(image, last["right_image"]) for image in right)
    assert not any(np.array_equal(one, other) for one, other in pairwise(left))
    simulation.camera.set_parameters({"fault": "frozen"})
    simulation.stand()
    stamps = [to_ns(message.header.stamp) for message in simulation.camera.take("left_info")]

    assert all(np.array_equal(image, left[-1]) for image in simulation.images("left_image"))
    assert all(
        np.array_equal(image, last["right_image"]) for image in simulation.images("right_image")
    )
    assert len(set(stamps)) == len(stamps) >= 19


def test_swapped_cameras_publish_each_others_images(simulate_camera: SimulateCamera) -> None:
    simulation = simulate_camera(**SHARP)
    simulation.stand()
    left, right = simulation.images("left_image")[-1], simulation.images("right_image")[-1]
    simulation.camera.set_parameters({"fault": "swapped"})
    simulation.stand()

    assert not np.array_equal(left, right)
    assert np.array_equal(simulation.images("left_image")[-1], right)
    assert np.array_equal(simulation.images("right_image")[-1], left)


@pytest.mark.parametrize("distortion", sampled([[0.1, -0.05, 0.002, -0.001, 0.01], [-0.28, 0.08]]))
def test_rectified_distorted_image_equals_the_image_of_an_ideal_lens(
    simulate_camera: SimulateCamera, distortion: list[float]
) -> None:
    bent = simulate_camera(distortion=distortion, **SHARP)
    bent.stand()
    ideal = simulate_camera(**SHARP)
    ideal.stand()
    raw, true = bent.images()[-1], ideal.images()[-1]
    info = bent.camera.take("left_info")[-1]
    straight = Rectifier(info).apply(raw)

    assert info.distortion_model == "plumb_bob"
    assert info.d.tolist()[: len(distortion)] == distortion
    seen = straight > 0
    assert seen.mean() > 0.8
    off, bent_off = (np.abs(one.astype(float) - true)[seen] for one in (straight, raw))
    assert np.percentile(off, 95) < 4
    assert off.mean() < 0.4 * bent_off.mean()


@pytest.mark.parametrize(
    ("parameters", "expected_text"),
    [
        (
            {"distortion": [-5.0]},
            r"simulatedstereocamera: distortion = \[-5.0\] folds or tears "
            "the image",
        ),
        ({"distortion": [0.1] * 6}, "distortion"),
        ({"fault": "broken"}, "fault"),
        ({"light": {"color": 1}}, "color"),
    ],
)
def test_impossible_camera_is_rejected(
    simulate_camera: SimulateCamera, parameters: dict[str, Any], expected_text: str
) -> None:
    with pytest.raises(CairnError, match=expected_text):
        simulate_camera(**parameters)


def test_camera_above_the_ceiling_exits_with_the_reason(simulate_camera: SimulateCamera) -> None:
    simulation = simulate_camera(z=2.5)
    simulation.stand()

    (end,) = simulation.camera.ends
    assert_words(str(end), "2.5 m", "ceiling")


def test_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    def digest() -> str:
        people = [{"name": "ada", "waypoints": [[4.5, 0.5], [4.5, 3.5]]}]
        simulation = CameraSimulation(tmp_path, {"rate": 10.0}, people=people)
        simulation.drive(1.0, 0.3, 0.5)
        sums, codec = hashlib.sha256(), Codec()
        for port in PORTS:
            messages = simulation.camera.take(port)
            assert len(messages) >= 8
            for message in messages:
                sums.update(codec.encode(message))
        return sums.hexdigest()

    assert digest() == digest()


def test_each_image_has_different_noise(simulate_camera: SimulateCamera) -> None:
    simulation = simulate_camera()
    simulation.stand()
    (one, other), right = simulation.images("left_image")[-2:], simulation.images("right_image")[-1]

    still = np.s_[0:100, 0:640]
    off = (one.astype(float) - other)[still]
    assert 1.5 < off.std() < 5
    assert abs(np.corrcoef(off.ravel(), (right.astype(float) - one)[still].ravel())[0, 1]) < 0.8
