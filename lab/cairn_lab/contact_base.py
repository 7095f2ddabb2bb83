"""A base whose wheels touch the floor: MuJoCo computes how they roll, slip and are held.

    pip install './lab[mujoco]'
    cairn up sim --set components.mobile_supervisor.children.base.plugin=PLUGIN

PLUGIN is `cairn_lab.contact_base:ContactBase`.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, Final

import numpy as np
from pydantic import Field

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    In,
    Out,
    every,
    from_ns,
    on,
)
from cairn.components.simulation.base import LONGEST_STEP_S, DriveConfig, WheelDrive
from cairn.planar.messages import transform_message, twist_message, with_covariance
from cairn.planar.motion_model import odometry_step
from cairn.planar.poses import Pose, compose, relative
from cairn.schemas.cairn_sim_msgs import WheelMotion
from cairn.schemas.geometry_msgs import Twist, TwistWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

WHEEL_M: Final = 0.05
"""Radius of the wheels [m]."""
TRACK_M: Final = 0.3
"""Distance of the wheels [m]."""


class WheelContacts:
    """Two wheels and a caster behind, 8.7 kg, on a plane that falls along x by `slope` [1].

    Attributes:
        odometry: the pose by the turns of the wheels, which start at the true pose, with distances
            `scale` times as long; its heading is not wrapped.

    """

    def __init__(self, friction: float, slope: float, scale: float, start: Pose) -> None:
        mujoco: Any = import_module("mujoco")  # an extra of the lab
        self._step = mujoco.mj_step
        self._model = mujoco.MjModel.from_xml_string(_model(friction, slope))
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:2] = start[:2]
        self._data.qpos[3], self._data.qpos[6] = math.cos(start[2] / 2), math.sin(start[2] / 2)
        mujoco.mj_forward(self._model, self._data)
        self._scale = scale
        self._turned = np.array(self._data.qpos[7:9])  # by the wheels [rad]
        self.odometry: Pose = start

    @property
    def time_s(self) -> float:
        """The simulated time [s]."""
        return float(self._data.time)

    @property
    def pose(self) -> Pose:
        """The true pose."""
        x, y = self._data.qpos[:2].tolist()
        w, i, j, k = self._data.qpos[3:7].tolist()
        return x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    def roll(self, seconds: float, forward: float, turn: float) -> None:
        """Let the motors turn the wheels for some seconds at these speeds [m/s, rad/s]."""
        half = turn * TRACK_M / 2
        self._data.ctrl[:] = (forward - half) / WHEEL_M, (forward + half) / WHEEL_M
        self._step(self._model, self._data, round(seconds / self._model.opt.timestep))
        left, right = (np.array(self._data.qpos[7:9]) - self._turned).tolist()
        self._turned = np.array(self._data.qpos[7:9])
        angle = (right - left) * WHEEL_M / TRACK_M
        ahead = self._scale * (left + right) * WHEEL_M / 2
        x, y, theta = self.odometry
        way = theta + angle / 2
        self.odometry = (x + ahead * math.cos(way), y + ahead * math.sin(way), theta + angle)


def _model(friction: float, slope: float) -> str:
    """Return MuJoCo's model of the base on its floor."""
    along, down = -9.81 * math.sin(math.atan(slope)), -9.81 * math.cos(math.atan(slope))
    contact = f'friction="{friction} 0.005 0.0001"'
    wheels = "".join(
        f'<body pos="0 {side * TRACK_M / 2} 0">'
        f'<joint name="{name}" type="hinge" axis="0 1 0" damping="0.01" armature="0.005"/>'
        f'<geom type="ellipsoid" size="{WHEEL_M} 0.012 {WHEEL_M}" mass="0.3" {contact}'
        ' priority="1"/></body>'
        for name, side in (("left", 1), ("right", -1))
    )
    return f"""<mujoco>
      <option timestep="0.002" gravity="{along} 0 {down}" integrator="implicitfast"/>
      <worldbody>
        <geom type="plane" size="100 100 1" {contact}/>
        <body pos="0 0 {WHEEL_M}"><freejoint/>
          <geom type="cylinder" size="0.18 0.04" pos="-0.025 0 0.03" mass="8" contype="0"
            conaffinity="0"/>
          <geom type="sphere" size="0.02" pos="-0.14 0 {0.02 - WHEEL_M}" mass="0.1"
            friction="0.001 0 0" priority="1"/>
          {wheels}
        </body>
      </worldbody>
      <actuator>
        <velocity joint="left" kv="1" ctrlrange="-30 30"/>
        <velocity joint="right" kv="1" ctrlrange="-30 30"/>
      </actuator>
    </mujoco>"""


class ContactBaseConfig(DriveConfig):
    """What the motors can do, the floor, and the scale of odometry."""

    friction: float = Field(0.9, gt=0, le=2, description="Friction of the floor [1].")
    slope: float = Field(0.0, ge=0, le=0.2, description="How far the floor falls per distance [1].")
    odometry_scale: float = Field(
        1.0, gt=0, le=2, description="Distance of odometry per distance of the wheels [1]."
    )


class ContactBase(Component):
    """Carry out velocity commands with wheels on a floor; publish odometry of their turns.

    The world moves the robot as MuJoCo's base moves.
    """

    live_parameters = frozenset()
    config: ContactBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR, exclusive=True)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    wheel_motion: Out[WheelMotion] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Put the base onto its floor."""
        config = self.config
        self._motors = WheelDrive(config)
        self._contacts = WheelContacts(
            config.friction, config.slope, config.odometry_scale, (0.0, 0.0, 0.0)
        )
        self._stepped_at: int | None = None

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Take a velocity command."""
        self._motors.command(self.clock.now() / SECOND, command.linear.x, command.angular.z)

    @every(hz=50)
    def step(self) -> None:
        """Turn the wheels; publish the true motion and the odometry."""
        now = self.clock.now()
        last, self._stepped_at = self._stepped_at, now
        if last is None or now <= last:
            return
        seconds = min((now - last) / SECOND, LONGEST_STEP_S)
        before, stated = self._contacts.pose, self._contacts.odometry
        self._contacts.roll(seconds, *self._motors.step(now / SECOND, seconds))
        moved = odometry_step(relative(before, self._contacts.pose))
        measured = odometry_step(relative(stated, self._contacts.odometry))
        self.wheel_motion.publish(
            WheelMotion(
                header=Header(stamp=from_ns(now)),
                seconds=seconds,
                forward=moved.ahead / seconds,
                aside=moved.aside / seconds,
                turn=moved.turned / seconds,
                robot=self.robot,
            )
        )
        header = Header(stamp=from_ns(now), frame_id="odom")
        odometry = compose((0.0, 0.0, 0.0), self._contacts.odometry)  # with a wrapped heading
        twist = twist_message(measured.ahead / seconds, measured.turned / seconds)
        self.odom.publish(
            Odometry(
                header=header,
                child_frame_id="base_link",
                pose=with_covariance(odometry, np.zeros((3, 3))),
                twist=TwistWithCovariance(twist=twist),
            )
        )
        transform = transform_message(header, "base_link", odometry)
        self.tf.publish(TFMessage(transforms=(transform,)))
