// What is known about one robot: the newest messages that the map draws, ready for drawing.

import { topicOf } from "../hooks.js";
import { compose, isUpsideDown, poseOf, PoseHistory, timeOf, transformPose } from "./geometry.js";
import { GridMap } from "./grid.js";
import { zonesOf } from "./zones.js";

/** The layers that can be switched, with the topics that each needs. */
export const LAYERS = [
  { id: "map", title: "Grid map", topics: ["map", "map_updates"], swatch: "--map-occupied" },
  { id: "scan", title: "Scan", topics: ["scan"], swatch: "--map-scan" },
  { id: "pose", title: "Pose and covariance", topics: [], swatch: "--map-robot" },
  { id: "particles", title: "Particles", topics: ["particles"], swatch: "--map-particles" },
  { id: "path", title: "Path", topics: ["path"], swatch: "--map-path" },
  { id: "goals", title: "Goals", topics: ["navigate_goal", "navigation_status"], swatch: "--map-goal" },
  { id: "zones", title: "Zones and places", topics: ["zones"], swatch: "--map-keepout" },
  { id: "landmarks", title: "Landmarks", topics: ["visual_map", "visual_map_changes"], swatch: "--ok" },
  { id: "proposals", title: "Proposed landmarks", topics: ["object_proposals"], swatch: "--accent" },
  { id: "seen", title: "Recognized objects", topics: ["recognized_objects"], swatch: "--warning" },
  { id: "obstacles", title: "Moving obstacles", topics: ["moving_obstacles"], swatch: "--map-obstacle" },
  { id: "world", title: "True world (simulation)", topics: ["world_geometry", "world_state", "collisions"], swatch: "--map-person" },
  { id: "grid", title: "Meter grid", topics: [], swatch: "--map-grid" },
];

/** Off until they are switched on: they hide more than they show at first sight. */
export const HIDDEN_AT_FIRST = ["world"];

const ALWAYS = ["localization", "tf", "tf_static", "odom", "footprint"];
const OF_OTHERS = [...ALWAYS, "path"];
const MOST_HZ = { localization: 10, odom: 30, world_state: 15 };
const MOST_CHANGES = 200;
const MOST_COLLISIONS = 50;
const MOST_PENDING_UPDATES = 50;
const JUMP_M = 0.05; // of the transform from odom to map: the scan shown is placed again

const frameOf = (name) => name.split("/").at(-1);
const isBase = (frame) => frame === "base_link" || frame === "base_footprint";

export class Scene {
  grid = null;
  scan = null; // x, y of each hit [m], alternating
  scanStamp = 0; // [s]
  estimate = null;
  particles = null;
  path = null;
  goals = null; // {first, poses}
  navigation = null;
  zones = [];
  landmarks = new Map();
  proposals = [];
  changes = new Map(); // object id -> newest removal or registration
  seen = null; // {base, objects: [{id, at}]}
  movers = null;
  world = null;
  people = null;
  truth = null;
  collisions = [];
  footprint = null;

  #connection;
  #changed;
  #mapToOdom = null;
  #odomToBase = new PoseHistory();
  #mounts = new Map(); // frame -> {pose, flipped} in base_link
  #ends = new Map(); // topic -> function that ends its subscription
  #pendingUpdates = [];
  #scanMessage = null;

  /** `changed(topic)` is called when there is something new to draw. */
  constructor(connection, robot, changed) {
    this.#connection = connection;
    this.robot = robot;
    this.#changed = changed;
  }

