"""`cairn driver probe hokuyo`: finds a scanner out, and draws what it measures."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text
from serial.tools import list_ports

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, print_json, show
from cairn.components.hokuyo import health
from cairn.components.hokuyo.config import HokuyoConfig
from cairn.components.hokuyo.measurement import Measured, Measurement
from cairn.components.hokuyo.scan_message import ScanShape
from cairn.components.hokuyo.scan_picture import drawn
from cairn.driver.device_names import TCP
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError
from cairn.runtime.parameters import error_reason
from cairn.schemas.std_msgs import Header

_Came = queue.SimpleQueue[Measured | Exception]
"""Scans as they come, or what ended them."""

_PICTURES_PER_S = 8
_FIRST_SCAN_S = 5.0
_LINES = 6  # of a terminal, that are not for the picture


def probe(
    device: Annotated[
        str | None,
        typer.Argument(
            metavar="[PORT]",
            help="A serial port: a path, or usb:VENDOR:PRODUCT[:SERIAL]; tcp:HOST[:PORT] for "
            "Ethernet; none: list the serial ports.",
        ),
    ] = None,
    baud: Annotated[
        int, typer.Option(help="Speed that an RS-232 line is to have [bit/s].")
    ] = 115200,
    seconds: Annotated[
        float, typer.Option(min=0.0, max=86400, help="How long to watch [s]; 0: until Ctrl-C.")
    ] = 0.0,
    intensity: Annotated[bool, typer.Option("--intensity", help="Ask for intensities.")] = False,
    reach: Annotated[
        float | None, typer.Option(min=0.1, max=262, help="What the picture reaches [m].")
    ] = None,
    json: Json = False,
) -> None:
    """List serial ports; or find out the SCIP scanner on one, and draw its scans as they come.

    For example: cairn driver probe hokuyo /dev/ttyACM0
    """
    if device is None:
        _list(as_json=json)
        return
    config = _config(device, baud, intensity)
    came: _Came = queue.SimpleQueue()
    with _measuring(config, came) as measurement:
        first = _first(came, measurement)
        live = sys.stdout.isatty() and not json
        scans, rate = _watched(came, measurement, first, seconds or None, reach, live=live)
        told = health.values(measurement, rate)
        nominal = health.nominal_hz(measurement)
    if json:
        print_json(
            {
                name: value if isinstance(value, float | int) else str(value)
                for name, value in told.items()
            }
        )
        return
    for name, value in told.items():
        line(f"{name:28} {value:.4g}" if isinstance(value, float) else f"{name:28} {value}")
    line(f"{scans} scans watched, {rate:.2f} a second; {nominal:.2f} should come")


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
    nothing = "no serial port is there; a scanner on Ethernet: cairn driver probe hokuyo tcp:HOST"
    show(rows, columns, as_json=as_json, nothing=nothing)


def _config(device: str, baud: int, intensity: bool) -> HokuyoConfig:
    asked: dict[str, Any] = {"intensity": intensity}
    if device.startswith(TCP):
        host, _, port = device.removeprefix(TCP).partition(":")
        asked |= {"host": host} | ({"tcp_port": port} if port else {})
    else:
        asked |= {"port": device, "baud": baud}
    try:
        return HokuyoConfig.model_validate(asked)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        named = ".".join(map(str, first["loc"])) or device
        raise CairnError(f"{named} = {first['input']!r}: {error_reason(first)}") from error


@contextmanager
def _measuring(config: HokuyoConfig, came: _Came) -> Iterator[Measurement]:
    """A sensor that measures; when this is left its laser is off."""
    measurement = Measurement(config, came.put)
    with Console(stderr=True).status("looking for a SCIP sensor there ..."):
        measurement.connect()
    stopping = threading.Event()

    def converse() -> None:
        try:
            measurement.converse(stopping, lambda _: None)
        except Exception as error:  # raised by whoever waits for the next scan
            came.put(error)

    thread = threading.Thread(target=converse, name="probe", daemon=True)
    thread.start()
    try:
        yield measurement
    finally:
        stopping.set()
        thread.join()
        measurement.disconnect()


def _next(came: _Came, limit_s: float) -> Measured | None:
    """The next scan, None if none comes in time; raises what has ended them."""
    try:
        found = came.get(timeout=limit_s)
    except queue.Empty:
        return None
    if isinstance(found, Exception):
        raise found
    return found


def _first(came: _Came, measurement: Measurement) -> Measured:
    first = _next(came, _FIRST_SCAN_S)
    if first is None:
        damage = measurement.stream.last_damage
        raise DeviceError(
            f"no scan within {_FIRST_SCAN_S:g} s"
            + (f"; the last damage: {damage}" if damage else "")
        )
    return first


def _watched(
    came: _Came,
    measurement: Measurement,
    newest: Measured,
    seconds: float | None,
    reach: float | None,
    *,
    live: bool,
) -> tuple[int, float]:
    """How many scans came, and how many a second, until the time is over or Ctrl-C."""
    console = Console(highlight=False)
    window, begun, scans = RateWindow(), time.monotonic(), 1
    window.note(begun)
    if seconds is None and not live:
        seconds = 3.0  # nobody looks
    rate = 0.0
    picture = Live(console=console, auto_refresh=False, screen=False) if live else nullcontext()
    try:
        with picture as shown:
            while seconds is None or time.monotonic() - begun < seconds:
                due = time.monotonic() + 1.0 / _PICTURES_PER_S
                while (left := due - time.monotonic()) > 0:
                    found = _next(came, left)
                    if found is None:
                        break
                    newest = found
                    scans += 1
                    window.note(time.monotonic())
                rate = window.hz(time.monotonic())
                if shown is not None:
                    shown.update(_view(newest, measurement, rate, reach, console), refresh=True)
    except KeyboardInterrupt:
        pass  # that is how watching ends
    return scans, rate


def _view(
    measured: Measured, measurement: Measurement, rate: float, reach: float | None, console: Console
) -> Group:
    measuring = measured.sensor.measuring
    scan = ScanShape(measuring, measured.request).scan(measured.data, Header(), "first")
    size = (console.width, max(5, console.height - _LINES))
    picture, shown_reach = drawn(scan, size, reach)
    head = (
        f"{measuring.model}  {scan.ranges.size} rays  {rate:.1f} of "
        f"{health.nominal_hz(measurement):.1f} scans a second  "
        f"{measurement.stream.damaged} damaged"
    )
    foot = f"ahead is up; the edge is {shown_reach:.3g} m away; Ctrl-C ends it"
    return Group(Text(head, style="bold"), Text(picture), Text(foot, style="dim"))
