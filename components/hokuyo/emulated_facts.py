"""What an emulated sensor tells of itself: VV, PP, II."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.components.hokuyo.emulated_models import ScipModel
from cairn.components.hokuyo.emulated_text import fact
from cairn.components.hokuyo.scip_text import encode_number

_MAKER = "Hokuyo Automatic Co.,Ltd."
_ETHERNET = "Ethernet 100 [Mbps]"


@dataclass(frozen=True)
class Condition:
    """How the sensor is at a moment. `baud` [bit/s]: of its RS-232 line, if it is on that.

    `trouble`: the number of what is wrong with it; none if it is well. `sums_arrows`: what stands
    from `<-` on in a line is summed up as well.
    """

    laser: bool
    streaming: bool
    sensitive: bool
    rpm: int
    level: int
    baud: int | None
    time_ms: int
    trouble: str | None
    sums_arrows: bool


def version(model: ScipModel, serial_number: str) -> list[bytes]:
    """The lines of VV."""
    return [
        fact("VEND", _MAKER),
        fact("PROD", model.product),
        fact("FIRM", model.firmware),
        fact("PROT", model.protocol),
        fact("SERI", serial_number),
    ]


def parameters(model: ScipModel) -> list[bytes]:
    """The lines of PP; a UST adds one that others do not have."""
    return [
        fact("MODL", f"{model.label}({_MAKER})"),
        fact("DMIN", str(model.least_mm)),
        fact("DMAX", str(model.most_mm)),
        *([fact("PROT", model.protocol)] if model.generation == "UST" else []),
        fact("ARES", str(model.turn_steps)),
        fact("AMIN", str(model.first)),
        fact("AMAX", str(model.last)),
        fact("AFRT", str(model.front)),
        fact("SCAN", str(model.rpm)),
    ]


def state(model: ScipModel, condition: Condition) -> list[bytes]:
    """The lines of II, in the words of each generation of sensors."""
    describe = {"first": _first, "EW": _ew, "UST": _ust}[model.generation]
    speed, measures, line, time, status = describe(condition)
    return [
        fact("MODL", f"{model.label}({_MAKER})"),
        fact("LASR", "ON" if condition.laser else "OFF"),
        fact("SCSP", speed, arrow_summed=condition.sums_arrows),
        fact("MESM", measures),
        fact("SBPS", line, arrow_summed=condition.sums_arrows),
        fact("TIME", time),
        fact("STAT", status),
    ]


def _first(condition: Condition) -> tuple[str, str, str, str, str]:
    default = "<-Default setting by user"
    speed = f"Initial({condition.rpm}[rpm]){default}"
    if condition.level:
        speed = f"{condition.level:02d}%down({condition.rpm}[rpm])"
    mode = "Sensitive" if condition.sensitive else "Normal"
    line = "USB only" if condition.baud is None else f"{condition.baud}[bps]{default}"
    trouble = condition.trouble
    return (
        speed,
        f"Measuring by {mode} Mode" if condition.laser else "IDLE",
        line,
        f"{condition.time_ms:06X}",
        "Sensor works well." if trouble is None else f"Sensor malfunction No.{trouble}",
    )


def _ew(condition: Condition) -> tuple[str, str, str, str, str]:
    measures = "000 Idle"
    if condition.laser:
        measures = "004 Multi_scan" if condition.streaming else "003 Single_scan"
    trouble = condition.trouble
    return (
        str(condition.rpm),
        measures,
        _ETHERNET,
        f"{condition.time_ms:06x}",
        "Stable 000 no error." if trouble is None else f"Error {trouble:0>3}",
    )


def _ust(condition: Condition) -> tuple[str, str, str, str, str]:
    trouble = condition.trouble
    return (
        str(condition.rpm),
        "Measuring by Sensitive Mode",
        _ETHERNET,
        encode_number(condition.time_ms, 4).decode(),
        "sensor is working normally" if trouble is None else f"abnormal {trouble}",
    )
