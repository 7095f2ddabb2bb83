"""The models of SCIP scanners that are emulated, and how each describes itself: VV, PP."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from cairn.components.hokuyo_scanner.protocol import check_sum

_MAKER = "Hokuyo Automatic Co.,Ltd."

Line = Literal["usb", "ethernet"]
Generation = Literal["first", "EW", "UST"]

_ALL_HAVE = frozenset(("VV", "PP", "II", "BM", "QT", "RS", "RT", "TM", "GD", "MD"))
_BASIC = _ALL_HAVE | {"SS", "CR", "HS", "GS", "MS"}
_FAST = _BASIC | {"RB", "GE", "ME", "%ST"}
_ETHERNET = _ALL_HAVE | {"RB", "GE", "ME", "HD", "HE", "ND", "NE", "%ST", "%SL"}


@dataclass(frozen=True)
class ScipModel:
    """One model. Angles are counted in steps, `turn_steps` in a full turn, to the left.

    `first`, `front`, `last`: steps of the field of view; `most_step`: the last that may be
    requested. `least_mm`, `most_mm`: as PP reports; nothing farther than `sight_mm` is measured.
    """

    name: str
    label: str
    """Its name in PP and II, before its maker's name."""
    product: str
    firmware: str
    protocol: str
    least_mm: int
    most_mm: int
    sight_mm: int
    turn_steps: int
    first: int
    front: int
    last: int
    most_step: int
    rpm: int
    line: Line
    commands: frozenset[str]
    nothing: int
    """The code in place of a distance where no light comes back."""
    near: int
    """The code for what is nearer than `least_mm`."""
    has_rs232: bool = False
    speaks_scip1: bool = False
    generation: Generation = "first"
    """Decides the words of II, and the statuses of refused commands."""

    @property
    def steps(self) -> int:
        """How many steps are measured: 0 to `most_step`."""
        return self.most_step + 1

    @property
    def turn_s(self) -> float:
        """Time of a turn of its mirror [s]."""
        return 60.0 / self.rpm


_URG = ScipModel(
    name="URG-04LX",
    label="URG-04LX",
    product="SOKUIKI Sensor URG-04LX",
    firmware="3.3.00(24/Apr./2008)",
    protocol="SCIP 2.0",
    least_mm=20,
    most_mm=5600,
    sight_mm=5600,
    turn_steps=1024,
    first=44,
    front=384,
    last=725,
    most_step=768,
    rpm=600,
    line="usb",
    commands=_BASIC | {"DB"},
    nothing=0,
    near=6,
    has_rs232=True,
    speaks_scip1=True,
)


def _fast(
    name: str, most_mm: int, sight_mm: int, generation: Generation, commands: frozenset[str]
) -> ScipModel:
    """Return a model of 270 degrees in 1081 steps, 40 times per second."""
    return ScipModel(
        name=name,
        label=name,
        product=f"SOKUIKI Sensor {'TOP-URG ' if generation == 'first' else ''}{name}",
        firmware="1.18.01(16/Apr./2015)" if generation == "first" else "1.1.0 (2011-09-30)",
        protocol="SCIP 2.0" if generation == "first" else "SCIP 2.2",
        least_mm=20 if most_mm == 30000 else 23,
        most_mm=most_mm,
        sight_mm=sight_mm,
        turn_steps=1440,
        first=0,
        front=540,
        last=1080,
        most_step=1080,
        rpm=2400,
        line="usb" if generation == "first" else "ethernet",
        commands=commands,
        nothing=1,
        near=2,
        generation=generation,
    )


_ALL = (
    _URG,
    replace(
        _URG,
        name="URG-04LX-UG01",
        label="URG-04LX-UG01(Simple-URG)",
        product="SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
        firmware="3.4.03(17/Dec./2012)",
        commands=_BASIC,
        has_rs232=False,
        speaks_scip1=False,
    ),
    replace(
        _URG,
        name="UHG-08LX",
        label="UHG-08LX",
        product="SOKUIKI Sensor UHG-08LX",
        firmware="1.1.00(07/Jul./2008)",
        most_mm=12000,
        sight_mm=8000,
        first=0,
        last=768,
        rpm=900,
        commands=_BASIC | {"GE", "ME"},
        has_rs232=False,
        speaks_scip1=False,
    ),
    _fast("UTM-30LX", 60000, 30000, "first", _FAST),
    _fast("UTM-30LX-EW", 60000, 30000, "EW", _ETHERNET | {"GS", "MS", "HS"}),
    _fast("UST-10LX", 30000, 10000, "UST", _ETHERNET),
    _fast("UST-20LX", 60000, 20000, "UST", _ETHERNET),
)

MODELS = {model.name: model for model in _ALL}


def version_lines(model: ScipModel, serial_number: str) -> list[bytes]:
    """Return the lines of VV."""
    return [
        field_line("VEND", _MAKER),
        field_line("PROD", model.product),
        field_line("FIRM", model.firmware),
        field_line("PROT", model.protocol),
        field_line("SERI", serial_number),
    ]


def spec_lines(model: ScipModel) -> list[bytes]:
    """Return the lines of PP; a UST adds one that others do not have."""
    return [
        model_line(model),
        field_line("DMIN", str(model.least_mm)),
        field_line("DMAX", str(model.most_mm)),
        *([field_line("PROT", model.protocol)] if model.generation == "UST" else []),
        field_line("ARES", str(model.turn_steps)),
        field_line("AMIN", str(model.first)),
        field_line("AMAX", str(model.last)),
        field_line("AFRT", str(model.front)),
        field_line("SCAN", str(model.rpm)),
    ]


def model_line(model: ScipModel) -> bytes:
    """Return the line of PP and II with the name of the model."""
    return field_line("MODL", f"{model.label}({_MAKER})")


def field_line(key: str, value: str, *, sums_arrow: bool = True) -> bytes:
    """Return a line of VV, PP or II; its semicolon is not in its sum."""
    text = f"{key}:{value}".encode()
    summed = text if sums_arrow else text.partition(b"<-")[0]
    return text + b";" + check_sum(summed)
