"""`cairn driver probe hokuyo`: identifies a scanner, and draws what it measures."""

from __future__ import annotations

import math
import queue
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Annotated, Any

import numpy as np
import typer
from pydantic import ValidationError
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text
from serial.tools import list_ports

from cairn import CairnError
from cairn.components.hokuyo_scanner.config import HokuyoConfig
from cairn.components.hokuyo_scanner.health import health_values, nominal_hz
from cairn.components.hokuyo_scanner.messages import ScanMessages
from cairn.components.hokuyo_scanner.sensor import Measurement, StampedScan
from cairn.driver.device_names import TCP
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError
from cairn.runtime.parameters import error_reason
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.terminal.braille import BrailleCanvas
from cairn.terminal.options import Json
from cairn.terminal.output import line, print_json, show

_Scans = queue.Queue[StampedScan | Exception]
"""Scans as they arrive, or the error that ended them."""

_PICTURES_PER_S = 8
_FIRST_SCAN_S = 5.0
_OTHER_LINES = 6  # of the terminal, which the picture leaves free
_ROBOT = "+"
_SHOWN_SHARE = 0.98  # of the ranges that the picture shows, unless --reach is given


def probe(
    device: Annotated[
        str | None,
        typer.Argument(
            metavar="[PORT]",
            help="A serial port: a path, or usb:VENDOR:PRODUCT[:SERIAL]; tcp:HOST[:PORT] for "
            "Ethernet; none: list the serial ports.",
        ),
    ] = None,
    baud: Annotated[int, typer.Option(help="Speed to set an RS-232 line to [bit/s].")] = 115200,
    seconds: Annotated[
        float, typer.Option(min=0.0, max=86400, help="How long to watch [s]; 0: until Ctrl-C.")
    ] = 0.0,
    intensity: Annotated[bool, typer.Option("--intensity", help="Request intensities.")] = False,
    reach: Annotated[
        float | None, typer.Option(min=0.1, max=262, help="How far the picture reaches [m].")
    ] = None,
    json: Json = False,
) -> None:
    """List serial ports; or identify the SCIP scanner on one, and draw its scans.

    For example: cairn driver probe hokuyo /dev/ttyACM0
    """
    if device is None:
        _list(as_json=json)
        return
    config = _config(device, baud, intensity)
    scans: _Scans = queue.Queue()
    with _measuring(config, scans) as measurement:
        first = _first(scans, measurement)
        live = sys.stdout.isatty() and not json
        count, rate = _watch(scans, measurement, first, seconds or None, reach, live=live)
        values = health_values(measurement, rate)
        nominal = nominal_hz(measurement)
    if json:
        print_json(
            {
                name: value if isinstance(value, float | int) else str(value)
                for name, value in values.items()
            }
        )
        return
    for name, value in values.items():
        line(f"{name:28} {value:.4g}" if isinstance(value, float) else f"{name:28} {value}")
    line(f"{count} scans received, {rate:.2f} per second (nominal: {nominal:.2f})")


def _list(*, as_json: bool) -> None:
    rows = [
        {
            "port": port.device,
            "usb": f"usb:{port.vid:04x}:{port.pid:04x}" if port.vid is not None else "",
            "serial": port.serial_number or "",
            "description": "" if port.description == "n/a" else port.description,
        }
        for port in sorted(list_ports.comports())
    ]
    columns = ("port", "usb", "serial", "description")
    nothing = "no serial port found; for Ethernet: cairn driver probe hokuyo tcp:HOST"
    show(rows, columns, as_json=as_json, nothing=nothing)


def _config(device: str, baud: int, intensity: bool) -> HokuyoConfig:
    settings: dict[str, Any] = {"intensity": intensity}
    if device.startswith(TCP):
        host, _, port = device.removeprefix(TCP).partition(":")
        settings |= {"host": host} | ({"tcp_port": port} if port else {})
    else:
        settings |= {"port": device, "baud": baud}
    try:
        return HokuyoConfig.model_validate(settings)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        named = ".".join(map(str, first["loc"])) or device
        raise CairnError(f"{named} = {first['input']!r}: {error_reason(first)}") from error


