// The map without its buttons: scenes of all robots, the view, drawing, pointer and keyboard.

import { Store } from "../store.js";
import { Painter, readColors } from "./draw.js";
import { Viewport } from "./geometry.js";
import { Scene } from "./scene.js";
import { nearestPlace } from "./zones.js";

const CLICK_PX = 5; // a pointer that moves less has clicked
const HEADING_PX = 14; // a drag that is shorter gives no heading
const PICK_PX = 14;
const KEY_PAN_PX = 60;
const KEY_TURN = Math.PI / 12;
const KEPT_DELAYS = 300;
const MARGINS = { left: 64, right: 64, top: 28, bottom: 56 }; // of tools, view buttons and scale
const NARROW_MARGINS = { left: 16, right: 16, top: 64, bottom: 56 };
const NARROW_PX = 500;

export class MapController {
  /** Position [m] below the pointer, or of the cross hair that the keyboard moves; null without one. */
  cursor = new Store(null);
  /** What was clicked: {kind: "landmark", id}, {kind: "thing", name} or {kind: "zone", name}; null for nothing. */
  selected = new Store(null);
  /** Whether the view follows the chosen robot. */
  following = new Store(false);
  /** Pixels per meter, for the scale bar. */
  scale = new Store(60);
  /** Which data there is to draw: "" nothing, "pose" without a map, "map". */
  content = new Store("");
  /** From the stamp of each of the last scans until it was drawn [ms], by this computer's clock. */
  scanToPixels = [];

  view = new Viewport();

  #connection;
  #canvas = null;
  #scenes = new Map();
  #robot = "";
  #visible = new Set();
  #colors = null;
  #tool = null; // {onPress, onRelease, onDouble, onKey, draw, pick}: see tools.js
  #frame = 0;
  #pointers = new Map(); // id -> {x, y}
  #drag = null;
  #hasFitted = false;
  #fitted = ""; // the view that shows everything, until it is moved
  #keyPose = null; // [x, y, theta] that the keyboard chooses
  #drawnScan = 0;
  #observer = null;

  constructor(connection) {
    this.#connection = connection;
  }

  get scene() {
    return this.#scenes.get(this.#robot) ?? null;
  }

