"""The errors of the transform buffer, as those of tf2."""

from cairn.errors import CairnError


class TransformError(CairnError):
    """A transform is not available, or is not valid."""


class UnknownFrameError(TransformError):
    """No transform names this frame (`LookupException` of tf2)."""


class ConnectivityError(TransformError):
    """The frames are in two trees, or form a loop (`ConnectivityException` of tf2)."""


class InvalidArgumentError(TransformError):
    """A frame name, a time or a transform is not valid (`InvalidArgumentException` of tf2)."""


class BufferFullError(TransformError):
    """A transform names a new frame, but the buffer has its largest number of frames."""


class RobotDescriptionError(TransformError):
    """A robot description is not valid URDF, or too large."""


class ExtrapolationError(TransformError):
    """The time is before the oldest or after the newest transform of a frame on the path.

    The class of tf2 is `ExtrapolationException`.

    Attributes:
        parent: parent frame of the edge without data at that time.
        child: child frame of that edge.
        requested_ns: the requested time [ns].
        oldest_ns: stamp of the oldest transform of the edge [ns].
        newest_ns: stamp of its newest transform [ns].
    """

    def __init__(
        self,
        message: str,
        parent: str,
        child: str,
        requested_ns: int,
        oldest_ns: int,
        newest_ns: int,
    ) -> None:
        super().__init__(message)
        self.parent = parent
        self.child = child
        self.requested_ns = requested_ns
        self.oldest_ns = oldest_ns
        self.newest_ns = newest_ns
