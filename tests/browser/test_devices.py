"""The panels Camera and Diagnostics in Chromium, with messages as drivers publish them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cairn.bus.codec import Codec
from cairn.bus.type_hash import definition
from cairn.console.source import Channel, Message
from cairn.schemas.cairn_msgs import ComponentStatus, RecognizedObject, RecognizedObjectArray
from cairn.schemas.diagnostic_msgs import DiagnosticArray, DiagnosticStatus, KeyValue
from cairn.schemas.message import type_name
from cairn.schemas.sensor_msgs import Image
from tests.browser.conftest import OpenTab, Tab
from tests.cairn.bus.network import eventually
from tests.cairn.console.conftest import FakeSource, Running, running

TOPICS = {
    "component_status": ComponentStatus,
    "left_image": Image,
    "recognized_objects": RecognizedObjectArray,
    "diagnostics": DiagnosticArray,
}
WIDTH, HEIGHT = 64, 48
ORANGE = (220, 120, 20)


class Devices:
    """A console of a robot whose devices publish what a test says."""

    def __init__(self, console: Running, source: FakeSource) -> None:
        self.url = console.console.url
        self._console, self._source = console, source
        self._ids = {name: id_ for id_, name in enumerate(TOPICS, 1)}
        channels = [
            Channel(id_, f"/robot/{name}", type_name(TOPICS[name]), definition(TOPICS[name]))
            for name, id_ in self._ids.items()
        ]
        console.call(console.hub.set_channels, channels)

    def publish(self, name: str, message: Any) -> None:
        """Publish a message once the page reads its topic."""
        assert eventually(lambda: f"/robot/{name}" in self._source.subscribed)
        sent = Message(time.time_ns(), Codec().encode(message))
        self._console.call(self._console.hub.deliver, self._ids[name], sent)


@pytest.fixture
def devices() -> Iterator[Devices]:
    source = FakeSource()
    with running(source) as console:
        yield Devices(console, source)


def test_camera_shows_the_image_with_recognized_objects_outlined(
    devices: Devices, open_tab: OpenTab
) -> None:
    tab = open_tab(devices.url)
    tab.show("Camera")
    pixels = np.full((HEIGHT, WIDTH, 3), ORANGE, np.uint8)
    image = Image(height=HEIGHT, width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=pixels.ravel())
    devices.publish("left_image", image)
    tab.page.get_by_text(f"{WIDTH} \u00d7 {HEIGHT}").wait_for()
    assert pixel(tab, ".camera canvas") == pytest.approx((*ORANGE, 255), abs=8)
    assert not has_outline(tab)

    corners = np.array([10, 10, 50, 10, 50, 40, 10, 40], np.float64)
    seen = RecognizedObject(object_id=7, range=2.0, bearing=0.1, corners=corners)

    def outlined() -> bool:  # for a second after each message
        devices.publish("recognized_objects", RecognizedObjectArray(objects=(seen,)))
        return has_outline(tab) and tab.page.get_by_role("cell", name="object 7").is_visible()

    assert eventually(outlined)


def pixel(tab: Tab, canvas: str) -> tuple[int, ...]:
    """Return red, green, blue and opacity in the middle of a canvas."""
    return tuple(
        tab.page.evaluate(
            """(selector) => {
                const canvas = document.querySelector(selector);
                const [x, y] = [canvas.width / 2, canvas.height / 2];
                return [...canvas.getContext("2d").getImageData(x, y, 1, 1).data];
            }""",
            canvas,
        )
    )


def has_outline(tab: Tab) -> bool:
    """Return whether anything is drawn over the image."""
    return bool(
        tab.page.evaluate(
            """() => {
                const canvas = document.querySelector(".camera .overlay");
                const {width, height} = canvas;
                const {data} = canvas.getContext("2d").getImageData(0, 0, width, height);
                return data.some((value) => value > 0);
            }"""
        )
    )


def test_diagnostics_show_errors_first_and_what_is_silent_as_a_warning(
    devices: Devices, open_tab: OpenTab
) -> None:
    tab = open_tab(devices.url)
    tab.show("Diagnostics")
    imu = DiagnosticStatus(name="imu", message="calibrated", hardware_id="BNO085")
    lidar = DiagnosticStatus(
        level=DiagnosticStatus.ERROR,
        name="lidar",
        message="the mirror does not turn",
        values=(KeyValue(key="speed", value="0 rpm"),),
    )
    devices.publish("diagnostics", DiagnosticArray(status=(imu, lidar)))

    rows = tab.page.get_by_role("list", name="Diagnostics").get_by_role("listitem")
    rows.filter(has_text="imu").get_by_text("ok", exact=True).wait_for()
    assert [one.split()[0] for one in rows.all_inner_texts()] == ["lidar", "imu"]
    rows.first.get_by_role("button").click()
    rows.first.get_by_text("0 rpm").wait_for()

    tab.page.get_by_text("1 stale").wait_for()
    assert not rows.locator(".muted").get_by_text("calibrated").is_visible()
    amber = tab.page.evaluate(
        """() => {
            const probe = document.body.appendChild(document.createElement("span"));
            probe.style.color = "var(--warning)";
            return getComputedStyle(probe).color;
        }"""
    )
    for words in ("stale", "calibrated"):
        shown = rows.filter(has_text="imu").get_by_text(words, exact=True)
        assert shown.evaluate("one => getComputedStyle(one).color") == amber
