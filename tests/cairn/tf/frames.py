"""Transforms for tests: strategies, messages, and SciPy's rotations as an independent reference."""

import math
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cairn import SECOND, from_ns
from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.std_msgs import Header
from cairn.tf import Transform

Array = NDArray[np.float64]

lengths = st.floats(-100.0, 100.0)
angles = st.floats(-math.pi, math.pi)
transforms = st.builds(
    Transform.from_roll_pitch_yaw, angles, angles, angles, st.tuples(lengths, lengths, lengths)
)


def stamped(
    parent: str, child: str, seconds: float = 0.0, transform: Transform | None = None
) -> TransformStamped:
    """The message of a transform parent <- child; by default of the identity."""
    return TransformStamped(
        header=Header(stamp=from_ns(round(seconds * SECOND)), frame_id=parent),
        child_frame_id=child,
        transform=(transform or Transform()).to_message(),
    )


def at(seconds: float) -> int:
    return round(seconds * SECOND)


def along_x(meters: float) -> Transform:
    return Transform((meters, 0.0, 0.0))


def reference_rotation(transform: Transform) -> Any:
    return Rotation.from_quat(transform.rotation)


def reference_matrix(transform: Transform) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = reference_rotation(transform).as_matrix()
    matrix[:3, 3] = transform.translation
    return matrix


def assert_same(one: Transform, other: Transform) -> None:
    """Assert that both are the same motion, up to rounding; a quaternion may have either sign."""
    np.testing.assert_allclose(reference_matrix(one), reference_matrix(other), atol=1e-9)
