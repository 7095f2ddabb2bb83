"""Cameras are found by stable names, in sysfs as the kernel lays it out."""

from pathlib import Path

import pytest

from cairn.components.v4l2_camera.camera_names import find_camera, is_name, video_nodes
from cairn.driver.errors import LinkLost
from tests.wording import words_in_order


class Computer:
    """A /sys with cameras plugged in."""

    def __init__(self, folder: Path) -> None:
        self.sysfs = folder / "class"
        self.sysfs.mkdir()
        self._devices = folder / "devices"
        self._count = 0

    def plug_in(self, port: str, name: str, ids: str, serial: str = "", nodes: int = 2) -> None:
        """A USB camera, with a node for images and one for their metadata."""
        device = self._devices / "usb1" / port
        interface = device / f"{port}:1.0"
        interface.mkdir(parents=True)
        vendor, product = ids.split(":")
        (device / "idVendor").write_text(f"{vendor}\n")
        (device / "idProduct").write_text(f"{product}\n")
        if serial:
            (device / "serial").write_text(f"{serial}\n")
        for index in range(nodes):
            self._node(interface, name, index)

    def add_platform(self, name: str) -> None:
        """A camera that is not a USB device."""
        self._node(self._devices / "platform" / "vivid.0", name, self._count)

    def _node(self, device: Path, name: str, index: int) -> None:
        node = device / "video4linux" / f"video{self._count}"
        self._count += 1
        node.mkdir(parents=True)
        (node / "name").write_text(f"{name}\n")
        (node / "index").write_text(f"{index}\n")
        (node / "device").symlink_to(device)
        (self.sysfs / node.name).symlink_to(node)

    def unplug_half(self, node: str) -> None:
        """Take a camera away whose entry is still there, but cannot be read any more."""
        (self.sysfs / node / "name").unlink()
        (self.sysfs / node / "name").mkdir()

    def find(self, name: str) -> str:
        """The node's name of a camera."""
        return find_camera(name, self.sysfs).name


@pytest.fixture
def computer(tmp_path: Path) -> Computer:
    return Computer(tmp_path)


def test_usb_camera_is_found_by_name_ids_and_port(computer: Computer) -> None:
    computer.add_platform("Other")
    computer.plug_in("1-1.2", "UVC Camera", "046d:0825", "A3F0")

    for name in (
        "name:UVC Camera", "usb:046d:0825", "usb:046D:0825:A3F0", "port:1-1.2", "/dev/video1"
    ):  # fmt: skip
        assert computer.find(name) == "video1"


def test_equal_cameras_are_distinguished_by_serial_number_or_port(
    computer: Computer,
) -> None:
    computer.plug_in("1-1", "UVC Camera", "046d:0825", "A")
    computer.plug_in("1-2", "UVC Camera", "046d:0825", "B")

    assert computer.find("usb:046d:0825:B") == "video2"
    assert computer.find("port:1-2") == "video2"
    with pytest.raises(LinkLost, match=r"several such cameras: .*video0.*video2.*port:1-2"):
        computer.find("usb:046d:0825")


def test_cameras_of_one_platform_device_are_found_by_name(computer: Computer) -> None:
    computer.add_platform("vivid-000-vid-cap")
    computer.add_platform("vivid-001-vid-cap")

    assert computer.find("name:vivid-001-vid-cap") == "video1"


def test_missing_camera_is_reported_with_the_available_ones(computer: Computer) -> None:
    computer.plug_in("1-1", "UVC Camera", "046d:0825")

    with pytest.raises(LinkLost, match=words_in_order("name:X", "no such camera", "video0")):
        computer.find("name:X")


def test_camera_unplugged_during_the_search_is_not_found(
    computer: Computer,
) -> None:
    computer.plug_in("1-1", "Going", "046d:0825", nodes=1)
    computer.plug_in("1-2", "Staying", "046d:0826")
    computer.unplug_half("video0")

    assert computer.find("name:Staying") == "video1"
    with pytest.raises(LinkLost, match="name:Going: there is no such camera"):
        computer.find("name:Going")


def test_nodes_are_listed_in_the_order_of_their_numbers(computer: Computer) -> None:
    for number in range(11):
        computer.add_platform(f"camera {number}")

    names = [node.path.name for node in video_nodes(computer.sysfs)]

    assert names == [f"video{number}" for number in range(11)]


@pytest.mark.parametrize(
    ("text", "valid"),
    [
        ("/dev/video0", True), ("name:HD Webcam", True), ("usb:046d:0825", True),
        ("usb:046d:0825:A:3", True), ("port:1-1.2", True), ("port:1", False),
        ("usb:46d:825", False), ("video0", False), ("name:", False), ("", False),
    ],
)  # fmt: skip
def test_invalid_names_are_detected(text: str, valid: bool) -> None:
    assert is_name(text) == valid
