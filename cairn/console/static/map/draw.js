// Drawing of scenes on the map's canvas, layer by layer.

import { alternativesOf } from "../navigation.js";
import { ellipseOf, scaleBar, yawOf } from "./geometry.js";
import { isArea, middleOf } from "./zones.js";

const COLOR_NAMES = ["free", "occupied", "grid", "scan", "path", "robot", "other", "particles", "goal", "obstacle", "person", "keepout", "slow", "lane", "place"];
const TOKENS = { text: "--text", muted: "--muted", surface: "--surface", ok: "--ok", warning: "--warning", bad: "--bad", accent: "--accent" };
const LEAST_ROBOT_PX = 7; // half the length of a robot that is zoomed out
const DEFAULT_RADIUS_M = 0.22;
const SIGMAS = 2;
const FIRST_END_STATE = 5; // of a NavigationStatus: SUCCEEDED, FAILED, CANCELED

/** Read the colors of the map from the style sheet, which has other ones for light and dark. */
export function readColors() {
  const probe = document.body.appendChild(document.createElement("span"));
  const read = (token) => {
    probe.style.color = `var(${token})`;
    return getComputedStyle(probe).color;
  };
  const colors = {};
  for (const name of COLOR_NAMES) colors[name] = read(`--map-${name}`);
  for (const [name, token] of Object.entries(TOKENS)) colors[name] = read(token);
  probe.remove();
  colors.cells = { free: channels(colors.free), occupied: channels(colors.occupied) };
  colors.reliability = [colors.bad, colors.warning, colors.ok].map(channels);
  return colors;
}

const channels = (color) => color.match(/[\d.]+/g).slice(0, 3).map(Number);

/** Return the color of a reliability from 0 (red) over 0.5 to 1 (green). */
export function reliabilityColor(colors, reliability) {
  const at = Math.min(1.999, Math.max(0, 2 * reliability));
  const [a, b] = [colors.reliability[Math.floor(at)], colors.reliability[Math.floor(at) + 1]];
  return `rgb(${[0, 1, 2].map((i) => Math.round(a[i] + (at % 1) * (b[i] - a[i]))).join(" ")})`;
}

/** A painter of one frame: context, view, colors and the layers that are visible. */
export class Painter {
  constructor(context, view, colors, visible) {
    Object.assign(this, { context, view, colors, visible });
  }

  /** Draw everything of the chosen robot's scene, and the other robots. */
  draw(scene, others, selected, selectedZone) {
    const { visible } = this;
    if (scene && visible.has("map")) scene.grid?.draw(this.context, this.view, this.colors.cells);
    if (visible.has("grid")) this.#meterGrid();
    if (!scene) return;
    if (visible.has("zones")) this.#zones(scene, selectedZone);
    if (visible.has("world")) this.#world(scene);
    if (visible.has("particles")) this.#particles(scene);
    const isOver = scene.navigation?.state >= FIRST_END_STATE;
    if (visible.has("path")) this.#path(scene.path, this.colors.path, isOver ? 0.3 : 1);
    if (visible.has("scan")) this.#scan(scene);
    if (visible.has("seen")) this.#seen(scene);
    if (visible.has("obstacles")) this.#movers(scene);
    if (visible.has("landmarks")) this.#landmarks(scene, selected);
    if (visible.has("proposals")) this.#proposals(scene);
    if (visible.has("goals")) this.#goals(scene);
    for (const other of others) {
      this.#path(other.path, this.colors.other);
      this.robot(other.drawnPose, other, this.colors.other, other.robot);
    }
    if (visible.has("pose")) this.#pose(scene, others.length > 0);
  }

