"""Left and right images of the same stamp, the newest alone."""

from __future__ import annotations

from dataclasses import dataclass

from cairn import SECOND
from cairn.schemas.sensor_msgs import Image

PATIENCE_NS = SECOND
"""How long left images wait in vain for right ones before they are taken alone."""


@dataclass(frozen=True)
class Pair:
    """A left image, and the right one that was taken at the same time, if there is one."""

    stamp_ns: int
    left: Image
    right: Image | None


class Pairing:
    """Holds at most one image of each side: what is not paired when a newer one comes is lost."""

    def __init__(self, *, stereo: bool) -> None:
        self._stereo = stereo
        self._left: tuple[int, Image] | None = None
        self._right: tuple[int, Image] | None = None
        self._alone: int | None = None
        self._waiting_since: int | None = None

    def right_is_missing(self, now_ns: int) -> bool:
        """Whether images are taken without their right ones, which no longer come."""
        since = self._waiting_since
        return self._stereo and since is not None and now_ns - since > PATIENCE_NS

    def take_left(self, stamp_ns: int, image: Image, now_ns: int) -> Pair | None:
        """What can be looked at now that this image has come."""
        self._left = (stamp_ns, image)
        pair = self._pair()
        if pair is not None:
            return pair
        if self._waiting_since is None or now_ns < self._waiting_since:  # time may be set back
            self._waiting_since = now_ns
        if self._stereo and not self.right_is_missing(now_ns):
            return None
        self._left, self._alone = None, stamp_ns
        return Pair(stamp_ns, image, None)

    def take_right(self, stamp_ns: int, image: Image) -> Pair | None:
        """What can be looked at now that this image has come."""
        self._right = (stamp_ns, image)
        if stamp_ns == self._alone:
            self._waiting_since = None  # they come again
        return self._pair()

    def _pair(self) -> Pair | None:
        left, right = self._left, self._right
        if left is None or right is None or left[0] != right[0]:
            return None
        self._left = self._right = self._waiting_since = None
        return Pair(left[0], left[1], right[1])