  attach(canvas) {
    this.#canvas = canvas;
    this.#observer = new ResizeObserver(() => this.#resize());
    this.#observer.observe(canvas);
    this.refreshColors();
    const listen = (name, listener, options) => canvas.addEventListener(name, listener, options);
    listen("pointerdown", (event) => this.#onDown(event));
    listen("pointermove", (event) => this.#onMove(event));
    listen("pointerup", (event) => this.#onUp(event));
    listen("pointercancel", (event) => this.#onCancel(event));
    listen("pointerleave", () => this.#pointers.size === 0 && this.cursor.set(null));
    listen("dblclick", (event) => this.#onDouble(event));
    listen("wheel", (event) => this.#onWheel(event), { passive: false });
    listen("keydown", (event) => this.#onKey(event));
    listen("blur", () => this.#setKeyPose(null));
    listen("contextmenu", (event) => event.preventDefault());
  }

  detach() {
    this.#observer?.disconnect();
    cancelAnimationFrame(this.#frame);
    for (const scene of this.#scenes.values()) scene.close();
    this.#scenes.clear();
  }

  /** Show these robots, `chosen` with the layers whose ids are in `visible`; nothing is read unless `isShown`. */
  setRobots(robots, chosen, visible, isShown) {
    if (chosen !== this.#robot) {
      this.#hasFitted = false;
      this.selected.set(null);
    }
    this.#robot = chosen;
    this.#visible = visible;
    for (const [name, scene] of this.#scenes)
      if (!robots.includes(name)) {
        scene.close();
        this.#scenes.delete(name);
      }
    for (const name of robots) {
      if (!this.#scenes.has(name)) this.#scenes.set(name, new Scene(this.#connection, name, () => this.redraw()));
      if (isShown) this.#scenes.get(name).show(visible, name === chosen);
      else this.#scenes.get(name).close();
    }
    if (isShown) this.redraw();
  }

  setTool(tool) {
    this.#tool = tool;
    this.#drag = null;
    this.#setKeyPose(null);
    this.redraw();
  }

  /** Forget all that was received: another connection follows, with all latched messages. */
  reset() {
    for (const scene of this.#scenes.values()) scene.reset();
  }

  /** Forget what was collected: a recording goes back in time, and sends the last messages before. */
  rewind() {
    for (const scene of this.#scenes.values()) scene.rewind();
  }

  refreshColors() {
    this.#colors = readColors();
    this.redraw();
  }

  zoom(factor) {
    this.view.zoom(factor);
    this.redraw();
  }

  /** Show the whole map, or what surrounds the robot if there is no map. */
  fit() {
    this.following.set(false);
    const bounds = this.scene?.grid?.bounds();
    const pose = this.scene?.drawnPose;
    const margins = this.view.width < NARROW_PX ? NARROW_MARGINS : MARGINS;
    if (bounds) this.view.fit(bounds, margins);
    else if (pose) this.view.fit([pose[0] - 4, pose[1] - 4, pose[0] + 4, pose[1] + 4], margins);
    this.#fitted = this.#shownPart();
    this.redraw();
  }

  #shownPart() {
    return `${this.view.x} ${this.view.y} ${this.view.scale}`;
  }

  redraw() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      this.#draw();
    });
  }

  #resize() {
    const { width, height } = this.#canvas.getBoundingClientRect();
    const ratio = devicePixelRatio;
    this.#canvas.width = Math.max(1, Math.round(width * ratio));
    this.#canvas.height = Math.max(1, Math.round(height * ratio));
    const showedAll = this.view.width <= 1 || this.#fitted === this.#shownPart();
    this.view.width = width;
    this.view.height = height;
    if (showedAll) this.#hasFitted = false;
    this.#draw(); // at once: a resized canvas is empty
  }

  #draw() {
    const { scene, view } = this;
    if (!this.#canvas || view.width <= 1) return;
    const pose = scene?.drawnPose ?? null;
    this.content.set(scene?.grid ? "map" : pose ? "pose" : "");
    if (!this.#hasFitted && this.content.value) {
      if (scene.grid || !this.#visible.has("map")) this.#hasFitted = true;
      this.fit();
    }
    if (this.following.value && pose && !this.#drag) [view.x, view.y] = pose;
    this.scale.set(view.scale);
    const context = this.#canvas.getContext("2d");
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    const painter = new Painter(context, view, this.#colors, this.#visible);
    const others = [...this.#scenes.values()].filter((other) => other !== scene);
    const selected = this.selected.value;
    const ofKind = (kind, key) => (selected?.kind === kind ? selected[key] : null);
    painter.draw(scene, others, ofKind("landmark", "id"), ofKind("zone", "name"));
    this.#tool?.draw?.(painter, this.#drag);
    this.#drawCrossHair(painter);
    if (scene?.scan && scene.scanStamp !== this.#drawnScan) {
      this.#drawnScan = scene.scanStamp;
      this.scanToPixels.push(performance.timeOrigin + performance.now() - 1000 * scene.scanStamp);
      if (this.scanToPixels.length > KEPT_DELAYS) this.scanToPixels.shift();
    }
  }

  #drawCrossHair(painter) {
    if (!this.#keyPose) return;
    const [x, y, theta] = this.#keyPose;
    painter.circle(x, y, 14, { stroke: this.#colors.accent, width: 2 });
    if (this.#tool?.onRelease) painter.arrow(x, y, theta, 40, this.#colors.accent);
    else painter.cross(x, y, 5, this.#colors.accent);
  }

  #at(event) {
    const box = this.#canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #onDown(event) {
    this.#canvas.focus({ preventScroll: true });
    this.#setKeyPose(null);
    this.#canvas.setPointerCapture(event.pointerId);
    const [px, py] = this.#at(event);
    this.#pointers.set(event.pointerId, { x: px, y: py });
    if (this.#pointers.size > 1) {
      this.#drag = { kind: "pinch" };
      this.redraw();
      return;
    }
    const from = this.view.toWorld(px, py);
    const isTool = this.#tool?.onRelease && event.button === 0;
    this.#drag = { kind: isTool ? "tool" : "pan", px, py, from, to: from, moved: false, theta: null, button: event.button };
    if (isTool) this.#drag.data = this.#tool.onPress?.(from, PICK_PX / this.view.scale, event.altKey) ?? null;
    if (isTool && this.#tool.panOnEmpty && this.#drag.data === null) this.#drag.kind = "pan";
    this.redraw();
  }

  #onMove(event) {
    const [px, py] = this.#at(event);
    this.cursor.set(this.view.toWorld(px, py));
    const pointer = this.#pointers.get(event.pointerId);
    if (!pointer || !this.#drag) return;
    const drag = this.#drag;
    if (drag.kind === "pinch") this.#pinch(pointer, px, py);
    else if (Math.hypot(px - drag.px, py - drag.py) > CLICK_PX) drag.moved = true;
    if (drag.kind === "pan" && drag.moved) {
      this.following.set(false);
      this.view.pan(px - pointer.x, py - pointer.y);
    }
    if (drag.kind === "tool") {
      drag.to = this.view.toWorld(px, py);
      const isLong = Math.hypot(px - drag.px, py - drag.py) > HEADING_PX;
      drag.theta = isLong ? Math.atan2(drag.to[1] - drag.from[1], drag.to[0] - drag.from[0]) : null;
    }
    pointer.x = px;
    pointer.y = py;
    this.redraw();
  }

  #pinch(pointer, px, py) {
    const [a, b] = [...this.#pointers.values()];
    if (!a || !b) return;
    const other = a === pointer ? b : a;
    const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
    const after = Math.hypot(px - other.x, py - other.y);
    this.view.pan((px - pointer.x) / 2, (py - pointer.y) / 2);
    if (before > 0 && after > 0) this.view.zoom(after / before, (px + other.x) / 2, (py + other.y) / 2);
    this.following.set(false);
  }

  #onUp(event) {
    if (!this.#pointers.delete(event.pointerId)) return;
    const drag = this.#drag;
    if (this.#pointers.size > 0) return;
    this.#drag = null;
    if (drag?.kind === "tool") this.#tool?.onRelease(drag);
    else if (drag?.kind === "pan" && !drag.moved && drag.button === 0) this.#pick(drag.from);
    this.redraw();
  }

  #onDouble(event) {
    this.#tool?.onDouble?.(this.view.toWorld(...this.#at(event)), PICK_PX / this.view.scale);
    this.redraw();
  }

  #onCancel(event) {
    this.#pointers.delete(event.pointerId);
    this.#drag = null;
    this.redraw();
  }

  #pick([x, y]) {
    if (this.#tool?.pick?.([x, y], PICK_PX / this.view.scale)) return;
    const reach = PICK_PX / this.view.scale;
    const place = this.#visible.has("zones") ? nearestPlace(this.scene?.zones ?? [], [x, y], reach) : null;
    if (place) {
      this.selected.set({ kind: "zone", name: place.name });
      return;
    }
    let [best, least] = [null, reach];
    if (this.#visible.has("landmarks"))
      for (const mark of this.scene?.landmarks.values() ?? []) {
        const distance = Math.min(Math.hypot(mark.x - x, mark.y - y), Math.hypot(mark.candidate_x - x, mark.candidate_y - y) || Infinity);
        if (distance < least) [best, least] = [mark.object_id, distance];
      }
    this.selected.set(best === null ? null : { kind: "landmark", id: best });
  }

  #onWheel(event) {
    event.preventDefault();
    const [px, py] = this.#at(event);
    const lines = event.deltaMode === 1 ? 16 : 1;
    const factor = Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0015));
    if (this.following.value) this.view.zoom(factor);
    else this.view.zoom(factor, px, py);
    this.redraw();
  }

  #setKeyPose(pose) {
    this.#keyPose = pose;
    if (pose) this.cursor.set([pose[0], pose[1]]);
    this.redraw();
  }

  /** Arrows move the map below the cross hair, brackets turn its heading, Enter acts there. */
  #onKey(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
    if (event.key === "Escape" && this.#drag) {
      this.#drag = null; // what is dragged stays where it was
      this.redraw();
      return event.preventDefault();
    }
    if (this.#tool?.onKey?.(event.key)) {
      this.redraw();
      return event.preventDefault();
    }
    const { view } = this;
    const theta = this.#keyPose?.[2] ?? 0;
    const pan = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (pan) {
      this.following.set(false);
      view.pan(pan[0] * KEY_PAN_PX, pan[1] * KEY_PAN_PX);
      this.#setKeyPose([view.x, view.y, theta]);
    } else if (event.key === "+" || event.key === "=") this.zoom(1.3);
    else if (event.key === "-") this.zoom(1 / 1.3);
    else if (event.key === "0") this.fit();
    else if (event.key === "[" || event.key === "]")
      this.#setKeyPose([view.x, view.y, theta + (event.key === "[" ? KEY_TURN : -KEY_TURN)]);
    else if (event.key === "Enter") {
      const [x, y] = [view.x, view.y];
      if (this.#tool?.onRelease && !this.#tool.panOnEmpty) {
        const data = this.#tool.onPress?.([x, y], PICK_PX / view.scale) ?? null;
        this.#tool.onRelease({ from: [x, y], to: [x, y], theta, moved: true, data });
      } else this.#pick([x, y]);
    } else if (event.key === "Escape") {
      this.selected.set(null);
      this.#setKeyPose(null);
    } else return;
    event.preventDefault();
  }
}
