"""A line without time: an emulated RoboClaw in the same thread, with faults in its replies."""

from cairn.components.roboclaw.dialogue import Dialogue, DialogueCounts
from cairn.components.roboclaw.emulator import EmulatedRoboclaw
from cairn.driver.emulator import FrameFaults


class Line:
    """A `Link` to it. Time passes when nobody answers, and by `pass_time`."""

    name = "line"
    paced = False

    def __init__(self, device: EmulatedRoboclaw, faults: FrameFaults | None = None) -> None:
        self._device = device
        self._faults = faults
        self._now = 0.0
        self._came = b""
        self.late: list[bytes] = []
        """What arrives after the next packet was written, before the reply to it."""
        device.powered_on(self._now)

    def read(self, limit_s: float) -> bytes:
        came, self._came = self._came, b""
        if not came:
            self.pass_time(limit_s)
        return came

    def write(self, data: bytes) -> None:
        self._came += b"".join(self.late)
        self.late.clear()
        for frame in self._device.receive(data, self._now):
            self._came += self._faults.apply(frame) if self._faults else frame

    def pass_time(self, seconds: float) -> None:
        self._now += seconds
        self._device.advance(self._now)

    def set_baud(self, baud: int) -> None:
        pass

    def discard(self) -> None:
        self._came = b""

    def close(self) -> None:
        pass


def dialogue_with(
    device: EmulatedRoboclaw, faults: FrameFaults | None = None, tries: int = 4
) -> tuple[Dialogue, Line, DialogueCounts]:
    """A dialogue with it, over such a line."""
    line, counts = Line(device, faults), DialogueCounts()
    return Dialogue(line, 0x80, 115200, counts, tries=tries), line, counts
