"""The component that holds the simulated world: the truth, which only drivers and tests read."""

from __future__ import annotations

from collections.abc import Mapping
from logging import INFO, WARNING
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    ReadPath,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.simulation.checks import problems_of, unseen_problems
from cairn.components.simulation.messages import scene_message, true_map
from cairn.components.simulation.refusals import what_is_wrong
from cairn.components.simulation.state_file import StateFile
from cairn.components.simulation.world import Contact, Slip, World
from cairn.components.simulation.world_file import (
    Event,
    Furniture,
    Name,
    Person,
    Placed,
    VisibleObject,
    read_world,
)
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.cairn_nav_msgs import Collision
from cairn.schemas.cairn_sim_msgs import Scene, WheelMotion, WorldState
from cairn.schemas.geometry_msgs import Point, PoseStamped
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header

# Without word from the wheels for this long [s] they stand still.
_STALE_S = 0.3
_TRUTH_EVERY = SECOND // 10


class SlipConfig(Config):
    """How the wheels slip on the floor."""

    way: float = Field(0.005, ge=0, le=1, description="Random walk of the way [m/sqrt(m)].")
    turn: float = Field(0.01, ge=0, le=1, description="Random walk of turns [rad/sqrt(rad)].")
    turn_per_meter: float = Field(
        0.005, ge=0, le=1, description="Random walk of the heading on the way [rad/sqrt(m)]."
    )


class WorldConfig(Config):
    """Which world."""

    world: ReadPath = Field(description="World file (YAML).")
    radius: float = Field(0.22, gt=0, le=5, description="Radius of the robot [m].")
    slip: SlipConfig = Field(SlipConfig(), description="How the wheels slip.")
    events: tuple[Event, ...] = Field(
        (), description="What happens, beside the events of the world file."
    )
    state_file: Path | None = Field(
        None,
        description="Where to keep the state of the world, so that one whose process died goes on; "
        "none: it begins anew.",
    )


class _Named(Config):
    """What a request is about."""

    name: Name


class _NamedPlace(Placed):
    """The same, and where it is put."""

    name: Name


_CHANGES: dict[str, type[Config]] = {
    "move": _NamedPlace,
    "remove": _Named,
    "furniture": Furniture,
    "object": VisibleObject,
    "person": Person,
    "kidnap": Placed,
}


