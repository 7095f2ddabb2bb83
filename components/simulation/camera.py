"""The driver of the simulated stereo camera."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    from_ns,
    on,
)
from cairn.components.simulation.atlas import Atlas
from cairn.components.simulation.camera_config import LIVE, SimulatedStereoCameraConfig
from cairn.components.simulation.exposure import Film
from cairn.components.simulation.lens import Distortion, Lens, camera_info
from cairn.components.simulation.photography import photograph, refuse_height
from cairn.components.simulation.surfaces import Surfaces, surfaces_of
from cairn.components.simulation.view import Station
from cairn.components.simulation.watching import WorldWatch, composed
from cairn.schemas.cairn_sim_msgs import Scene, WorldState
from cairn.schemas.geometry_msgs import Quaternion, Transform, TransformStamped, Vector3
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

Gray = NDArray[np.uint8]

_LEFT, _RIGHT = "left_camera_optical_frame", "right_camera_optical_frame"


class SimulatedStereoCamera(Component):
    """Photographs the simulated world in perspective, as a stereo pair that looks ahead level.

    Both images of a pair, and what is told of their cameras, have the stamp of the middle of the
    exposure.
    """

    config: SimulatedStereoCameraConfig

    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200))
    scene: In[Scene] = In(qos=LATCHED)
    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    tf_static: Out[TFMessage] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Grind the lens, and put films in."""
        config = self.config
        lens = Lens.of(config.width, config.height, config.field_of_view)
        try:
            self._lens = Distortion(lens, config.distortion)
        except CairnError as error:
            raise CairnError(f"{self.name}: {error}") from error
        self._infos = (
            camera_info(lens, config.distortion, _LEFT, 0.0),
            camera_info(lens, config.distortion, _RIGHT, config.baseline),
        )
        self._film = Film(config.width, config.height, self.random)
        self._drifted = float(self.random.standard_normal())
        self._watch = WorldWatch()
        self._stands: tuple[Surfaces, Atlas] | None = None
        self._last: tuple[Gray, Gray] | None = None
        self._period = round(SECOND / config.rate)

    def on_activate(self) -> None:
        """Tell where the cameras sit on the robot; begin to photograph."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        baseline = self.config.baseline
        self.tf_static.publish(
            TFMessage(
                transforms=(
                    self._mounted(header, _LEFT, 0),
                    self._mounted(header, _RIGHT, baseline),
                )
            )
        )
        self._due = self.clock.now() + self._period
        self.schedule(self._due, self._photograph)

    def on_parameters(self, new: Config) -> None:
        """Light, sensor and fault may change; the camera stays the one that it is."""
        for name in type(self.config).model_fields:
            if name not in LIVE and getattr(new, name) != getattr(self.config, name):
                raise ParameterRejected(
                    f"the simulated camera takes {name} when it is configured; {', '.join(LIVE)} "
                    "may be changed while it runs"
                )

    @on("scene")
    def know(self, scene: Scene) -> None:
        """Take what stands."""
        self._watch.take_scene(scene)
        self._stands = surfaces_of(scene)
        refuse_height(self.config.z, self._stands[0])

    @on("world_state")
    def watch(self, state: WorldState) -> None:
        """Take what moves."""
        self._watch.take_state(state)

    def _photograph(self) -> None:
        now = self.clock.now()
        self._due += self._period
        if self._due <= now:  # it was held up: pairs that were missed are not made up for
            self._due = now + self._period
        self.schedule(self._due, self._photograph)
        config = self.config
        exposure_s = config.sensor.exposure_s
        stamp = now - round(config.delay_s * SECOND)
        shutter = stamp - round(0.5 * exposure_s * SECOND)
        robot = self._watch.robot_at(shutter, np.array([0.0, exposure_s]))
        if robot is None or self._stands is None:
            return
        kept = math.exp(-self._period / SECOND / config.light.drift_s)
        chance = float(self.random.standard_normal())
        self._drifted = kept * self._drifted + math.sqrt(1.0 - kept**2) * chance
        opened, closed = composed(robot, config.mount.pose)
        x, y, theta = (0.5 * (opened + closed)).tolist()
        pair = self._pair(Station((x, y, theta), config.z), float(closed[2] - opened[2]))
        self._tell(stamp, *self._spoiled(pair))
        self._last = pair

    def _pair(self, left: Station, turn: float) -> tuple[Gray, Gray]:
        if self.config.fault == "frozen" and self._last is not None:
            return self._last
        assert self._stands is not None  # or nothing is photographed
        surfaces, atlas = self._stands
        surfaces = surfaces.with_people(self._watch.around.people)
        config = self.config
        one, other = (
            photograph(
                surfaces, atlas, station, self._lens, self._film, config.light, config.sensor,
                self._drifted, turn,
            )
            for station in (left, left.beside(config.baseline))
        )  # fmt: skip
        if config.fault == "right_frozen" and self._last is not None:
            other = self._last[1]
        return one, other

    def _spoiled(self, pair: tuple[Gray, Gray]) -> tuple[Gray | None, Gray | None]:
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

    def _tell(self, stamp: int, left: Gray | None, right: Gray | None) -> None:
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
                height, width = image.shape
                out.publish(
                    Image(
                        header=header,
                        height=height,
                        width=width,
                        encoding="mono8",
                        step=width,
                        data=image.reshape(-1),
                    )
                )

    def _mounted(self, header: Header, frame: str, right: float) -> TransformStamped:
        """Where a camera sits: x of its frame to the right, y down, z ahead (REP 103)."""
        station = Station(self.config.mount.pose, self.config.z).beside(right)
        x, y, theta = station.pose
        sine, cosine = math.sin(0.5 * theta), math.cos(0.5 * theta)
        more, less = 0.5 * (cosine + sine), 0.5 * (cosine - sine)
        return TransformStamped(
            header=header,
            child_frame_id=frame,
            transform=Transform(
                translation=Vector3(x=x, y=y, z=station.height),
                rotation=Quaternion(x=-more, y=less, z=-less, w=more),
            ),
        )
