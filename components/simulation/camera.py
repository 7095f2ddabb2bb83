"""The driver of the simulated stereo camera: parameters, taking a photograph, the component."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cairn import (
    LATCHED,
    SECOND,
    SENSOR,
    CairnError,
    Config,
    FromRobot,
    Mount,
    Out,
    SensorFrame,
    from_ns,
    on,
)
from cairn.components.simulation.camera_optics import (
    ImageSensor,
    LensDistortion,
    PinholeCamera,
    SensorNoise,
    blurred,
    camera_info,
)
from cairn.components.simulation.layout import WorldLayout, geometry_message
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.rendering import (
    CameraPose,
    VisibleSurfaces,
    ideal_image,
    surfaces_of,
)
from cairn.components.simulation.sensor import WorldSensor
from cairn.components.simulation.textures import TextureAtlas
from cairn.components.simulation.world_file import WorldFile
from cairn.components.simulation.world_tracker import sensor_poses
from cairn.planar.poses import Pose
from cairn.schemas.cairn_sim_msgs import WorldGeometry
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.vision.images import gray_message
from cairn.vision.optical_frames import LEFT_FRAME, RIGHT_FRAME, optical_transforms

Fault = Literal["none", "left_missing", "right_missing", "frozen", "right_frozen", "swapped"]
Coefficient = Annotated[float, Field(ge=-10, le=10)]


class LightConfig(Config):
    """Lighting of the world."""

    level: float = Field(
        1.0, ge=0, le=20, description="Brightness of all lamps; 0 switches them off [1]."
    )
    drift: float = Field(
        0.1,
        ge=0,
        le=2,
        description="Standard deviation of the logarithm of the level over time [1].",
    )
    drift_s: float = Field(20.0, ge=0.1, le=1e5, description="Time constant of the drift [s].")
    spread: float = Field(
        0.15, ge=0, le=0.9, description="Variation of the brightness from place to place [1]."
    )


class SensorConfig(Config):
    """Exposure and imperfections of lens and image sensor."""

    exposure_s: float = Field(
        0.004, gt=0, le=0.5, description="Exposure time: affects brightness and motion blur [s]."
    )
    gain: float = Field(
        1.0, ge=0, le=100, description="Gain; with 1 and 4 ms white is almost saturated [1]."
    )
    vignetting: float = Field(0.2, ge=0, le=1, description="Loss of brightness in the corners [1].")
    defocus: float = Field(
        0.6, ge=0, le=20, description="Standard deviation of the lens's blur [px]."
    )
    read_noise: float = Field(
        1.5, ge=0, le=100, description="Standard deviation of the read noise [gray levels]."
    )
    shot_noise: float = Field(
        0.02,
        ge=0,
        le=10,
        description="Variance of the shot noise per gray level of light [gray levels].",
    )


class SimulatedStereoCameraConfig(Config):
    """A horizontal stereo camera; `light`, `sensor` and `fault` may change at run time."""

    width: int = Field(640, ge=32, le=4096, description="Width of an image [px].")
    height: int = Field(480, ge=32, le=4096, description="Height of an image [px].")
    field_of_view: float = Field(
        math.radians(60), ge=0.1, le=2.6, description="Horizontal field of view [rad]."
    )
    baseline: float = Field(
        0.09, gt=0, le=2, description="Distance from the left to the right camera [m]."
    )
    rate: float = Field(5.0, gt=0, le=100, description="Image pairs per second [1/s].")
    delay_s: float = Field(
        0.03,
        ge=0,
        le=1,
        description="Delay from the exposure to the publication of the images [s].",
    )
    mount: Annotated[Mount, FromRobot("mounts.camera")] = Field(
        Mount(), description="Pose of the left camera on the robot."
    )
    mount_frame: Annotated[SensorFrame, FromRobot("mounts.camera.frame")] = Field(
        "camera",
        description="Frame of that pose on the robot; the optical frames are published in it.",
    )
    z: Annotated[float, FromRobot("mounts.camera.z")] = Field(
        1.0, ge=0.05, le=10, description="Height above the floor [m]."
    )
    distortion: Annotated[list[Coefficient], Field(max_length=5)] = Field(
        [],
        description="Distortion of both lenses: k1, k2, p1, p2, k3 of plumb_bob [1]; empty: "
        "ideal lenses.",
    )
    light: LightConfig = Field(LightConfig(), description="Lighting of the world.")
    sensor: SensorConfig = Field(SensorConfig(), description="Exposure, lens and image sensor.")
    fault: Fault = Field("none", description="Simulated fault of the camera.")


LIVE = ("light", "sensor", "fault")
"""Parameters that may change while the camera runs."""


Gray = NDArray[np.uint8]

# An exposure of this length [s] with gain 1 reproduces the gray levels of surfaces.
_REFERENCE_S = 0.004


def photograph(
    surfaces: VisibleSurfaces,
    atlas: TextureAtlas,
    camera_pose: CameraPose,
    lens: LensDistortion,
    film: ImageSensor,
    light: LightConfig,
    sensor: SensorConfig,
    drifted: float = 0.0,
    turn: float = 0.0,
) -> Gray:
    """Return the image (h, w) of a camera, read-only.

    `drifted` is the current drift of the light in standard deviations; `turn` [rad] is the rotation
    of the camera during the exposure, centered at `camera_pose`.
    """
    level = light.level * math.exp(light.drift * drifted)
    brightness = level * sensor.gain * sensor.exposure_s / _REFERENCE_S
    ideal = ideal_image(surfaces, atlas, camera_pose, lens.ideal, light.spread)
    image = blurred(lens.distorted(ideal), sensor.defocus, lens.ideal.focal * abs(turn))
    noise = SensorNoise(sensor.read_noise, sensor.shot_noise)
    return film.expose(image, brightness, sensor.vignetting, noise)


def seen_from(world: WorldFile, pose: Pose, height: float, right: bool) -> Gray:
    """Return the image of a default camera at the start of a world, from `height` [m].

    Raises `CairnError` if that is not below the ceiling.
    """
    camera = SimulatedStereoCameraConfig()
    surfaces, atlas = surfaces_of(geometry_message(Header(), WorldLayout.of(world)))
    require_below_ceiling(height, surfaces)
    people = circles_of([Walker.of(person) for person in world.people])
    return photograph(
        surfaces.with_people(people),
        atlas,
        CameraPose(pose, height).beside(camera.baseline if right else 0.0),
        LensDistortion(PinholeCamera.of(camera.width, camera.height, camera.field_of_view), ()),
        ImageSensor(camera.width, camera.height, np.random.default_rng(0)),
        camera.light,
        camera.sensor,
    )


def require_below_ceiling(height: float, surfaces: VisibleSurfaces) -> None:
    """Raise `CairnError` if a camera at this height [m] is not below the ceiling."""
    if height >= surfaces.ceiling:
        raise CairnError(
            f"the camera height {height:g} m is not below the ceiling at {surfaces.ceiling:g} "
            "m, the height of the highest wall; lower the camera"
        )


class SimulatedStereoCamera(WorldSensor):
    """Photograph the simulated world in perspective, as a stereo pair with a horizontal view.

    Both images of a pair and their camera infos have the time of the middle of the exposure.

    Images are gray, with lens distortion, changing light, blur, noise and faults. `light`, `sensor`
    and `fault` can change at run time. Not simulated: motion blur of straight driving, rolling
    shutter, pitch, roll, shadows, reflections and color. Objects of 0.5 m are recognized up to
    about 5 m from the front, and up to 3 m at 60 degrees.
    """

    live_parameters = frozenset(LIVE)
    published_frames = frozenset({LEFT_FRAME, RIGHT_FRAME})
    config: SimulatedStereoCameraConfig

    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    tf_static: Out[TFMessage] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Compute the distortion; create the image sensor."""
        super().on_configure()
        config = self.config
        lens = PinholeCamera.of(config.width, config.height, config.field_of_view)
        try:
            self._lens = LensDistortion(lens, config.distortion)
        except CairnError as error:
            raise CairnError(f"{self.name}: {error}") from error
        self._infos = (
            camera_info(lens, config.distortion, LEFT_FRAME, 0.0),
            camera_info(lens, config.distortion, RIGHT_FRAME, config.baseline),
        )
        self._film = ImageSensor(config.width, config.height, self.random)
        self._light_drift = float(self.random.standard_normal())
        self._surfaces_and_textures: tuple[VisibleSurfaces, TextureAtlas] | None = None
        self._last: tuple[Gray, Gray] | None = None
        self._period = round(SECOND / config.rate)

    def on_activate(self) -> None:
        """Publish the optical frames; start to take photographs."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id=self.config.mount_frame)
        transforms = optical_transforms(header, self.config.baseline)
        self.tf_static.publish(TFMessage(transforms=transforms))
        self.measure_every(self._period, self._photograph)

    @on("world_geometry")
    def on_world_geometry(self, geometry: WorldGeometry) -> None:
        """Take walls, furniture and objects."""
        super().on_world_geometry(geometry)
        self._surfaces_and_textures = surfaces_of(geometry)
        require_below_ceiling(self.config.z, self._surfaces_and_textures[0])

    def _photograph(self) -> None:
        config = self.config
        exposure_s = config.sensor.exposure_s
        stamp = self.clock.now() - round(config.delay_s * SECOND)
        shutter = stamp - round(0.5 * exposure_s * SECOND)
        robot = self.world.robot_at(shutter, np.array([0.0, exposure_s]))
        if robot is None or self._surfaces_and_textures is None:
            return
        decay = math.exp(-self._period / SECOND / config.light.drift_s)
        noise = float(self.random.standard_normal())
        self._light_drift = decay * self._light_drift + math.sqrt(1.0 - decay**2) * noise
        opened, closed = sensor_poses(robot, config.mount.pose)
        x, y, theta = (0.5 * (opened + closed)).tolist()
        pair = self._pair(CameraPose((x, y, theta), config.z), float(closed[2] - opened[2]))
        self._publish(stamp, *self._with_fault(pair))
        self._last = pair

    def _pair(self, left: CameraPose, turn: float) -> tuple[Gray, Gray]:
        if self.config.fault == "frozen" and self._last is not None:
            return self._last
        assert self._surfaces_and_textures is not None  # otherwise nothing is photographed
        surfaces, atlas = self._surfaces_and_textures
        surfaces = surfaces.with_people(self.world.ray_targets.people)
        config = self.config
        one, other = (
            photograph(
                surfaces, atlas, camera_pose, self._lens, self._film, config.light, config.sensor,
                self._light_drift, turn,
            )
            for camera_pose in (left, left.beside(config.baseline))
        )  # fmt: skip
        if config.fault == "right_frozen" and self._last is not None:
            other = self._last[1]
        return one, other

    def _with_fault(self, pair: tuple[Gray, Gray]) -> tuple[Gray | None, Gray | None]:
        left, right = pair
        match self.config.fault:
            case "left_missing":
                return None, right
            case "right_missing":
                return left, None
            case "swapped":
                return right, left
            case _:
                return pair

    def _publish(self, stamp: int, left: Gray | None, right: Gray | None) -> None:
        headers = [replace(info.header, stamp=from_ns(stamp)) for info in self._infos]
        ports = (self.left_info, self.right_info)
        for image, info, header, port in zip(
            (left, right), self._infos, headers, ports, strict=True
        ):
            if image is not None:
                port.publish(replace(info, header=header))
        for image, header, out in zip(
            (left, right), headers, (self.left_image, self.right_image), strict=True
        ):
            if image is not None:
                out.publish(gray_message(image, header))