class SimulatedWorld(Component):
    """Holds the true state of the simulated world and lets time pass in it.

    Tells the drivers what stands (`scene`) and what moves (`world_state`); reports collisions.
    """

    config: WorldConfig

    wheel_motion: In[WheelMotion] = In(qos=RELIABLE.with_depth(200))
    kidnap: In[PoseStamped] = In(optional=True)
    world_state: Out[WorldState] = Out(qos=RELIABLE.with_depth(200))
    scene: Out[Scene] = Out(qos=LATCHED)
    truth: Out[PoseStamped]
    true_map: Out[VisualMap] = Out(qos=LATCHED)
    collisions: Out[Collision] = Out(qos=RELIABLE.with_depth(100))

    def on_configure(self) -> None:
        """Read the world and see that it can be."""
        config = self.config
        world = read_world(config.world)
        more = [event.within(config.world.parent) for event in config.events]
        world = world.model_copy(update={"events": [*world.events, *more]})
        problems = problems_of(world, config.radius)
        if problems:
            raise CairnError(f"{config.world}: " + "; ".join(problems))
        slip = Slip(config.slip.way, config.slip.turn, config.slip.turn_per_meter)
        self._world = World(world, config.radius, slip, self.random)
        self._state_file = StateFile(config.state_file) if config.state_file else None
        self._unkept = False
        self._told_version = -1
        self._began = self._heard = self._stepped = self._truth_at = 0
        self._speeds = (0.0, 0.0)

    def on_activate(self) -> None:
        """Begin, or go on where a forerunner was killed."""
        self._began = self._stepped = self.clock.now()
        if self.restarts > 0:
            self._resume()
        self._tell_scene()

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A world is changed by requests, not by parameters."""
        raise ParameterRejected("a world takes its parameters when it is configured")

    @on("wheel_motion")
    def drive(self, motion: WheelMotion) -> None:
        """Let the robot go as the wheels turned, and time pass."""
        self._heard = self.clock.now()
        follows, contacts = self._world.drive(motion.seconds, motion.forward, motion.turn)
        self._speeds = (motion.forward if follows else 0.0, motion.turn)
        self._pass(to_ns(motion.header.stamp))
        for contact in contacts:
            self._report(contact)

    @on("kidnap")
    def carry(self, pose: PoseStamped) -> None:
        """Carry the robot somewhere else, without its wheels turning."""
        try:
            self._world.carry(planar_pose(pose.pose))
        except CairnError as error:
            self.log.error("%s", error)

    @every(hz=20)
    def go_on(self) -> None:
        """Let happen what is due; let time pass while no wheels turn."""
        now = self.clock.now()
        for happening in self._world.happen((now - self._began) / SECOND):
            self.log.log(INFO if happening.done else WARNING, "%s", happening.told)
        if self._world.scene.version != self._told_version:
            self._tell_scene()
        if now - self._heard > _STALE_S * SECOND:
            self._speeds = (0.0, 0.0)
            self._pass(now)

    @every(hz=10)
    def keep(self) -> None:
        """Keep the state, for one that comes after."""
        if self._state_file is None:
            return
        try:
            self._state_file.keep(self._world, (self.clock.now() - self._began) / SECOND)
            self._unkept = False
        except OSError as error:
            if not self._unkept:
                self.log.warning(
                    "the state of the world cannot be kept in %s: %s; after a crash it would "
                    "begin anew",
                    self._state_file.file,
                    error.strerror,
                )
            self._unkept = True

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Look at the world or change it: list, move, remove, add, person, kidnap."""
        if verb == "list" and not arguments:
            return self._listed()
        model = _CHANGES.get(verb)
        if model is None:
            return super().on_request(verb, arguments)
        try:
            self._change(model.model_validate(arguments))
        except ValidationError as error:
            raise CairnError(f"{verb}: {what_is_wrong(error, model)}") from error
        if self._world.scene.version != self._told_version:
            self._tell_scene()
        return None

    def _change(self, given: Config) -> None:
        match given:
            case _NamedPlace():
                self._world.move(given.name, given.pose)
            case _Named():
                self._world.remove(given.name)
            case Furniture():
                self._world.add(given)
            case VisibleObject():
                thing = given.within(self.config.world.parent)
                problems = unseen_problems(self._world.scene, thing)
                if problems:
                    raise CairnError("; ".join(problems))
                self._world.add(thing)
            case Person():
                self._world.add_person(given)
            case Placed():
                self._world.carry(given.pose)

    def _listed(self) -> list[dict[str, Any]]:
        world = self._world
        x, y, theta = world.robot
        rows = [{"kind": "robot", "name": "robot", "x": x, "y": y, "theta": theta}]
        for name, piece in world.scene.furniture.items():
            rows.append({"kind": "furniture", "name": name, **_place(piece.pose)})
        for name, thing in world.scene.objects.items():
            rows.append({"kind": "object", "name": name, **_place(thing.pose)})
        for walker in world.walkers:
            place = {"x": walker.x, "y": walker.y, "theta": 0.0}
            rows.append({"kind": "person", "name": walker.person.name, **place})
        return rows

    def _pass(self, stamp: int) -> None:
        """Let time pass until a stamp [ns], and tell what moves."""
        stamp = max(stamp, self._stepped)
        self._world.walk(min((stamp - self._stepped) / SECOND, 1.0))
        self._stepped = stamp
        header = Header(stamp=from_ns(stamp), frame_id="map")
        robot = pose_message(self._world.robot)
        self.world_state.publish(
            WorldState(
                header=header,
                robot=robot,
                forward=self._speeds[0],
                turn=self._speeds[1],
                people=Packed(Point, self._world.people),
            )
        )
        if stamp - self._truth_at >= _TRUTH_EVERY:
            self._truth_at = stamp
            self.truth.publish(PoseStamped(header=header, pose=robot))

    def _report(self, contact: Contact) -> None:
        self.log.warning(
            "collision with %s at (%.2f, %.2f), %.2f m/s",
            contact.what,
            contact.x,
            contact.y,
            contact.speed,
        )
        self.collisions.publish(
            Collision(
                header=Header(stamp=from_ns(self._stepped), frame_id="map"),
                obstacle=contact.what,
                x=contact.x,
                y=contact.y,
                speed=contact.speed,
            )
        )

    def _tell_scene(self) -> None:
        scene = self._world.scene
        self._told_version = scene.version
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.scene.publish(scene_message(header, scene))
        self.true_map.publish(true_map(header, scene))

    def _resume(self) -> None:
        state = self._state_file.kept() if self._state_file is not None else None
        if state is None:
            self.log.warning("the world begins anew: the robot stands where it began")
            return
        state.put_into(self._world)
        self._began = self.clock.now() - round(state.elapsed_s * SECOND)
        self.log.info("the world goes on at %.1f s", state.elapsed_s)


def _place(pose: Pose) -> dict[str, float]:
    return {"x": pose[0], "y": pose[1], "theta": pose[2]}
