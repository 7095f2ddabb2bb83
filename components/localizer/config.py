"""The parameters of the localizer."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cairn import Config, FromRobot, Mount
from cairn.components.localizer.landmark_evidence import SimilarityMode
from cairn.components.localizer.odometry import CommandedTrack, MeasuredTrack, OdometryTrack
from cairn.planar.motion_model import MotionModel

# How objects are fused: by their reliability, or each as if it certainly stood in its position.
ObjectFusion = Literal["reliability", "certain"]


@dataclass(frozen=True)
class LocalizationSettings:
    """The parameters of the algorithm; units in the names or in `LocalizerConfig`."""

    particles: int = 400
    most_particles: int = 20_000
    leave_one_out_filters: int = 16
    leave_one_out_particles: int = 400
    search_particles: int = 20_000
    independence: float = 0.15
    scan_share: float = 0.35
    beams: int = 60
    beam_sd_m: float = 0.1
    stray: float = 0.05
    mode: SimilarityMode = "lr"
    fusion: ObjectFusion = "reliability"
    ring_samples: int = 300
    healthy_spread_m: float = 0.35
    motion: MotionModel = field(default_factory=MotionModel)


class StartPose(Config):
    """The robot's pose in the map at the origin of the odometry frame."""

    x: float = Field(ge=-1e5, le=1e5, description="x [m].")
    y: float = Field(ge=-1e5, le=1e5, description="y [m].")
    theta: float = Field(ge=-2 * math.pi, le=2 * math.pi, description="Heading [rad].")
    position_sd: float = Field(0.05, gt=0, le=5, description="Standard deviation of x and y [m].")
    heading_sd: float = Field(0.03, gt=0, le=3, description="Standard deviation of theta [rad].")


class CommandedBase(Config):
    """A base whose odometry holds the commanded velocities."""

    kind: Literal["commanded"] = Field(description="Velocities of odometry are commands.")
    lag_s: float = Field(0.17, ge=0, le=1, description="Delay of the base behind a command [s].")
    forward_gain: float = Field(
        0.95, gt=0, le=2, description="Distance performed per distance commanded [1]."
    )
    turn_gain: float = Field(
        0.93, gt=0, le=2, description="Angle performed per angle commanded [1]."
    )
    forward_noise: float = Field(
        0.025, ge=0, le=1, description="Random walk of the distance while moving [m/sqrt(s)]."
    )
    turn_noise: float = Field(
        0.04, ge=0, le=1, description="Random walk of the heading while moving [rad/sqrt(s)]."
    )

    def track(self) -> OdometryTrack:
        """Return a track that interprets its odometry."""
        return CommandedTrack(self.lag_s, self.forward_gain, self.turn_gain)

    def model(self) -> MotionModel:
        """Return the noise of its motion."""
        return MotionModel(self.forward_noise, self.turn_noise)


class MeasuredBase(Config):
    """A base whose odometry is measured by its wheels."""

    kind: Literal["measured"] = Field("measured", description="Odometry is measured by wheels.")
    forward_slip: float = Field(
        0.02, ge=0, le=1, description="Random walk of the distance [m/sqrt(m)]."
    )
    turn_slip: float = Field(
        0.04, ge=0, le=1, description="Random walk of the heading in turns [rad/sqrt(rad)]."
    )
    turn_per_meter: float = Field(
        0.03, ge=0, le=1, description="Random walk of the heading on the way [rad/sqrt(m)]."
    )

    def track(self) -> OdometryTrack:
        """Return a track that interprets its odometry."""
        return MeasuredTrack()

    def model(self) -> MotionModel:
        """Return the noise of its motion."""
        return MotionModel(0.0, 0.0, self.forward_slip, self.turn_slip, self.turn_per_meter)


class LocalizerConfig(Config):
    """Parameters of the localizer."""

    start: StartPose | None = Field(
        None, description="Known start pose; none: search the map for the robot."
    )
    resume_file: Path | None = Field(
        None,
        description="File of the last pose, from which a localizer that is restarted within a "
        "minute continues; none: it starts at `start` again.",
    )
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Field(
        Mount(), description="Pose of the scanner on the robot."
    )
    particles: int = Field(
        500, ge=50, le=20_000, description="Least number of particles while located [1]."
    )
    most_particles: int = Field(
        20_000, ge=50, le=200_000, description="Most particles, if they are spread out [1]."
    )
    leave_one_out_filters: int = Field(
        16, ge=0, le=256, description="Objects that have a filter without them [1]."
    )
    leave_one_out_particles: int = Field(
        400, ge=50, le=20_000, description="Particles of such a filter [1]."
    )
    search_particles: int = Field(
        20_000, ge=1000, le=500_000, description="Least poses drawn in a global search [1]."
    )
    independence: float = Field(
        0.15,
        gt=0,
        le=1,
        description="Share of an observation's log-likelihood that counts, as the errors of "
        "successive observations repeat [1].",
    )
    beams: int = Field(60, ge=10, le=5000, description="Beams of a scan that are used [1].")
    beam_sd: float = Field(
        0.1, ge=0.01, le=1, description="Deviation of a beam's end from the mapped obstacle [m]."
    )
    stray: float = Field(
        0.05, gt=0, lt=1, description="Share of beams that hit what the map does not hold [1]."
    )
    scan_share: float = Field(
        0.35,
        gt=0,
        le=1,
        description="Share of the log-likelihood of 60 beams that counts, as their errors repeat "
        "[1].",
    )
    mode: SimilarityMode = Field(
        "lr",
        description="Similarity by likelihood ratio (lr), or by new samples as in the paper.",
    )
    fusion: ObjectFusion = Field(
        "reliability",
        description="Objects influence the pose by their reliability; for comparison: as if all "
        "certainly stood where the map says.",
    )
    ring_samples: int = Field(
        300, ge=50, le=10_000, description="New samples around an object in mode paper [1]."
    )
    healthy_spread: float = Field(
        0.35,
        gt=0,
        le=5,
        description="Position deviation up to which objects are compared with the pose [m].",
    )
    hold_s: float = Field(
        1.5, ge=0, le=5, description="How long a message waits for odometry to reach it [s]."
    )
    base: MeasuredBase | CommandedBase = Field(
        MeasuredBase(), discriminator="kind", description="How odometry is interpreted."
    )

    def settings(self) -> LocalizationSettings:
        """Return the parameters of the algorithm."""
        return LocalizationSettings(
            particles=self.particles,
            most_particles=max(self.particles, self.most_particles),
            leave_one_out_filters=self.leave_one_out_filters,
            leave_one_out_particles=self.leave_one_out_particles,
            search_particles=self.search_particles,
            independence=self.independence,
            scan_share=self.scan_share,
            beams=self.beams,
            beam_sd_m=self.beam_sd,
            stray=self.stray,
            mode=self.mode,
            fusion=self.fusion,
            ring_samples=self.ring_samples,
            healthy_spread_m=self.healthy_spread,
            motion=self.base.model(),
        )