@contextmanager
def _measuring(config: HokuyoConfig, scans: _Scans) -> Iterator[Measurement]:
    """Have a sensor measure within the context; its laser is off afterwards."""
    measurement = Measurement(config, scans.put)
    with Console(stderr=True).status("looking for a SCIP sensor ..."):
        measurement.connect()
    stopping = threading.Event()

    def run() -> None:
        try:
            measurement.run(stopping, lambda _: None)
        except Exception as error:  # raised by `_next` in the main thread
            scans.put(error)

    thread = threading.Thread(target=run, name="probe", daemon=True)
    thread.start()
    try:
        yield measurement
    finally:
        stopping.set()
        thread.join()
        measurement.disconnect()


def _next(scans: _Scans, timeout_s: float) -> StampedScan | None:
    """Return the next scan, None if none arrives in time; raises the error that ended them."""
    try:
        found = scans.get(timeout=timeout_s)
    except queue.Empty:
        return None
    if isinstance(found, Exception):
        raise found
    return found


def _first(scans: _Scans, measurement: Measurement) -> StampedScan:
    first = _next(scans, _FIRST_SCAN_S)
    if first is None:
        damage = measurement.parser.last_damage
        raise DeviceError(
            f"no scan within {_FIRST_SCAN_S:g} s; "
            + (f"the last damage: {damage}" if damage else "check cable and power supply")
        )
    return first


def _watch(
    scans: _Scans,
    measurement: Measurement,
    newest: StampedScan,
    seconds: float | None,
    reach: float | None,
    *,
    live: bool,
) -> tuple[int, float]:
    """Receive scans until the time is over or Ctrl-C; return their number and rate [Hz]."""
    console = Console(highlight=False)
    window, started, count = RateWindow(), time.monotonic(), 1
    window.note(started)
    if seconds is None and not live:
        seconds = 3.0  # without a terminal there is nothing to watch
    rate = 0.0
    picture = Live(console=console, auto_refresh=False, screen=False) if live else nullcontext()
    try:
        with picture as shown:
            while seconds is None or time.monotonic() - started < seconds:
                due = time.monotonic() + 1.0 / _PICTURES_PER_S
                while (left := due - time.monotonic()) > 0:
                    found = _next(scans, left)
                    if found is None:
                        break
                    newest = found
                    count += 1
                    window.note(time.monotonic())
                rate = window.hz(time.monotonic())
                if shown is not None:
                    shown.update(_view(newest, measurement, rate, reach, console), refresh=True)
    except KeyboardInterrupt:
        pass  # the usual end
    return count, rate


def _view(
    scan: StampedScan, measurement: Measurement, rate: float, reach: float | None, console: Console
) -> Group:
    spec = scan.sensor.spec
    message = ScanMessages(spec, scan.request).scan(scan.data, Header(), "first")
    size = (console.width, max(5, console.height - _OTHER_LINES))
    picture, shown_reach = draw_scan(message, size, reach)
    head = (
        f"{spec.model}  {message.ranges.size} rays  {rate:.1f} of "
        f"{nominal_hz(measurement):.1f} scans per second  "
        f"{measurement.parser.damaged} damaged"
    )
    foot = f"ahead is up; the edge is {shown_reach:.3g} m away; Ctrl-C stops"
    return Group(Text(head, style="bold"), Text(picture), Text(foot, style="dim"))


def draw_scan(
    scan: LaserScan, size: tuple[int, int], reach: float | None = None
) -> tuple[str, float]:
    """Draw a scan from above, ahead up, the scanner in the middle; return picture and reach [m].

    `size`: columns and lines of the picture. Without `reach` [m] it shows nearly all ranges.
    """
    columns, lines = size
    angles = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    hit = np.isfinite(scan.ranges)
    ranges, angles = scan.ranges[hit], angles[hit]
    if reach is None:
        reach = 1.05 * float(np.quantile(ranges, _SHOWN_SHARE)) if ranges.size else scan.range_max
    canvas = BrailleCanvas(columns, lines)
    dots = np.array(canvas.dots)
    meter = 0.5 * (dots.min() - 1) / reach
    ahead = np.column_stack((np.sin(angles), np.cos(angles)))
    canvas.add(0.5 * (dots - 1) - meter * ranges[:, None] * ahead)
    canvas.put(dots[0] // 2, dots[1] // 2, _ROBOT)
    return canvas.text(), math.ceil(reach * 100) / 100
