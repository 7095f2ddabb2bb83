"""The component of the simulated world: ground truth, which only drivers and tests may read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from logging import INFO, WARNING
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    CairnError,
    Component,
    Config,
    FromRobot,
    In,
    Out,
    RateLimitedLog,
    ReadPath,
    RetriedSave,
    every,
    from_ns,
    has_passed,
    on,
    to_ns,
)
from cairn.components.simulation.layout import geometry_message, true_map
from cairn.components.simulation.state_file import StateFile
from cairn.components.simulation.world import Contact, RobotBody, SlipConfig, World
from cairn.components.simulation.world_checks import visibility_problems, world_problems
from cairn.components.simulation.world_file import (
    Event,
    Furniture,
    Name,
    Person,
    VisibleObject,
    WorldPose,
    describe_errors,
    read_world,
)
from cairn.deployment.shipped import world_file
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.cairn_sim_msgs import FurtherRobot, WheelMotion, WorldGeometry, WorldState
from cairn.schemas.geometry_msgs import Point, PoseStamped
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header

# Wheels without a message for this long [s] count as standing.
_STALE_S = 0.3
_TRUTH_PERIOD_S = 0.1
_LONGEST_STEP_S = 1.0
_APART_NS = SECOND // 10
"""By less than this, the times of the robots' wheels are apart."""
_MOST_ROBOTS = 50


class RobotStart(WorldPose):
    """Where a further robot starts, and its size."""

    radius: float = Field(0.22, gt=0, le=5, description="Radius of the robot [m].")


class WorldConfig(Config):
    """The world and the robots in it."""

    world: ReadPath = Field(
        description="World file (YAML), or the name of a world that Cairn ships."
    )
    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0, le=5, description="Radius of the robot [m]."
    )
    robots: dict[Name, RobotStart] = Field(
        default_factory=dict,
        max_length=_MOST_ROBOTS,
        description="Further robots in this world, by the names of their deployments, whose "
        "simulated drivers use the topics of this world.",
    )
    slip: SlipConfig = Field(SlipConfig(), description="Slip of the wheels.")
    events: tuple[Event, ...] = Field(
        (), description="Events in addition to those of the world file."
    )
    state_file: Path | None = Field(
        None,
        description="File for the state of the world, with which a restarted world continues; "
        "none: it starts again from the world file.",
    )

    @field_validator("world")
    @classmethod
    def _by_name(cls, value: Path) -> Path:
        try:
            return world_file(os.fspath(value))
        except CairnError as error:
            raise ValueError(str(error)) from error


class _Named(Config):
    """A request about a thing with this name."""

    name: Name


class _NamedPose(WorldPose):
    """A request to put a thing with this name to a pose."""

    name: Name


_CHANGES: dict[str, type[Config]] = {
    "move": _NamedPose,
    "remove": _Named,
    "furniture": Furniture,
    "object": VisibleObject,
    "person": Person,
    "kidnap": WorldPose,
}


