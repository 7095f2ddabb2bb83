"""What can be tuned of the localization."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from cairn.components.localizer.judge import Mode
from cairn.components.localizer.motion import MotionModel

# How objects are fused: by their reliability, or each as if it certainly stood in its place.
Fusion = Literal["reliability", "at_its_word"]


@dataclass(frozen=True)
class Settings:
    """What can be tuned; units in the names or in `LocalizerConfig`."""

    particles: int = 400
    most_particles: int = 20_000
    judges: int = 16
    judge_particles: int = 400
    search_particles: int = 20_000
    independence: float = 0.15
    scan_share: float = 0.35
    beams: int = 60
    beam_sd_m: float = 0.1
    stray: float = 0.05
    mode: Mode = "lr"
    fusion: Fusion = "reliability"
    ring_samples: int = 300
    healthy_spread_m: float = 0.35
    motion: MotionModel = field(default_factory=MotionModel)