  #meterGrid() {
    const { context, view } = this;
    const step = Math.max(1, scaleBar(view.scale, 80));
    const [x0, y1] = view.toWorld(0, 0);
    const [x1, y0] = view.toWorld(view.width, view.height);
    context.strokeStyle = this.colors.grid;
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) {
      const px = Math.round(view.toScreen(x, 0)[0]) + 0.5;
      context.moveTo(px, 0);
      context.lineTo(px, view.height);
    }
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) {
      const py = Math.round(view.toScreen(0, y)[1]) + 0.5;
      context.moveTo(0, py);
      context.lineTo(view.width, py);
    }
    context.stroke();
  }

  #scan({ scan }) {
    if (!scan) return;
    const { context, view } = this;
    const size = Math.min(5, Math.max(2, 0.035 * view.scale));
    context.fillStyle = this.colors.scan;
    for (let i = 0; i < scan.length; i += 2) {
      const [px, py] = view.toScreen(scan[i], scan[i + 1]);
      context.fillRect(px - size / 2, py - size / 2, size, size);
    }
  }

  #particles({ particles }) {
    if (!particles) return;
    const { context, view } = this;
    const length = Math.min(12, Math.max(5, 0.12 * view.scale));
    context.strokeStyle = this.colors.particles;
    context.lineWidth = 1;
    context.beginPath();
    for (const [x, y, theta] of particles) {
      const [px, py] = view.toScreen(x, y);
      context.moveTo(px, py);
      context.lineTo(px + length * Math.cos(theta), py - length * Math.sin(theta));
    }
    context.stroke();
  }

  #path(path, color, alpha = 1) {
    if (!path || path.length < 2) return;
    const { context, view } = this;
    context.strokeStyle = color;
    context.lineWidth = 2.5;
    context.lineJoin = "round";
    context.beginPath();
    for (const [x, y] of path) context.lineTo(...view.toScreen(x, y));
    context.globalAlpha = alpha;
    context.stroke();
    context.globalAlpha = 1;
  }

  #seen({ seen }) {
    if (!seen) return;
    const { context, view } = this;
    context.strokeStyle = this.colors.warning;
    context.lineWidth = 1.5;
    context.setLineDash([3, 4]);
    context.beginPath();
    for (const { at } of seen.objects) {
      context.moveTo(...view.toScreen(seen.base[0], seen.base[1]));
      context.lineTo(...view.toScreen(at[0], at[1]));
    }
    context.stroke();
    context.setLineDash([]);
    for (const { at } of seen.objects) this.circle(at[0], at[1], 5, { stroke: this.colors.warning });
  }

  #movers({ movers }) {
    for (const [x, y, theta] of movers ?? []) {
      this.circle(x, y, Math.max(7, 0.25 * this.view.scale), { stroke: this.colors.obstacle, width: 2 });
      this.arrow(x, y, theta, Math.max(16, 0.6 * this.view.scale), this.colors.obstacle);
    }
  }

  #landmarks({ landmarks, changes }, selected) {
    const { context, view, colors } = this;
    for (const [id, change] of changes) {
      const known = landmarks.get(id);
      if (Number.isNaN(change.old_x)) continue;
      const isRegistered = change.kind === 2 && !Number.isNaN(change.new_x);
      this.cross(change.old_x, change.old_y, 5, colors.bad);
      if (isRegistered && known) this.#line(change.old_x, change.old_y, known.x, known.y, colors.muted);
    }
    for (const mark of landmarks.values()) {
      const isLive = mark.state === 0;
      const color = reliabilityColor(colors, mark.reliability);
      if (isLive) {
        const [xx, xy, , yy] = mark.covariance;
        this.#ellipse(mark.x, mark.y, ellipseOf(xx, xy, yy, SIGMAS), color, 0.15);
        this.diamond(mark.x, mark.y, 6, { fill: color, stroke: colors.surface });
      } else {
        this.diamond(mark.x, mark.y, 6, { stroke: colors.bad });
        this.cross(mark.x, mark.y, 3.5, colors.bad);
        if (!Number.isNaN(mark.candidate_x)) {
          this.#line(mark.x, mark.y, mark.candidate_x, mark.candidate_y, colors.muted);
          this.diamond(mark.candidate_x, mark.candidate_y, 6, { stroke: reliabilityColor(colors, mark.candidate_reliability), dash: [2, 2] });
        }
      }
      if (mark.object_id === selected) this.circle(mark.x, mark.y, 12, { stroke: colors.accent, width: 2.5 });
      if (view.scale > 45 || mark.object_id === selected) this.label(mark.x, mark.y, 9, mark.name || `object ${mark.object_id}`);
    }
    context.setLineDash([]);
  }

  #proposals({ proposals }) {
    for (const { x, y, name } of proposals) {
      this.diamond(x, y, 7, { stroke: this.colors.accent, dash: [3, 2] });
      this.label(x, y, 9, `${name}?`);
    }
    this.context.setLineDash([]);
  }

  #zones({ zones }, selected) {
    const { context, view, colors } = this;
    for (const zone of zones) {
      const color = colors[zone.kind];
      const isSelected = zone.name === selected;
      if (zone.kind === "place") {
        const [x, y] = zone.rings[0][0];
        if (zone.heading !== null) this.arrow(x, y, zone.heading, 24, color);
        this.circle(x, y, 6, { fill: color, stroke: isSelected ? colors.accent : colors.surface, width: isSelected ? 3 : 1.5 });
        this.label(x, y, 9, zone.name);
        continue;
      }
      context.beginPath();
      for (const ring of zone.rings) {
        ring.forEach((point, i) => (i ? context.lineTo(...view.toScreen(...point)) : context.moveTo(...view.toScreen(...point))));
        if (isArea(zone)) context.closePath();
      }
      context.lineJoin = context.lineCap = "round";
      context.globalAlpha = 0.18;
      context.fillStyle = context.strokeStyle = color;
      if (isArea(zone)) context.fill("evenodd");
      else {
        context.lineWidth = zone.width * view.scale;
        context.stroke();
      }
      context.globalAlpha = 1;
      context.lineWidth = isSelected ? 3.5 : 1.5;
      context.setLineDash(zone.kind === "keepout" ? [] : [6, 4]);
      context.stroke();
      context.setLineDash([]);
      context.lineCap = "butt";
      const words = zone.kind === "slow" ? `${zone.name}, ${zone.speed} m/s` : zone.name;
      this.label(...middleOf(zone), 0, words);
    }
  }

  /** Draw a zone that is not complete yet. */
  draft(kind, points) {
    const { context, view } = this;
    const color = this.colors[kind];
    context.beginPath();
    for (const point of points) context.lineTo(...view.toScreen(...point));
    if (kind !== "lane") context.closePath();
    context.setLineDash([4, 3]);
    this.#paint(kind === "lane" ? null : color, color, 2, 0.15);
    context.setLineDash([]);
    for (const [x, y] of points) this.circle(x, y, 5, { fill: color, stroke: this.colors.surface });
  }

  /** Draw the corners of the selected zone, and its shape if that is changed. */
  shape(zone, rings, corner, isChanged) {
    const { context, view, colors } = this;
    if (isChanged && zone.kind !== "place") {
      context.beginPath();
      for (const ring of rings) {
        ring.forEach((point, i) => (i ? context.lineTo(...view.toScreen(...point)) : context.moveTo(...view.toScreen(...point))));
        if (isArea(zone)) context.closePath();
      }
      context.setLineDash([4, 3]);
      context.lineWidth = 2.5;
      context.strokeStyle = colors.accent;
      context.stroke();
      context.setLineDash([]);
    }
    rings.forEach((ring, r) =>
      ring.forEach(([x, y], i) => {
        const isSelected = corner?.[0] === r && corner[1] === i;
        this.circle(x, y, isSelected ? 7 : 5, { fill: isSelected ? colors.accent : colors.surface, stroke: isSelected ? colors.surface : colors.accent, width: 2 });
      }),
    );
  }

  #goals({ goals, navigation }) {
    if (!goals || goals.poses.length === 0) return;
    if (navigation?.state >= FIRST_END_STATE) return;
    const current = Math.max(goals.first, navigation?.goal ?? 0);
    this.waypoints(goals.poses.slice(current), this.colors.goal, goals.poses.length > 1 ? current + 1 : 0);
  }

  #pose(scene, isNamed) {
    const { pose } = scene;
    const estimate = scene.estimate;
    if (estimate?.located && pose) {
      const covariance = estimate.pose.covariance;
      this.#ellipse(pose[0], pose[1], ellipseOf(covariance[0], covariance[1], covariance[7], SIGMAS), this.colors.robot, 0.2);
      this.#headingFan(pose, SIGMAS * Math.sqrt(Math.max(0, covariance[35])));
      for (const one of alternativesOf(estimate))
        this.robot([one.x, one.y, one.theta], scene, this.colors.other, `or here: ${Math.round(100 * one.probability)} %`);
    }
    this.robot(scene.drawnPose, scene, this.colors.robot, isNamed ? scene.robot : "");
  }

  #headingFan([x, y, theta], sigma) {
    if (sigma < 0.03) return;
    const { context, view } = this;
    const [px, py] = view.toScreen(x, y);
    context.fillStyle = this.colors.robot;
    context.globalAlpha = 0.15;
    context.beginPath();
    context.moveTo(px, py);
    context.arc(px, py, Math.max(30, 0.9 * view.scale), -theta - Math.min(sigma, Math.PI), -theta + Math.min(sigma, Math.PI));
    context.fill();
    context.globalAlpha = 1;
  }

  #world({ world, people, truth, collisions }) {
    const { context, view, colors } = this;
    context.strokeStyle = colors.person;
    context.lineWidth = 1.2;
    if (world) {
      context.globalAlpha = 0.75;
      context.beginPath();
      for (let i = 0; i < world.segments.length; i += 4) {
        context.moveTo(...view.toScreen(world.segments[i], world.segments[i + 1]));
        context.lineTo(...view.toScreen(world.segments[i + 2], world.segments[i + 3]));
      }
      context.stroke();
      world.object_poses.forEach((pose, i) => {
        const { x, y } = pose.position;
        const half = world.object_sizes[2 * i] / 2;
        const theta = yawOf(pose.orientation);
        this.#line(x - half * Math.sin(theta), y + half * Math.cos(theta), x + half * Math.sin(theta), y - half * Math.cos(theta), colors.person, 4);
      });
      context.globalAlpha = 1;
    }
    for (const person of people ?? []) this.circle(person.x, person.y, Math.max(4, person.z * view.scale), { fill: colors.person, alpha: 0.5, stroke: colors.person });
    for (const { x, y } of collisions) this.cross(x, y, 7, colors.bad);
    if (truth) this.robot(truth, { footprint: null }, colors.person, "", 0.45);
  }

  /** Draw a robot at a pose: its footprint, and its heading. */
  robot(pose, scene, color, name = "", alpha = 1) {
    if (!pose) return;
    const { context, view } = this;
    const [px, py] = view.toScreen(pose[0], pose[1]);
    const outline = scene.footprint;
    const radius = Math.max(LEAST_ROBOT_PX, DEFAULT_RADIUS_M * view.scale);
    context.save();
    context.globalAlpha = alpha;
    context.translate(px, py);
    context.rotate(-pose[2]);
    context.fillStyle = color;
    context.strokeStyle = this.colors.surface;
    context.lineWidth = 1.5;
    context.beginPath();
    if (outline?.length > 2 && reach(outline) * view.scale > LEAST_ROBOT_PX) for (const [x, y] of outline) context.lineTo(x * view.scale, -y * view.scale);
    else context.arc(0, 0, radius, 0, 2 * Math.PI);
    context.closePath();
    context.fill();
    context.stroke();
    context.fillStyle = this.colors.surface;
    context.beginPath();
    context.moveTo(radius * 0.78, 0);
    context.lineTo(-radius * 0.35, -radius * 0.5);
    context.lineTo(-radius * 0.08, 0);
    context.lineTo(-radius * 0.35, radius * 0.5);
    context.closePath();
    context.fill();
    context.restore();
    if (name) this.label(pose[0], pose[1], radius + 4, name);
  }

  /** Draw poses as numbered flags with headings; `first` is the number of the first one, 0 for none. */
  waypoints(poses, color, first) {
    poses.forEach(([x, y, theta], i) => {
      this.arrow(x, y, theta, 26, color);
      this.circle(x, y, 8, { fill: color, stroke: this.colors.surface, width: 1.5 });
      if (first > 0) this.#centered(x, y, String(first + i), this.colors.surface);
    });
  }

  #centered(x, y, words, color) {
    const { context, view } = this;
    context.font = "600 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = color;
    context.fillText(words, ...view.toScreen(x, y));
  }

  #ellipse(x, y, { a, b, angle }, color, alpha) {
    const { context, view } = this;
    const [px, py] = view.toScreen(x, y);
    context.beginPath();
    context.ellipse(px, py, Math.max(1, a * view.scale), Math.max(1, b * view.scale), -angle, 0, 2 * Math.PI);
    context.globalAlpha = alpha;
    context.fillStyle = color;
    context.fill();
    context.globalAlpha = 0.8;
    context.strokeStyle = color;
    context.lineWidth = 1;
    context.stroke();
    context.globalAlpha = 1;
  }

  circle(x, y, radius, { fill, stroke, width = 1.5, alpha = 1 }) {
    const { context, view } = this;
    context.beginPath();
    context.arc(...view.toScreen(x, y), radius, 0, 2 * Math.PI);
    this.#paint(fill, stroke, width, alpha);
  }

  diamond(x, y, radius, { fill, stroke, dash = [] }) {
    const { context, view } = this;
    const [px, py] = view.toScreen(x, y);
    context.beginPath();
    context.moveTo(px, py - radius);
    context.lineTo(px + radius, py);
    context.lineTo(px, py + radius);
    context.lineTo(px - radius, py);
    context.closePath();
    context.setLineDash(dash);
    this.#paint(fill, stroke, 1.5, 1);
    context.setLineDash([]);
  }

  cross(x, y, radius, color) {
    const { context, view } = this;
    const [px, py] = view.toScreen(x, y);
    context.beginPath();
    context.moveTo(px - radius, py - radius);
    context.lineTo(px + radius, py + radius);
    context.moveTo(px - radius, py + radius);
    context.lineTo(px + radius, py - radius);
    this.#paint(null, color, 2, 1);
  }

  arrow(x, y, theta, length, color) {
    const { context, view } = this;
    context.save();
    context.translate(...view.toScreen(x, y));
    context.rotate(-theta);
    context.strokeStyle = context.fillStyle = color;
    context.lineWidth = 2.5;
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(length - 6, 0);
    context.stroke();
    context.beginPath();
    context.moveTo(length, 0);
    context.lineTo(length - 9, -5);
    context.lineTo(length - 9, 5);
    context.fill();
    context.restore();
  }

  /** Write a name below a position, legible on any ground. */
  label(x, y, below, words) {
    const { context, view } = this;
    const [px, py] = view.toScreen(x, y);
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = this.colors.surface;
    context.strokeText(words, px, py + below);
    context.fillStyle = this.colors.text;
    context.fillText(words, px, py + below);
  }

  #line(x0, y0, x1, y1, color, width = 1.2) {
    const { context, view } = this;
    context.beginPath();
    context.moveTo(...view.toScreen(x0, y0));
    context.lineTo(...view.toScreen(x1, y1));
    this.#paint(null, color, width, 1);
  }

  #paint(fill, stroke, width, alpha) {
    const { context } = this;
    if (fill) {
      context.globalAlpha = alpha;
      context.fillStyle = fill;
      context.fill();
      context.globalAlpha = 1;
    }
    if (stroke) {
      context.strokeStyle = stroke;
      context.lineWidth = width;
      context.stroke();
    }
  }
}

const reach = (outline) => Math.max(...outline.map(([x, y]) => Math.hypot(x, y)));