  /** Subscribe to what is shown: layers of `visible` for the chosen robot, the essentials for others. */
  show(visible, isChosen) {
    const wanted = new Set(isChosen ? ALWAYS : OF_OTHERS);
    if (isChosen) for (const layer of LAYERS) if (visible.has(layer.id)) layer.topics.forEach((topic) => wanted.add(topic));
    for (const [topic, end] of this.#ends)
      if (!wanted.has(topic)) {
        end();
        this.#ends.delete(topic);
        this.#forget(topic);
      }
    for (const topic of wanted) {
      if (this.#ends.has(topic)) continue;
      const receive = (message) => {
        this[`on_${topic}`](message);
        this.#changed(topic);
      };
      const options = { maxHz: MOST_HZ[topic] ?? 0 };
      this.#ends.set(topic, this.#connection.subscribe(topicOf(this.robot, topic), receive, options));
    }
    this.#changed("");
  }

  /** End all subscriptions, and keep what was received; `show` begins them again. */
  close() {
    for (const end of this.#ends.values()) end();
    this.#ends.clear();
  }

  /** Forget what was collected over time. All else is replaced: the newest message of each topic comes. */
  rewind() {
    this.collisions = [];
    this.changes = new Map();
    this.#changed("");
  }

  /** Forget what was received: another connection follows. */
  reset() {
    for (const topic of this.#ends.keys()) this.#forget(topic);
    this.#odomToBase = new PoseHistory();
    this.#mapToOdom = null;
    this.estimate = null;
    this.#changed("");
  }

  /** The robot's pose in frame map, newest odometry included; null before it is known. */
  get pose() {
    const odometry = this.#odomToBase.latest;
    if (this.#mapToOdom && odometry) return compose(this.#mapToOdom, odometry);
    return this.estimate?.located ? poseOf(this.estimate.pose.pose) : null;
  }

  /** The pose for drawing: in frame map, or in frame odom as long as the robot is not located. */
  get drawnPose() {
    return this.pose ?? this.#odomToBase.latest;
  }

  #forget(topic) {
    if (topic === "map") this.grid = null;
    else if (topic === "scan") this.scan = this.#scanMessage = null;
    else if (topic === "particles") this.particles = null;
    else if (topic === "path") this.path = null;
    else if (topic === "navigate_goal") this.goals = null;
    else if (topic === "navigation_status") this.navigation = null;
    else if (topic === "zones") this.zones = [];
    else if (topic === "object_proposals") this.proposals = [];
    else if (topic === "visual_map") this.landmarks = new Map();
    else if (topic === "visual_map_changes") this.changes = new Map();
    else if (topic === "recognized_objects") this.seen = null;
    else if (topic === "moving_obstacles") this.movers = null;
    else if (topic === "world_geometry") this.world = null;
    else if (topic === "world_state") this.people = this.truth = null;
    else if (topic === "collisions") this.collisions = [];
  }

  #baseAt(time) {
    const odometry = this.#odomToBase.at(time);
    if (!odometry) return null;
    return this.#mapToOdom ? compose(this.#mapToOdom, odometry) : odometry;
  }

  on_map(message) {
    this.grid = new GridMap(message);
    for (const update of this.#pendingUpdates) if (timeOf(update.header) >= timeOf(message.header)) this.grid.update(update);
    this.#pendingUpdates = [];
  }

  on_map_updates(message) {
    if (this.grid) {
      if (timeOf(message.header) >= this.grid.time) this.grid.update(message); // an older one is in the map
    } else this.#pendingUpdates = [...this.#pendingUpdates.slice(1 - MOST_PENDING_UPDATES), message];
  }

  on_scan(message) {
    const { ranges, angle_min: start, angle_increment: step, time_increment: between, range_min: least, range_max: most } = message;
    this.#scanMessage = message;
    this.scanStamp = timeOf(message.header);
    const base = this.#baseAt(this.scanStamp);
    if (!base) {
      this.scan = null;
      return;
    }
    // Each beam is placed where the robot was when it was measured: interpolated over the sweep.
    const mount = this.#mounts.get(frameOf(message.header.frame_id)) ?? { pose: [0, 0, 0], flipped: false };
    const from = compose(base, mount.pose);
    const to = compose(this.#baseAt(this.scanStamp + between * ranges.length), mount.pose);
    const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
    const points = new Float32Array(2 * ranges.length);
    let count = 0;
    for (let i = 0; i < ranges.length; i++) {
      const range = ranges[i];
      if (!(range >= least && range < most)) continue;
      const share = i / ranges.length;
      const beam = start + i * step;
      const angle = from[2] + share * turn + (mount.flipped ? -beam : beam);
      points[count++] = from[0] + share * (to[0] - from[0]) + range * Math.cos(angle);
      points[count++] = from[1] + share * (to[1] - from[1]) + range * Math.sin(angle);
    }
    this.scan = points.subarray(0, count);
  }

  on_localization(message) {
    this.estimate = message;
  }

  on_tf(message) {
    for (const one of message.transforms)
      if (frameOf(one.header.frame_id) === "map" && frameOf(one.child_frame_id) === "odom") {
        const [x, y] = this.#mapToOdom ?? [Infinity, Infinity];
        this.#mapToOdom = transformPose(one.transform);
        const jumps = Math.hypot(this.#mapToOdom[0] - x, this.#mapToOdom[1] - y) > JUMP_M;
        if (jumps && this.#scanMessage) this.on_scan(this.#scanMessage);
      }
  }

  on_tf_static(message) {
    for (const { header, child_frame_id: child, transform } of message.transforms)
      if (isBase(frameOf(header.frame_id)))
        this.#mounts.set(frameOf(child), { pose: transformPose(transform), flipped: isUpsideDown(transform.rotation) });
  }

  on_odom(message) {
    const jumps = this.#odomToBase.add(timeOf(message.header), poseOf(message.pose.pose));
    if (jumps && this.#scanMessage) this.on_scan(this.#scanMessage); // it may have come before its pose
  }

  on_footprint(message) {
    this.footprint = message.polygon.points.map((point) => [point.x, point.y]);
  }

  on_particles(message) {
    this.particles = message.poses.map(poseOf);
  }

  on_path(message) {
    this.path = message.poses.map((one) => poseOf(one.pose));
  }

  on_navigate_goal(message) {
    this.goals = { first: message.first, poses: message.goals.map(poseOf) };
  }

  on_navigation_status(message) {
    this.navigation = message;
  }

  on_zones(message) {
    this.zones = zonesOf(message);
  }

  on_visual_map(message) {
    this.landmarks = new Map(message.objects.map((one) => [one.object_id, one]));
  }

  on_visual_map_changes(message) {
    if (message.kind !== 1 && message.kind !== 2) return; // neither REMOVED nor REGISTERED
    this.changes.delete(message.object_id);
    this.changes.set(message.object_id, message);
    if (this.changes.size > MOST_CHANGES) this.changes.delete(this.changes.keys().next().value);
  }

  on_object_proposals(message) {
    this.proposals = message.proposals;
  }

  on_recognized_objects(message) {
    const base = this.#baseAt(timeOf(message.header));
    const at = ({ range, bearing }) => compose(base, [range * Math.cos(bearing), range * Math.sin(bearing), 0]);
    this.seen = base && { base, objects: message.objects.map((one) => ({ id: one.object_id, at: at(one) })) };
  }

  on_moving_obstacles(message) {
    const toMap = frameOf(message.header.frame_id) === "odom" ? this.#mapToOdom : null;
    this.movers = message.poses.map((one) => (toMap ? compose(toMap, poseOf(one)) : poseOf(one)));
  }

  on_world_geometry(message) {
    this.world = message;
  }

  on_world_state(message) {
    this.people = message.people;
    this.truth = poseOf(message.robot);
  }

  on_collisions(message) {
    this.collisions = [...this.collisions.slice(1 - MOST_COLLISIONS), message];
  }
}
