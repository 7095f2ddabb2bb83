"""The driver of a base that speaks ROS 2 over the bus."""

from __future__ import annotations

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    In,
    Out,
    every,
    on,
)
from cairn.components.ros2_devices.command_relay import CommandRelay, stamped_twist
from cairn.components.ros2_devices.config import Ros2BaseConfig
from cairn.components.ros2_devices.odometry import (
    OdometryContinuity,
    odometry_message,
    odometry_transform,
    rejection,
    understood,
)
from cairn.driver.command_timeout import REST
from cairn.driver.diagnostics import OK, WARN
from cairn.driver.ros2_source import Ros2Source, SourceLimits
from cairn.planar.messages import planar_pose, twist_message
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import Twist, TwistStamped
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage


class Ros2Base(Component):
    """Passes commands to a base that speaks ROS 2, and its checked odometry to the robot.

    The deployment names the base's topics: `topics: {base_cmd_vel: /cmd_vel, base_odom: /odom}`.
    While no odometry arrives, the base is not driven.

    Commands are limited to `speed` and `turn` and repeated 20 times per second while they are
    fresh. After `command_timeout_s` the driver commands rest for `rest_s`, then sends nothing, so
    that a joystick can control the base. Without valid odometry for `odom_timeout_s` it commands
    rest. After a restart, the base moves only after one command to rest, or after commands have
    ceased once.

    The log and `diagnostics` report odometry that is rejected:

    - frames other than `odom_frame` and `base_frame`, which an empty name means, too; `odom` and
      `base_link` are published;
    - messages older than `odom_age_s` or from the future: synchronize the clocks, or set
      `stamp_on_arrival: true` for a base without a clock;
    - duplicates; late messages that contradict the poses of their time or are more than 0.5 s late;
    - values that are not finite, and orientations that are not set (all zeros); others are divided
      by their length, and projected to the plane if they are tilted.

    Jumps faster than twice `speed` or `turn`, or a return to the origin after silence, mean that
    the base was restarted; poses continue from the last one.
    """

    live_parameters = frozenset()
    config: Ros2BaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR, exclusive=True)
    base_odom: In[Odometry] = In(qos=SENSOR.with_depth(50))
    base_cmd_vel: Out[Twist] = Out(exclusive=True)
    base_cmd_vel_stamped: Out[TwistStamped] = Out(exclusive=True)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Start without knowledge of the base."""
        self._continuity = OdometryContinuity(self.config)

    def on_activate(self) -> None:
        """Command rest, whatever was commanded before."""
        config = self.config
        self._relay = CommandRelay(
            config.speed, config.turn, config.command_timeout_s, config.rest_s
        )
        self._source = Ros2Source(
            self,
            self.base_odom.topic,
            "the base's odometry",
            "the base is not driven",
            SourceLimits(
                config.odom_rate, config.odom_timeout_s, config.odom_age_s, config.stamp_on_arrival
            ),
        )

    def on_deactivate(self) -> None:
        """Command rest."""
        self._send(*REST)

    def on_error(self, _: Exception) -> bool:
        """Command rest, if it was active."""
        self._send(*REST)
        return False

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Pass a command on at once."""
        self._relay.set(self._seconds(), command.linear.x, command.angular.z)
        self.repeat_command()

    @every(hz=20)
    def repeat_command(self) -> None:
        """Send the command again while it is fresh, as the base's own timeout requires."""
        due = self._relay.due(self._seconds(), usable=self._source.is_usable)
        if due is not None:
            self._send(*due)

    @on("base_odom")
    def on_base_odom(self, message: Odometry) -> None:
        """Publish the base's odometry if it is usable."""
        stamp = self._source.stamp_of(message.header.stamp)
        reason = rejection(message, self.config) or self._untimely(stamp)
        if reason is not None:
            self._source.reject(reason)
            return
        jumps, newest = self._continuity.jumps, self._continuity.newest
        continued = self._continuity.add(stamp, planar_pose(message.pose.pose))
        if continued is None:
            assert newest is not None
            self._source.reject(
                f"odometry of the base arrived {(newest - stamp) / SECOND:.2f} s out of order, and "
                "is too late or does not fit the poses of that time; check that only one node "
                f"publishes {self.base_odom.topic}"
            )
            return
        for what in understood(message, self.config):
            self._source.note_once(what)
        was_silent = self._source.accept(stamp)
        if self._continuity.jumps > jumps:
            if was_silent:
                self._relay.base_restarted(self._seconds())
            self.log.warning(
                "odometry of the base jumped, as if the base was restarted; it is continued from "
                "its last pose"
            )
        published = odometry_message(message, stamp, continued)
        self.odom.publish(published)
        if self.config.send_tf:
            self.tf.publish(TFMessage(transforms=(odometry_transform(published, continued.pose),)))

    @every(hz=1)
    def publish_health(self) -> None:
        """Publish how the base's odometry arrives."""
        healthy = (OK, "drives")
        if self._relay.awaits_rest:
            healthy = (
                WARN,
                "the base was restarted: it is driven once the command has been rest, or has "
                "ceased",
            )
        values: dict[str, object] = {"jumps": self._continuity.jumps}
        self.diagnostics.publish(self._source.report(healthy, values))

    def _untimely(self, stamp: int) -> str | None:
        """Return why a stamp cannot be used, as a sentence; None if it can."""
        newest = self._continuity.newest
        if newest is not None and self._source.is_ahead(newest):
            self._continuity.set_time_back()
        if self._continuity.has(stamp):
            return (
                "odometry of the base arrived twice; check that only one node publishes "
                f"{self.base_odom.topic}"
            )
        return self._source.why_untimely(stamp)

    def _send(self, forward: float, turn: float) -> None:
        if self.config.stamped:
            # A base with another clock would reject commands stamped by ours as old or future.
            stamp = 0 if self.config.stamp_on_arrival else self.clock.now()
            frame = self.config.base_frame
            self.base_cmd_vel_stamped.publish(stamped_twist(stamp, frame, forward, turn))
        else:
            self.base_cmd_vel.publish(twist_message(forward, turn))

    def _seconds(self) -> float:
        return self.clock.now() / SECOND
