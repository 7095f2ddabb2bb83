"""Parameters that name a device, marked as such: so `cairn doctor` can look after the devices."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, get_args

from pydantic import BaseModel

from cairn.driver.ports import find_port

TCP = "tcp:"
"""Begins the name of a device on the network: `tcp:HOST:PORT`."""


@dataclass(frozen=True)
class NamesDevice:
    """Marks a parameter whose value names a device: `Annotated[str, NamesDevice(find_port)]`.

    `find` gives the path of the device of a name now, or `tcp:HOST:PORT`; it raises `CairnError`
    if there is none.
    """

    find: Callable[[str], str | os.PathLike[str]]


@dataclass(frozen=True)
class NamesHost:
    """Marks a parameter whose value is the address of a device on the network.

    `port` is the parameter beside it that has the TCP port.
    """

    port: str


SerialPort = Annotated[str, NamesDevice(find_port)]
"""A serial port, by a name that `cairn.driver.ports.find_port` takes."""


@dataclass(frozen=True)
class NamedDevice:
    """A device that a driver is to use: the parameter that names it, and how it is found now."""

    parameter: str
    find: Callable[[], str]


def devices_named(config: BaseModel) -> Iterator[NamedDevice]:
    """All devices that a driver's parameters name; those that are None name none."""
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            for inner in devices_named(value):
                yield NamedDevice(f"{name}.{inner.parameter}", inner.find)
        elif isinstance(value, str):
            for mark in _marks([*field.metadata, field.annotation]):
                yield NamedDevice(name, _finder(config, value, mark))


def _finder(config: BaseModel, value: str, mark: NamesDevice | NamesHost) -> Callable[[], str]:
    if isinstance(mark, NamesHost):
        return lambda: f"{TCP}{value}:{getattr(config, mark.port)}"
    return lambda: str(mark.find(value))


def _marks(parts: list[Any]) -> Iterator[NamesDevice | NamesHost]:
    """The marks within an annotation, in that of `SerialPort | None` too."""
    for part in parts:
        if isinstance(part, NamesDevice | NamesHost):
            yield part
        else:
            yield from _marks(list(get_args(part)))
