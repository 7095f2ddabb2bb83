"""What an emulated sensor tells of itself: VV, PP, II."""

from __future__ import annotations

from dataclasses import dataclass

from components.hokuyo.emulated_models import ScipModel
from components.hokuyo.emulated_text import fact

_MAKER = "Hokuyo Automatic Co.,Ltd."


@dataclass(frozen=True)
class Condition:
    """How the sensor is at a moment."""

    laser: bool
    measures: str
    rpm: int
    turned_down: bool
    baud: int | None
    time_ms: int
    diagnosis: str


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
    """The lines of PP."""
    return [
        fact("MODL", f"{model.name}({_MAKER})"),
        fact("DMIN", str(model.least_mm)),
        fact("DMAX", str(model.most_mm)),
        fact("ARES", str(model.turn_steps)),
        fact("AMIN", str(model.first)),
        fact("AMAX", str(model.last)),
        fact("AFRT", str(model.front)),
        fact("SCAN", str(model.rpm)),
    ]


def state(model: ScipModel, condition: Condition) -> list[bytes]:
    """The lines of II."""
    speed = f"{'Changed' if condition.turned_down else 'Initial'}({condition.rpm}[rpm])"
    line = "Ethernet 100[Mbps]" if model.line == "ethernet" else "USB only"
    if condition.baud is not None:
        line = f"{condition.baud}[bps]"
    default = "<-Default setting by user"
    summed = not model.arrows_unsummed
    return [
        fact("MODL", f"{model.name}({_MAKER})"),
        fact("LASR", "ON" if condition.laser else "OFF"),
        fact("SCSP", f"{speed}{default}", arrow_summed=summed),
        fact("MESM", condition.measures),
        fact("SBPS", f"{line}{default}", arrow_summed=summed),
        fact("TIME", f"{condition.time_ms:06X}"),
        fact("STAT", condition.diagnosis),
    ]
