"""The driver of a base that speaks ROS 2 over the bus."""

from __future__ import annotations

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    RateLimitedLog,
    every,
    on,
    to_ns,
)
from cairn.components.ros2_base.commanding import REST, Commanding
from cairn.components.ros2_base.config import Ros2BaseConfig
from cairn.components.ros2_base.messages import odometry, stamped_twist, transform, twist
from cairn.components.ros2_base.odometry_checks import Continuity, Expected, refusal
from cairn.driver.diagnostics import ERROR, OK, WARN, RateWindow, diagnostics
from cairn.planar.messages import planar_pose
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.geometry_msgs import Twist, TwistStamped
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.tf2_msgs import TFMessage

_FUTURE_S = 0.1  # by so much clocks of two computers may differ
_FASTER = 2.0  # than commanded: the base may be slow to slow down, or be pushed
_SLOW = 0.8  # of the nominal rate: slower is told
_WELL_S = 5.0  # without a refusal, and odometry is all right again


class Ros2Base(Component):
    """Hands commands to a base that speaks ROS 2, and its odometry to the robot, checked.

    The deployment names the base's topics: `topics: {base_cmd_vel: /cmd_vel, base_odom: /odom}`.
    While its odometry does not come, the base is not driven.
    """

    config: Ros2BaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR)
    base_odom: In[Odometry] = In(qos=SENSOR.with_depth(50))
    base_cmd_vel: Out[Twist]
    base_cmd_vel_stamped: Out[TwistStamped]
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Know nothing of the base yet."""
        config = self.config
        self._expected = Expected(
            config.odom_frame,
            config.base_frame,
            _FASTER * config.speed,
            _FASTER * config.turn,
            config.odom_timeout_s,
        )
        self._continuity = Continuity(self._expected)
        self._warnings = RateLimitedLog(self.log)

    def on_activate(self) -> None:
        """Have the base rest, whatever it was told before."""
        config = self.config
        self._commanding = Commanding(
            config.speed, config.turn, config.command_timeout_s, config.rest_s
        )
        self._rate = RateWindow()
        self._heard: int | None = None
        self._stamped: int | None = None
        self._refused = 0
        self._refusal, self._refused_at = "", 0

    def on_deactivate(self) -> None:
        """Have the base rest."""
        self._send(*REST)

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - whatever it was
        """Have the base rest, if it was active."""
        self._send(*REST)
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A base stays the one that it is."""
        raise ParameterRejected("the base takes its parameters when it is configured")

    @on("cmd_vel")
    def obey(self, command: Twist) -> None:
        """Hand a command on at once."""
        self._commanding.give(self._seconds(), command.linear.x, command.angular.z)
        self.repeat()

    @every(hz=20)
    def repeat(self) -> None:
        """Say it again while it is fresh: the base's own time limit asks for that."""
        due = self._commanding.due(self._seconds(), usable=self._usable())
        if due is not None:
            self._send(*due)

    @on("base_odom")
    def tell(self, message: Odometry) -> None:
        """Send the base's odometry on, if it can be relied on."""
        now = self.clock.now()
        stamp = now if self.config.stamp_on_arrival else to_ns(message.header.stamp)
        why = refusal(message, self._expected) or self._untimely(now, stamp)
        if why is not None:
            self._refused += 1
            self._refusal, self._refused_at = why, now
            self._warnings.warn("odometry", why)
            return
        pause = not self._usable()
        if pause:
            self._rate.restart()  # it is told of already
        self._heard, self._stamped = now, stamp
        self._rate.note(now / SECOND)
        jumps = self._continuity.jumps
        pose = self._continuity.pose(stamp / SECOND, planar_pose(message.pose.pose))
        if self._continuity.jumps > jumps:
            if pause:
                self._commanding.begin_anew(now / SECOND)
            self.log.warning(
                "the base's odometry has jumped, as if the base was started anew; "
                "it is led on from where it was"
            )
        sent = odometry(message, stamp, pose, self._continuity.turned)
        self.odom.publish(sent)
        if self.config.send_tf:
            self.tf.publish(TFMessage(transforms=(transform(sent, pose),)))

    @every(hz=1)
    def report(self) -> None:
        """Tell how the base's odometry comes."""
        now = self.clock.now()
        if self._usable():
            self._warnings.resolved("silence", "the base tells its odometry again")
        else:
            self._warnings.warn("silence", self._silence())
        if now - self._refused_at > _WELL_S * SECOND:
            self._warnings.resolved("odometry", "all of the base's odometry can be used again")
        hz = self._rate.hz(now / SECOND)
        level, text = self._judged(hz)
        values = {
            "odometry rate [Hz]": hz,
            "nominal rate [Hz]": self.config.odom_rate,
            "odometry refused": self._refused,
            "jumps": self._continuity.jumps,
        }
        self.diagnostics.publish(
            diagnostics(now, self.name, self.base_odom.topic, level, text, values)
        )

    def _judged(self, hz: float) -> tuple[int, str]:
        if not self._usable():
            return ERROR, self._silence()
        if self._commanding.awaits_rest:
            return WARN, (
                "the base was started anew: it is driven once the command has been rest, or has "
                "ceased"
            )
        if hz < _SLOW * self.config.odom_rate:
            return WARN, (
                f"the base's odometry comes at {hz:.1f} Hz instead of {self.config.odom_rate:g} Hz"
            )
        return OK, "drives"

    def _silence(self) -> str:
        if self._refusal and self.clock.now() - self._refused_at <= self._limit():
            return f"the base is not driven: {self._refusal}"
        return (
            f"no usable odometry comes on {self.base_odom.topic}, so the base is not driven; does "
            "the base run, is its ROS_DOMAIN_ID that of the deployment, and is its router this one?"
        )

    def _usable(self) -> bool:
        return self._heard is not None and self.clock.now() - self._heard <= self._limit()

    def _limit(self) -> float:
        """For how long the base is driven without usable odometry [ns]."""
        return self.config.odom_timeout_s * SECOND

    def _untimely(self, now: int, stamp: int) -> str | None:
        last = self._stamped
        if last is not None and stamp <= last <= now + _FUTURE_S * SECOND:  # else now was set back
            return (
                "odometry of the base has come twice, or out of order; does more than one node "
                f"write {self.base_odom.topic}?"
            )
        age = (now - stamp) / SECOND
        if -_FUTURE_S <= age <= self.config.odom_age_s:
            return None
        when = f"{age:.2f} s old" if age > 0 else f"{-age:.2f} s from the future"
        return (
            f"the base's odometry is {when} when it comes; set both computers' clocks by one "
            "source (chrony), or set stamp_on_arrival"
        )

    def _send(self, forward: float, turn: float) -> None:
        if self.config.stamped:
            # A base without our time would refuse a command with it as old, or of the future.
            stamp = 0 if self.config.stamp_on_arrival else self.clock.now()
            frame = self.config.base_frame
            self.base_cmd_vel_stamped.publish(stamped_twist(stamp, frame, forward, turn))
        else:
            self.base_cmd_vel.publish(twist(forward, turn))

    def _seconds(self) -> float:
        return self.clock.now() / SECOND
