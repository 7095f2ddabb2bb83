"""A line without real time: an emulated RoboClaw in the same thread, with faulty replies."""

from cairn.components.roboclaw_base.client import PacketCounts, RoboclawClient
from cairn.components.roboclaw_base.emulator import EmulatedRoboclaw
from cairn.driver.emulator import FrameFaults


class Line:
    """A `Link` to the emulator. Time passes while a read times out, and by `pass_time`."""

    name = "line"
    paced = False

    def __init__(self, device: EmulatedRoboclaw, faults: FrameFaults | None = None) -> None:
        self._device = device
        self._faults = faults
        self._now = 0.0
        self._received = b""
        self.late: list[bytes] = []
        """Bytes that arrive after the next packet was written, before the reply to it."""
        device.powered_on(self._now)

    def read(self, timeout_s: float) -> bytes:
        received, self._received = self._received, b""
        if not received:
            self.pass_time(timeout_s)
        return received

    def write(self, data: bytes) -> None:
        self._received += b"".join(self.late)
        self.late.clear()
        for frame in self._device.receive(data, self._now):
            self._received += self._faults.apply(frame) if self._faults else frame

    def pass_time(self, seconds: float) -> None:
        self._now += seconds
        self._device.advance(self._now)

    def set_baud(self, baud: int) -> None:
        pass

    def discard(self) -> None:
        self._received = b""

    def close(self) -> None:
        pass


def client_on(
    device: EmulatedRoboclaw, faults: FrameFaults | None = None, tries: int = 4
) -> tuple[RoboclawClient, Line, PacketCounts]:
    """Return a client of the emulator on such a line."""
    line, counts = Line(device, faults), PacketCounts()
    return RoboclawClient(line, 0x80, 115200, counts, tries=tries), line, counts