class SimulatedWorld(Component):
    """Hold the true state of the simulated world and let time pass in it.

    Publishes the layout (`world_geometry`) and what moves (`world_state`) for the drivers; reports
    collisions.

    The robot is round, its wheels may slip, and contacts stop it. People stop before the robot, and
    walk around it after 4 s; they do not avoid each other.
    """

    # A world is changed by requests, not by parameters.
    live_parameters = frozenset()
    config: WorldConfig

    wheel_motion: In[WheelMotion] = In(qos=RELIABLE.with_depth(200))
    kidnap: In[PoseStamped] = In(optional=True)
    world_state: Out[WorldState] = Out(qos=RELIABLE.with_depth(200))
    world_geometry: Out[WorldGeometry] = Out(qos=LATCHED)
    truth: Out[PoseStamped]
    true_map: Out[VisualMap] = Out(qos=LATCHED)
    collisions: Out[Collision] = Out(qos=RELIABLE.with_depth(100))

    def on_configure(self) -> None:
        """Read the world file and check it."""
        config = self.config
        world = read_world(config.world)
        more = [event.with_textures_in(config.world.parent) for event in config.events]
        world = world.model_copy(update={"events": [*world.events, *more]})
        problems = world_problems(world, config.radius)
        if problems:
            raise CairnError(f"{config.world}: " + "; ".join(problems))
        others = [RobotBody(name, one.pose, one.radius) for name, one in config.robots.items()]
        try:
            self._world = World(world, config.radius, config.slip, self.random, self.robot, others)
        except CairnError as error:
            raise CairnError(f"{self.name}: robots: {error}") from error
        self._state_file = StateFile(config.state_file) if config.state_file else None
        self._saved_state = RetriedSave(self, "state of the world")
        self._published_version = -1
        self._started_at = self._advanced_to = self._truth_published_at = 0
        self._wheels_heard_at = dict.fromkeys(self._world.robots, 0)
        self._speeds = dict.fromkeys(self._world.robots, (0.0, 0.0))
        self._warnings = RateLimitedLog(self.log)

    def on_activate(self) -> None:
        """Start, or continue from the saved state after a restart."""
        self._started_at = self._advanced_to = self.clock.now()
        if self.restarts > 0:
            self._resume()
        self._publish_layout()

    @on("wheel_motion")
    def on_wheel_motion(self, motion: WheelMotion) -> None:
        """Move a robot as its wheels turned, and let time pass."""
        robot = motion.robot or self.robot
        if robot not in self._speeds:
            known = ", ".join(self._speeds)
            self._warnings.warn(
                robot,
                f"wheels of {robot}: there is no such robot in this world ({known}); add it "
                "to the parameter robots",
            )
            return
        self._wheels_heard_at[robot] = self.clock.now()
        moved, contacts = self._world.drive(
            motion.seconds, motion.forward, motion.turn, robot, motion.aside
        )
        self._speeds[robot] = (motion.forward if moved else 0.0, motion.turn)
        self._advance_to(to_ns(motion.header.stamp))
        for contact in contacts:
            self._report(contact)

    @on("kidnap")
    def on_kidnap(self, pose: PoseStamped) -> None:
        """Move the robot without turning its wheels."""
        try:
            self._world.kidnap(planar_pose(pose.pose))
        except CairnError as error:
            self.log.error("%s", error)

    @every(hz=20)
    def step(self) -> None:
        """Carry out due events; let time pass while no wheels turn."""
        now = self.clock.now()
        for result in self._world.run_due_events((now - self._started_at) / SECOND):
            self.log.log(INFO if result.succeeded else WARNING, "%s", result.description)
        if self._world.layout.version != self._published_version:
            self._publish_layout()
        for robot, heard_at in self._wheels_heard_at.items():
            if has_passed(_STALE_S, heard_at, now):
                self._speeds[robot] = (0.0, 0.0)
        if has_passed(_STALE_S, max(self._wheels_heard_at.values()), now):
            self._advance_to(now)

    @every(hz=10)
    def save_state(self) -> None:
        """Save the state for a restarted world."""
        if self._state_file is None:
            return
        state_file, elapsed_s = self._state_file, (self.clock.now() - self._started_at) / SECOND
        self._saved_state.attempt(
            lambda: state_file.save(self._world, elapsed_s),
            lambda: "the world starts again from an older state, or from its file",
        )

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer the requests list, move, remove, furniture, object, person and kidnap."""
        if verb == "list" and not arguments:
            return self._list()
        model = _CHANGES.get(verb)
        if model is None:
            return super().on_request(verb, arguments)
        try:
            self._change(model.model_validate(arguments))
        except ValidationError as error:
            raise CairnError(f"{verb}: {describe_errors(error, model)}") from error
        if self._world.layout.version != self._published_version:
            self._publish_layout()
        return None

    def _change(self, change: Config) -> None:
        match change:
            case _NamedPose():
                self._world.move(change.name, change.pose)
            case _Named():
                self._world.remove(change.name)
            case Furniture():
                self._world.add(change)
            case VisibleObject():
                thing = change.with_textures_in(self.config.world.parent)
                problems = visibility_problems(self._world.layout, thing)
                if problems:
                    raise CairnError("; ".join(problems))
                self._world.add(thing)
            case Person():
                self._world.add_person(change)
            case WorldPose():
                self._world.kidnap(change.pose)

    def _list(self) -> list[dict[str, Any]]:
        world = self._world
        rows = [{"kind": "robot", "name": "robot", **_pose_row(world.robot)}]
        others = [body for body in world.robots.values() if body.name != self.robot]
        rows += [{"kind": "robot", "name": one.name, **_pose_row(one.pose)} for one in others]
        for name, piece in world.layout.furniture.items():
            rows.append({"kind": "furniture", "name": name, **_pose_row(piece.pose)})
        for name, thing in world.layout.objects.items():
            rows.append({"kind": "object", "name": name, **_pose_row(thing.pose)})
        for walker in world.walkers:
            place = {"x": walker.x, "y": walker.y, "theta": 0.0}
            rows.append({"kind": "person", "name": walker.person.name, **place})
        return rows

    def _advance_to(self, stamp: int) -> None:
        """Let time pass until a stamp [ns], and publish what moves."""
        if stamp > self._advanced_to - _APART_NS:  # otherwise time was set back
            stamp = max(stamp, self._advanced_to)
        seconds = (stamp - self._advanced_to) / SECOND
        self._world.move_people(min(max(0.0, seconds), _LONGEST_STEP_S))
        self._advanced_to = stamp
        header = Header(stamp=from_ns(stamp), frame_id="map")
        robot = pose_message(self._world.robot)
        self.world_state.publish(
            WorldState(
                header=header,
                robot=robot,
                forward=self._speeds[self.robot][0],
                turn=self._speeds[self.robot][1],
                people=Packed(Point, self._world.people),
                radius=self.config.radius,
                others=tuple(
                    FurtherRobot(
                        name=body.name,
                        pose=pose_message(body.pose),
                        radius=body.radius,
                        forward=self._speeds[body.name][0],
                        turn=self._speeds[body.name][1],
                    )
                    for body in self._world.robots.values()
                    if body.name != self.robot
                ),
            )
        )
        if has_passed(_TRUTH_PERIOD_S, self._truth_published_at, stamp):
            self._truth_published_at = stamp
            self.truth.publish(PoseStamped(header=header, pose=robot))

    def _report(self, contact: Contact) -> None:
        self.log.warning(
            "collision of %s with %s at (%.2f, %.2f), %.2f m/s",
            contact.robot,
            contact.what,
            contact.x,
            contact.y,
            contact.speed,
        )
        self.collisions.publish(
            Collision(
                header=Header(stamp=from_ns(self._advanced_to), frame_id="map"),
                obstacle=contact.what,
                x=contact.x,
                y=contact.y,
                speed=contact.speed,
                robot=contact.robot,
            )
        )

    def _publish_layout(self) -> None:
        layout = self._world.layout
        self._published_version = layout.version
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.world_geometry.publish(geometry_message(header, layout))
        self.true_map.publish(true_map(header, layout))

    def _resume(self) -> None:
        state = self._state_file.load() if self._state_file is not None else None
        if state is None:
            self.log.warning("no saved state of the world: it starts again from its file")
            return
        state.restore(self._world)
        self._started_at = self.clock.now() - round(state.elapsed_s * SECOND)
        self.log.info(
            "restored the saved state of the world: it continues at %.1f s", state.elapsed_s
        )


def _pose_row(pose: Pose) -> dict[str, float]:
    return {"x": pose[0], "y": pose[1], "theta": pose[2]}
