"""A transform between two frames: an immutable translation and rotation in three dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cairn.schemas import geometry_msgs
from cairn.tf import rigid_motion
from cairn.tf.errors import InvalidArgumentError
from cairn.tf.rigid_motion import Motion

Array = NDArray[np.float64]

QUATERNION_TOLERANCE = 0.01
"""How much the squared length of a quaternion may differ from 1; as in tf2."""

_GIMBAL_LOCK = 1.0 - 1e-12  # sine of a pitch at which roll and yaw cannot be separated


@dataclass(frozen=True, slots=True)
class Transform:
    """The pose of a source frame in a target frame: it maps the source's points to the target.

    `a_from_b @ b_from_c` is the transform a <- c. A quaternion of almost unit length is normalized.

    Attributes:
        translation: x, y, z [m].
        rotation: quaternion x, y, z, w.

    Raises:
        InvalidArgumentError: if a number is not finite, or the quaternion has not unit length.
    """

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    __array_ufunc__: ClassVar[None] = None  # NumPy leaves `array @ transform` to this class

    def __post_init__(self) -> None:
        """Check the numbers and normalize the quaternion."""
        motion = checked_motion(self.translation, self.rotation)
        object.__setattr__(self, "translation", motion[:3])
        object.__setattr__(self, "rotation", motion[3:])

    @classmethod
    def from_motion(cls, motion: Motion) -> Self:
        """Return the transform of a motion whose quaternion has unit length; nothing is checked."""
        transform = object.__new__(cls)
        object.__setattr__(transform, "translation", motion[:3])
        object.__setattr__(transform, "rotation", motion[3:])
        return transform

    @classmethod
    def from_message(cls, message: geometry_msgs.Transform) -> Self:
        """Return the transform of a message; raise `InvalidArgumentError` as the class."""
        moved, turned = message.translation, message.rotation
        return cls((moved.x, moved.y, moved.z), (turned.x, turned.y, turned.z, turned.w))

    @classmethod
    def from_pose2d(cls, x: float, y: float, yaw: float) -> Self:
        """Return the transform of a pose in the plane [m, m, rad]."""
        return cls((x, y, 0.0), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))

    @classmethod
    def from_roll_pitch_yaw(
        cls,
        roll: float,
        pitch: float,
        yaw: float,
        translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Self:
        """Return the rotation about the fixed axes X, Y, Z in this order [rad], as in URDF."""
        if not all(map(math.isfinite, (roll, pitch, yaw))):
            raise InvalidArgumentError(
                f"roll {roll}, pitch {pitch} and yaw {yaw} are not all finite; give angles in rad"
            )
        sr, cr = math.sin(roll / 2), math.cos(roll / 2)
        sp, cp = math.sin(pitch / 2), math.cos(pitch / 2)
        sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
        rotation = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return cls(translation, rotation)

    def __matmul__(self, other: Transform) -> Transform:
        """Return the transform that applies `other` and then this one."""
        if not isinstance(other, Transform):
            return NotImplemented
        return Transform.from_motion(rigid_motion.compose(self.motion, other.motion))

    @property
    def motion(self) -> Motion:
        """The seven numbers: x, y, z [m] and the quaternion x, y, z, w."""
        return (*self.translation, *self.rotation)

    def inverse(self) -> Transform:
        """Return the transform in the other direction, source <- target."""
        return Transform.from_motion(rigid_motion.invert(self.motion))

    def interpolate(self, other: Transform, fraction: float) -> Transform:
        """Return the transform between this one (0) and another one (1).

        The translation is interpolated linearly, the rotation by slerp on the shorter way.
        """
        return Transform.from_motion(rigid_motion.interpolate(self.motion, other.motion, fraction))

    def apply(self, points: ArrayLike) -> Array:
        """Return points of the source frame, (3,) or (n, 3) [m], in the target frame.

        Raises `InvalidArgumentError` for arrays of another shape.
        """
        array = np.asarray(points, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != 3:
            raise InvalidArgumentError(
                f"points have the shape {array.shape}; give an array of the shape (n, 3) or (3,)"
            )
        moved: Array = array @ self.rotation_matrix().T + np.array(self.translation)
        return moved

    def rotation_matrix(self) -> Array:
        """Return the rotation as a matrix (3, 3)."""
        x, y, z, w = self.rotation
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    def matrix(self) -> Array:
        """Return the homogeneous matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation_matrix()
        matrix[:3, 3] = self.translation
        return matrix

    def pose2d(self) -> tuple[float, float, float]:
        """Return x [m], y [m] and yaw [rad]: the pose of the source in the target's XY plane."""
        x, y, z, w = self.rotation
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return self.translation[0], self.translation[1], yaw

    def roll_pitch_yaw(self) -> tuple[float, float, float]:
        """Return the rotation about the fixed axes X, Y, Z in this order [rad].

        At a pitch of 90 degrees up or down the roll is 0: only its sum or difference with the yaw
        is defined.
        """
        x, y, z, w = self.rotation
        sine = 2 * (w * y - z * x)
        if abs(sine) > _GIMBAL_LOCK:
            yaw = math.copysign(2.0, -sine) * math.atan2(x, w)
            return 0.0, math.copysign(math.pi / 2, sine), math.remainder(yaw, math.tau)
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return roll, math.asin(sine), yaw

    def to_message(self) -> geometry_msgs.Transform:
        """Return the transform as a message."""
        x, y, z, i, j, k, w = self.motion
        return geometry_msgs.Transform(
            translation=geometry_msgs.Vector3(x=x, y=y, z=z),
            rotation=geometry_msgs.Quaternion(x=i, y=j, z=k, w=w),
        )


def checked_motion(
    translation: tuple[float, float, float], rotation: tuple[float, float, float, float]
) -> Motion:
    """Return a translation [m] and a quaternion x, y, z, w as a motion, normalized.

    Raises `InvalidArgumentError` if a number is not finite, or the quaternion has not unit length.
    """
    x, y, z = map(float, translation)
    i, j, k, w = map(float, rotation)
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise InvalidArgumentError(
            f"translation ({x:g}, {y:g}, {z:g}) is not finite; give x, y, z in meters"
        )
    squared = i * i + j * j + k * k + w * w
    if not abs(squared - 1.0) <= QUATERNION_TOLERANCE:  # not for NaN, either
        raise InvalidArgumentError(
            f"quaternion ({i:g}, {j:g}, {k:g}, {w:g}) is not normalized: its length is "
            f"{math.sqrt(squared):g}, not 1; divide it by its length"
        )
    shrink = 1.0 / math.sqrt(squared)
    return x, y, z, i * shrink, j * shrink, k * shrink, w * shrink
