"""A base that is a ROS 2 node, in a process of its own: `base_node.py PORT DEFINITIONS`.

It speaks by zenoh-ros2-sdk, an independent client of rmw_zenoh, and drives like ROS 2's
diff_drive_controller: a command holds for half a second, an older stamped one is rejected, the
wheels accelerate gradually, and odometry starts at 0 when the node starts.
DEFINITIONS is a directory of .msg files. It executes lines of JSON, `[verb, argument ...]`, and
answers each with one.
"""

import json
import math
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

PERIOD_S = 0.05
COMMAND_TIMEOUT_S = 0.5
ACCELERATIONS = (1.5, 6.0)  # [m/s^2, rad/s^2]
STANDSTILL_SPEED = 0.01  # [m/s, rad/s]


class BaseNode:
    """The node: its publisher and subscribers while it has joined, and the base that it drives."""

    def __init__(self, port: int, definitions: Path) -> None:
        # The SDK logs to its standard output otherwise, among the answers.
        os.environ["RCUTILS_LOGGING_SEVERITY"] = "ERROR"
        import zenoh_ros2_sdk as sdk

        self._sdk = sdk
        self._router = {"router_ip": "127.0.0.1", "router_port": port, "namespace": "/ros"}
        self._types = sdk.ZenohSession.get_instance("127.0.0.1", port).store.types
        sdk.get_registry().messages_dir = definitions
        self._lock = threading.Lock()
        self._moved = threading.Condition()
        self._ends: list[Any] = []
        self._reset()
        threading.Thread(target=self._drive, daemon=True).start()

    def join(self) -> None:
        """Start the node, if it has not joined."""
        if self._ends:
            return
        self._reset()
        node = {"node_name": "base", **self._router}
        odom = self._sdk.ROS2Publisher("/odom", "nav_msgs/msg/Odometry", **node)
        kinds = (
            ("/cmd_vel", "geometry_msgs/msg/Twist", self._on_command),
            ("/stamped/cmd_vel", "geometry_msgs/msg/TwistStamped", self._on_stamped_command),
        )
        subscribers = [self._sdk.ROS2Subscriber(*kind, **node) for kind in kinds]
        with self._lock:
            self._ends = [odom, *subscribers]

    def leave(self) -> None:
        """Stop the node: it neither receives nor publishes."""
        with self._lock:
            ends, self._ends = self._ends, []
        for end in ends:
            end.close()

    def turns(self) -> bool:
        """Return whether the wheels turn now."""
        return any(abs(speed) > STANDSTILL_SPEED for speed in self._speeds)

    def await_stand(self, limit_s: float) -> bool:
        """Wait until they stand; return whether that was within the limit [s]."""
        with self._moved:
            return self._moved.wait_for(lambda: not self.turns(), limit_s)

    def _reset(self) -> None:
        self._pose = (0.0, 0.0, 0.0)
        self._speeds = self._command = (0.0, 0.0)
        self._commanded_at = -math.inf

    def _on_command(self, twist: Any) -> None:
        self._command = (twist.linear.x, twist.angular.z)
        self._commanded_at = time.monotonic()

    def _on_stamped_command(self, message: Any) -> None:
        stamp = message.header.stamp
        if time.time() - (stamp.sec + stamp.nanosec / 1e9) < COMMAND_TIMEOUT_S:
            self._on_command(message.twist)

    def _drive(self) -> None:
        due = time.monotonic()
        while True:
            due += PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))
            with self._moved:
                self._step()
                self._moved.notify_all()
            with self._lock:
                if self._ends:
                    self._publish_odometry(self._ends[0])

    def _step(self) -> None:
        fresh = time.monotonic() - self._commanded_at <= COMMAND_TIMEOUT_S
        target = self._command if fresh else (0.0, 0.0)
        forward, turn = (
            now + max(-most * PERIOD_S, min(most * PERIOD_S, aim - now))
            for now, aim, most in zip(self._speeds, target, ACCELERATIONS, strict=True)
        )
        self._speeds = (forward, turn)
        x, y, heading = self._pose
        middle = heading + 0.5 * turn * PERIOD_S
        distance = forward * PERIOD_S
        self._pose = (
            x + distance * math.cos(middle),
            y + distance * math.sin(middle),
            heading + turn * PERIOD_S,
        )  # fmt: skip

    def _publish_odometry(self, odom: Any) -> None:
        x, y, heading = self._pose
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        odom.publish(
            header=self._new(
                "std_msgs/msg/Header",
                self._new("builtin_interfaces/msg/Time", seconds, nanoseconds),
                "odom",
            ),
            child_frame_id="base_footprint",
            pose=self._new(
                "geometry_msgs/msg/PoseWithCovariance",
                self._new(
                    "geometry_msgs/msg/Pose",
                    self._new("geometry_msgs/msg/Point", x, y, 0.0),
                    self._new(
                        "geometry_msgs/msg/Quaternion",
                        0.0,
                        0.0,
                        math.sin(0.5 * heading),
                        math.cos(0.5 * heading),
                    ),
                ),
                np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.02]).ravel(),
            ),
            twist=self._new(
                "geometry_msgs/msg/TwistWithCovariance",
                self._new(
                    "geometry_msgs/msg/Twist",
                    self._vector(self._speeds[0], 0.0, 0.0),
                    self._vector(0.0, 0.0, self._speeds[1]),
                ),
                np.zeros(36),
            ),
        )

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._new("geometry_msgs/msg/Vector3", x, y, z)

    def _new(self, name: str, *fields: Any) -> Any:
        return self._types[name](*fields)


def main() -> None:
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    sys.stdout = sys.stderr
    node = BaseNode(int(sys.argv[1]), Path(sys.argv[2]))
    for line in sys.stdin:
        verb, *arguments = json.loads(line)
        answers.write(json.dumps(getattr(node, verb)(*arguments)) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
