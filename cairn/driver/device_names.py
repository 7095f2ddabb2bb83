"""How parameters name a device: serial ports, USB numbers, network addresses.

Such parameters carry a mark, so that `cairn doctor` checks the devices of a deployment:

    class GaugeConfig(Config):
        port: SerialPort = Field(description="Serial port of the gauge.")
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from pydantic import BaseModel

from cairn.driver.usb_ports import find_port
from cairn.runtime.parameters import MarkedParameter, marked_parameters

TCP = "tcp:"
"""Prefix of the name of a device on the network: `tcp:HOST:PORT`."""


@dataclass(frozen=True)
class NamesDevice:
    """Marks a parameter whose value names a device: `Annotated[str, NamesDevice(find_port)]`.

    `find` takes the parameter's value and returns the present path of that device, or
    `tcp:HOST:PORT`; it raises `CairnError` if there is no such device.
    """

    find: Callable[[str], str | os.PathLike[str]]


@dataclass(frozen=True)
class NamesHost:
    """Marks a parameter whose value is the address of a device on the network.

    As in `Annotated[str, NamesHost("tcp_port")]`: `port` is the name of the parameter beside it
    that holds the TCP port.
    """

    port: str


SerialPort = Annotated[str, NamesDevice(find_port)]
"""Type of a parameter that names a serial port, by a name that `find_port` takes."""


@dataclass(frozen=True)
class NamedDevice:
    """A device that a deployment names: the parameter that names it, and how to find it now."""

    parameter: str
    find: Callable[[], str]


def devices_named(config: BaseModel) -> Iterator[NamedDevice]:
    """Yield all devices that a driver's parameters name; parameters that are None name none."""
    for device in marked_parameters(config, NamesDevice):
        yield NamedDevice(device.name, partial(_find, device))
    for host in marked_parameters(config, NamesHost):
        yield NamedDevice(host.name, partial(_address, host))


def _find(device: MarkedParameter[NamesDevice]) -> str:
    return str(device.mark.find(device.value))


def _address(host: MarkedParameter[NamesHost]) -> str:
    return f"{TCP}{host.value}:{getattr(host.group, host.mark.port)}"
