"""Serial devices on cables that a test can pull: both ends of the line, and its plug."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.hardware.guest import modules, qemu
from tests.hardware.guest.uevents import DeviceEvents

_GADGETS = Path("/sys/kernel/config/usb_gadget")


class Cable(ABC):
    """A serial device as the kernel sees it, and the line's far end.

    Attributes:
        port: what a driver opens: `/dev/ttyACM0`.
        stable: the same under its stable name: `/dev/serial/by-id/...`.
        far_end: a terminal; what is written there is what the driver reads. The emulated device
            belongs there.
    """

    port: Path
    stable: Path
    far_end: Path

    def plug_in(self) -> None:
        """Plug the device in; returns when it is there under both names."""
        with DeviceEvents() as events:
            self._plug_in()
            events.await_node(self.port, there=True)
        modules.settle()
        assert self.stable.exists(), f"udev has no {self.stable} for {self.port}"

    def unplug(self) -> None:
        """Pull the plug; returns when the device has gone."""
        with DeviceEvents() as events:
            self._unplug()
            events.await_node(self.port, there=False)
        modules.settle()

    @abstractmethod
    def _plug_in(self) -> None: ...

    @abstractmethod
    def _unplug(self) -> None: ...


class AcmCable(Cable):
    """A USB device of class CDC-ACM, as a URG-04LX: the kernel's own gadget on its dummy bus.

    When it is unplugged, the far end's terminal is hung up: a process that has it open reads an
    end of file, and has to open it again.
    """

    port = Path("/dev/ttyACM0")
    stable = Path(
        "/dev/serial/by-id/usb-Hokuyo_Data_Flex_for_USB_URG-Series_USB_Driver_H0000001-if00"
    )
    far_end = Path("/dev/ttyGS0")
    _gadget = _GADGETS / "scanner"

    def make(self) -> None:
        """Make the device, with the identity of a Hokuyo scanner."""
        modules.load("dummy_hcd")
        modules.load("libcomposite")
        identity = {
            "idVendor": "0x15d1",
            "idProduct": "0x0000",
            "bDeviceClass": "2",
            "strings/0x409/manufacturer": "Hokuyo Data Flex for USB",
            "strings/0x409/product": "URG-Series USB Driver",
            "strings/0x409/serialnumber": "H0000001",
        }
        for folder in ("strings/0x409", "functions/acm.line", "configs/all.1"):
            (self._gadget / folder).mkdir(parents=True)
        for name, text in identity.items():
            (self._gadget / name).write_text(text)
        (self._gadget / "configs/all.1/acm.line").symlink_to(self._gadget / "functions/acm.line")

    def _plug_in(self) -> None:
        (self._gadget / "UDC").write_text("dummy_udc.0")

    def _unplug(self) -> None:
        (self._gadget / "UDC").write_text("\n")


class FtdiCable(Cable):
    """An RS-232 line behind QEMU's FTDI adapter; its far end stays as it is when that goes."""

    port = Path("/dev/ttyUSB0")
    stable = Path("/dev/serial/by-id/usb-QEMU_QEMU_USB_SERIAL_RS232-if00-port0")
    far_end = Path("/dev/hvc0")

    def _plug_in(self) -> None:
        qemu.add_device("usb-serial", "adapter", chardev="line", serial="RS232", bus="usb.0")

    def _unplug(self) -> None:
        qemu.remove_device("adapter")


@contextmanager
def plugged_in(cable: Cable) -> Iterator[Cable]:
    """The cable, plugged in; pulled at the end if it is still there."""
    if not cable.port.exists():
        cable.plug_in()
    try:
        yield cable
    finally:
        if cable.port.exists():
            cable.unplug()
