// The map: canvas, tools, layers, and what explains a clicked thing.

import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../vendor/preact-htm.js";
import { toast, useApp, useEvent, useInterval, usePageVisible, useRobot, useTopic } from "../hooks.js";
import { useSteer } from "../steering.js";
import { SavedStore, useStore } from "../store.js";
import { Badge, Empty, Icon } from "../ui.js";
import { MapController } from "./controller.js";
import { scaleBar } from "./geometry.js";
import { HIDDEN_AT_FIRST, LAYERS } from "./scene.js";
import { ZoneDetails, ZoneHint } from "./zone_editor.js";
import { ringsOf, shape } from "./zone_shape.js";
import { zoneTool } from "./zone_tool.js";
import { draft, featureOf, middleOf, zonesOf } from "./zones.js";
import { adding, goalTool, movement, poseTool, things, waypoints, waypointTool, worldTool } from "./tools.js";

const BAR_PX = 110;
const WORLD_PERIOD_MS = 1000;
const TURN = Math.PI / 12;
const REWIND_NS = 100e6;

const shownLayers = new SavedStore("layers", LAYERS.map((layer) => layer.id).filter((id) => !HIDDEN_AT_FIRST.includes(id)));

const TOOLS = [
  { id: "", title: "Move the map, select", icon: "pan" },
  { id: "goal", title: "Goal: press at the position, drag toward the heading", icon: "goal", steers: true },
  { id: "waypoints", title: "Waypoints: press at each position, then send", icon: "waypoints", steers: true },
  { id: "pose", title: "Initial pose: press where the robot is, drag toward its heading", icon: "pose", steers: true },
  { id: "zones", title: "Zones: draw, change and remove keepout and slow zones, lanes and places", icon: "zone", steers: true },
  { id: "world", title: "Simulated world: move, add and remove things and people", icon: "world", steers: true, simulated: true },
];

export function MapView({ robots }) {
  const { connection, theme, mode } = useApp();
  const robot = useRobot();
  const layers = useStore(shownLayers);
  const steer = useSteer();
  const [toolId, setTool] = useState("");
  const canvas = useRef(null);
  const isShown = usePageVisible();
  const controller = useMemo(() => new MapController(connection), [connection]);
  const isSimulated = useStore(connection.topics).has(`/${robot}/world_geometry`);
  const mayWatchOnly = useStore(connection.hello)?.may === "watch";
  const tools = TOOLS.filter((tool) => !tool.steers || (mode === "live" && !mayWatchOnly && (!tool.simulated || isSimulated)));
  const tool = tools.some((one) => one.id === toolId) ? toolId : "";
  const visible = useMemo(() => new Set(tool === "world" || tool === "zones" ? [...layers, tool] : layers), [layers, tool]);

  useEffect(() => {
    controller.attach(canvas.current);
    if (globalThis.cairnConsole) globalThis.cairnConsole.map = controller;
    return () => controller.detach();
  }, [controller]);
  useEffect(() => controller.setRobots(robots, robot, visible, isShown), [controller, robots.join(), robot, visible, isShown]);
  useEffect(() => {
    const media = matchMedia("(prefers-color-scheme: dark)");
    const refresh = () => controller.refreshColors();
    media.addEventListener("change", refresh);
    const end = theme.subscribe(() => requestAnimationFrame(refresh));
    return () => {
      media.removeEventListener("change", refresh);
      end();
    };
  }, [controller, theme]);
  useEffect(() => {
    let last = 0;
    const ends = [
      connection.hello.subscribe(() => controller.reset()),
      connection.event("playback").subscribe((playback) => {
        if (playback && playback.time_ns < last - REWIND_NS) controller.rewind();
        last = playback?.time_ns ?? 0;
      }),
    ];
    return () => ends.forEach((end) => end());
  }, [controller, connection]);

  const send = async (poses) => {
    if ((await steer("go", { poses })) === undefined) return false;
    const [first] = poses;
    const where = typeof first === "string" ? first : `${first[0].toFixed(2)}, ${first[1].toFixed(2)}`;
    toast("info", poses.length > 1 ? `${poses.length} waypoints sent.` : `Goal sent: ${where}.`);
    return true;
  };
  const locate = async ([x, y, theta]) => {
    if ((await steer("locate", { x, y, theta })) !== undefined) toast("info", "The initial pose was sent.");
    setTool("");
  };
  const change = async (verb, parameters) => {
    await steer("world", { verb, arguments: parameters });
    await readWorld(connection, robot);
    controller.redraw();
  };
  /** Replace the zone `name` by `zone`, remove it (null), or add a zone (no name); return whether that was done. */
  const changeZone = async (zone, name) => {
    const request = zone ? { feature: featureOf(zone), ...(name ? { replace: name } : {}) } : { name };
    const before = controller.selected.value;
    const answer = await steer("zones", { verb: zone ? "add_zone" : "remove_zone", arguments: request });
    if (answer === undefined) return false;
    if (!name || shape.value?.name === name) shape.set(null); // it is saved, or its zone is removed
    if (!answer.saved) toast("warning", `${answer.file} cannot be saved now; the change is in force.`);
    if (zone && controller.selected.value === before) controller.selected.set({ kind: "zone", name: zone.name });
    controller.redraw();
    return true;
  };
  const addZone = async (zone) => {
    if (await changeZone(zone)) draft.set({ kind: "", points: [] });
  };
  const saveShape = () => {
    const zone = controller.scene?.zones.find((one) => one.name === shape.value?.name);
    if (zone) changeZone({ ...zone, rings: ringsOf(zone) }, zone.name);
  };
  const callbacks = useRef(null);
  callbacks.current = { send, locate, change, addZone, saveShape };
  // Before the next event: a later effect would undo what is pressed on the map meanwhile.
  useLayoutEffect(() => {
    const make = {
      goal: () => goalTool(controller, (poses) => callbacks.current.send(poses)),
      waypoints: () => waypointTool(controller),
      pose: () => poseTool(controller, (pose) => callbacks.current.locate(pose)),
      zones: () => zoneTool(controller, (zone) => callbacks.current.addZone(zone), () => callbacks.current.saveShape()),
      world: () => worldTool(controller, (...request) => callbacks.current.change(...request)),
    }[tool];
    controller.setTool(make ? make() : null);
    controller.selected.set(null);
    adding.set("");
  }, [controller, tool]);

  return html`
    <section class=${`map-area ${tool ? "armed" : ""}`} aria-label="Map">
      <canvas ref=${canvas} class="map-canvas" tabindex="0"
        aria-label="Map. Arrows move it, plus and minus zoom, 0 shows all; with a tool, brackets turn the heading and Enter acts at the center. Of a selected zone, brackets choose a corner, arrows move it, Insert adds one, Delete removes it, Enter saves, and Escape discards." />
      <${MapEmpty} controller=${controller} />
      <div class="map-tools" role="toolbar" aria-label="Tools" aria-orientation="vertical">
        ${tools.map(
          (one) => html`
            <button key=${one.id} class="icon-button" aria-pressed=${tool === one.id} aria-label=${one.title} title=${one.title}
              onClick=${() => setTool(one.id)}><${Icon} name=${one.icon} /></button>`,
        )}
      </div>
      <${ViewButtons} controller=${controller} />
      <${ToolHint} tool=${tool} controller=${controller} send=${send} addZone=${addZone} saveShape=${saveShape} done=${() => setTool("")} />
      <${Inspector} controller=${controller} change=${change} changeZone=${changeZone} send=${send} mayChange=${mode === "live" && !mayWatchOnly} />
      <${ScaleAndCursor} controller=${controller} />
    </section>`;
}

async function readWorld(connection, robot) {
  try {
    const listed = await connection.call("world", { robot, verb: "list", arguments: {} });
    if (Array.isArray(listed)) things.set(listed);
  } catch (error) {
    toast("error", error.message);
  }
}

function MapEmpty({ controller }) {
  const content = useStore(controller.content);
  const { mode } = useApp();
  if (content === "map" || content === "pose") return null;
  return html`
    <div class="map-empty">
      <${Empty} icon="map" title="Nothing to show yet">
        ${mode === "recording"
          ? "Press play, or move the time line: the map appears when the recording has it."
          : "Map and pose appear when localization starts: with the deployment, or with the first goal."}
      <//>
    </div>`;
}

function ViewButtons({ controller }) {
  const following = useStore(controller.following);
  const [open, setOpen] = useState(false);
  const follow = () => {
    controller.following.set(!following);
    controller.redraw();
  };
  const button = (title, icon, onClick, extra = {}) =>
    html`<button class="icon-button" title=${title} aria-label=${title} onClick=${onClick} ...${extra}><${Icon} name=${icon} /></button>`;
  return html`
    <div class="map-view" onKeyDown=${(event) => event.key === "Escape" && setOpen(false)}>
      ${button("Layers and legend", "layers", () => setOpen(!open), { "aria-expanded": open, "aria-pressed": open })}
      ${button("Follow the robot", "follow", follow, { "aria-pressed": following })}
      ${button("Show the whole map", "fit", () => controller.fit())}
      ${button("Zoom in", "plus", () => controller.zoom(1.4))} ${button("Zoom out", "minus", () => controller.zoom(1 / 1.4))}
      ${open && html`<${LayerList} />`}
    </div>`;
}

function LayerList() {
  const layers = useStore(shownLayers);
  const { connection } = useApp();
  const robot = useRobot();
  const topics = useStore(connection.topics);
  const toggle = (id) => shownLayers.set(layers.includes(id) ? layers.filter((one) => one !== id) : [...layers, id]);
  const exists = (layer) => layer.topics.length === 0 || layer.topics.some((topic) => topics.has(`/${robot}/${topic}`));
  return html`
    <fieldset class="popover layers">
      <legend class="hidden">Layers</legend>
      ${LAYERS.map(
        (layer) => html`
          <label key=${layer.id} class=${exists(layer) ? "" : "absent"} title=${exists(layer) ? "" : "Nothing publishes this now"}>
            <input type="checkbox" checked=${layers.includes(layer.id)} onChange=${() => toggle(layer.id)} />
            <span class="swatch" style=${{ background: `var(${layer.swatch})` }} />
            <span>${layer.title}</span>
          </label>`,
      )}
      <div class="legend">
        <span>Reliability of landmarks</span>
        <span class="ramp" aria-hidden="true" /><span class="ramp-ends"><span>0 moved</span><span>1 sure</span></span>
        <span class="muted">Crossed: removed; dashed: where it seems to be now. Ellipses: 2 σ.</span>
      </div>
    </fieldset>`;
}

function ToolHint({ tool, controller, send, addZone, saveShape, done }) {
  const poses = useStore(waypoints);
  const add = useStore(adding);
  const { connection } = useApp();
  const robot = useRobot();
  useEffect(() => {
    if (tool === "world") readWorld(connection, robot).then(() => controller.redraw());
  }, [tool, robot]);
  useInterval(() => tool === "world" && readWorld(connection, robot).then(() => controller.redraw()), WORLD_PERIOD_MS);
  const update = (value) => {
    waypoints.set(value);
    controller.redraw();
  };
  if (!tool) return null;
  const content = {
    goal: html`<span>Press at the goal, drag toward the heading.</span>`,
    pose: html`<span>Press where the robot is, drag toward its heading.</span>`,
    waypoints: html`
      <span>${poses.length === 0 ? "Press at each waypoint, drag toward its heading." : `${poses.length} waypoint${poses.length > 1 ? "s" : ""}`}</span>
      ${poses.length > 0 &&
      html`<button class="button small primary" onClick=${async () => (await send(poses)) && update([])}>Send</button>
        <button class="button small" onClick=${() => update(poses.slice(0, -1))}>Undo</button>
        <button class="button small" onClick=${() => update([])}>Clear</button>`}`,
    zones: html`<${ZoneHint} controller=${controller} add=${addZone} saveShape=${saveShape} />`,
    world: html`
      <span>${{ person: "Press where the person stands; drag for a walk to and fro.", box: "Press where the box stands, drag to turn it." }[add] ?? "Drag a thing to move it."}</span>
      <button class="button small" aria-pressed=${add === "box"} onClick=${() => adding.set(add === "box" ? "" : "box")}>Add box</button>
      <button class="button small" aria-pressed=${add === "person"} onClick=${() => adding.set(add === "person" ? "" : "person")}>Add person</button>`,
  }[tool];
  return html`
    <div class="popover tool-hint">
      ${content}
      <button class="icon-button" onClick=${done} aria-label="End this tool" title="End this tool"><${Icon} name="close" size=${16} /></button>
    </div>`;
}

function Inspector({ controller, change, changeZone, send, mayChange }) {
  const selected = useStore(controller.selected);
  const zones = useTopic("zones");
  const close = () => {
    if (controller.selected.value !== selected) return; // another thing was selected while an answer was awaited
    controller.selected.set(null);
    controller.redraw();
  };
  if (!selected) return null;
  const zone = selected.kind === "zone" && zones && zonesOf(zones).find((one) => one.name === selected.name);
  // On the other side than the zone, so that its corners can be reached.
  const isLeft = zone && controller.view.toScreen(...middleOf(zone))[0] < controller.view.width / 2;
  return html`
    <section class=${`popover inspector ${selected.kind === "zone" ? "of-zone" : ""} ${isLeft ? "at-right" : ""}`} aria-label="Details" onKeyDown=${(event) => event.key === "Escape" && close()}>
      ${selected.kind === "landmark"
        ? html`<${Landmark} key=${selected.id} id=${selected.id} controller=${controller} close=${close} />`
        : selected.kind === "zone"
          ? html`<${ZoneDetails} key=${selected.name} name=${selected.name} mayChange=${mayChange} change=${changeZone} close=${close}
              go=${(name) => send([name])} head=${(title, badge) => html`<${Head} title=${title} badge=${badge} close=${close} />`} />`
          : html`<${Thing} name=${selected.name} change=${change} close=${close} />`}
    </section>`;
}

const Head = ({ title, badge, close }) => html`
  <header><h3>${title}</h3>${badge}
    <button class="icon-button" onClick=${close} aria-label="Close" title="Close"><${Icon} name="close" size=${16} /></button>
  </header>`;

/** A landmark: what the map has of it, and the chain of evidence, newest first. */
function Landmark({ id, close }) {
  const { connection } = useApp();
  const robot = useRobot();
  const map = useTopic("visual_map");
  const mark = map?.objects.find((one) => one.object_id === id);
  const [why, setWhy] = useState(null);
  const [error, setError] = useState("");
  const version = mark ? `${mark.evidence_count} ${mark.state}` : "";
  useEffect(() => {
    let isShown = true;
    connection.call("why", { robot, object_id: id }).then(
      (answer) => isShown && (setWhy(answer), setError("")),
      (problem) => isShown && setError(problem.message),
    );
    return () => (isShown = false);
  }, [connection, robot, id, version]);
  if (!mark) return html`<${Head} title=${`Object ${id}`} close=${close} /><p class="muted">It is no longer in the map.</p>`;
  const isLive = mark.state === 0;
  const tone = mark.reliability > 0.5 ? "ok" : mark.reliability > 0.1 ? "warning" : "bad";
  const steps = [...(why?.steps ?? [])].reverse();
  return html`
    <${Head} title=${mark.name || `Object ${id}`} close=${close} badge=${html`<${Badge} tone=${isLive ? tone : "bad"}>${isLive ? "in the map" : "removed"}<//>`} />
    <dl class="facts">
      <div><dt>Reliability</dt><dd>${mark.reliability.toFixed(2)}</dd></div>
      <div><dt>Position</dt><dd>${mark.x.toFixed(2)}, ${mark.y.toFixed(2)} m</dd></div>
      <div><dt>Evidence</dt><dd>${mark.evidence_count}</dd></div>
      ${!Number.isNaN(mark.candidate_x) && html`<div><dt>May be at</dt><dd>${mark.candidate_x.toFixed(2)}, ${mark.candidate_y.toFixed(2)} m (${mark.candidate_reliability.toFixed(2)})</dd></div>`}
    </dl>
    ${why?.now && html`<p class="muted">It ${why.now}.</p>`}
    ${error && html`<p class="tone-bad">${error}</p>`}
    ${!why && !error && html`<p class="muted">Reading its evidence …</p>`}
    ${steps.length > 0 &&
    html`<ol class="evidence" aria-label="Evidence, newest first">
      ${steps.map(
        (step, i) => html`<li key=${`${step.stamp_ns} ${i}`} class=${step.counted === false ? "uncounted" : step.counted === null ? "change" : ""}>
          <time title=${step.time}>${step.stamp_ns ? new Date(step.stamp_ns / 1e6).toLocaleTimeString() : "import"}</time><span>${step.text}${step.times > 1 ? ` (${step.times} times)` : ""}</span>
        </li>`,
      )}
      ${why.left_out > 0 && html`<li class="uncounted"><time /><span>${why.left_out} earlier steps: cairn map why has them.</span></li>`}
    </ol>`}`;
}

/** A thing of the simulated world: turn it, remove it. */
function Thing({ name, change, close }) {
  const thing = useStore(things).find((one) => one.name === name);
  if (!thing) return html`<${Head} title=${name} close=${close} /><p class="muted">It is no longer in the world.</p>`;
  const turn = (angle) => change(...movement(thing, [thing.x, thing.y, Math.atan2(Math.sin(thing.theta + angle), Math.cos(thing.theta + angle))]));
  return html`
    <${Head} title=${name} close=${close} badge=${html`<${Badge}>${thing.kind}<//>`} />
    <dl class="facts">
      <div><dt>Position</dt><dd>${thing.x.toFixed(2)}, ${thing.y.toFixed(2)} m</dd></div>
      ${thing.kind !== "person" && html`<div><dt>Heading</dt><dd>${Math.round((thing.theta * 180) / Math.PI)}°</dd></div>`}
    </dl>
    <div class="row">
      ${thing.kind !== "person" &&
      html`<button class="button small" onClick=${() => turn(TURN)}>Turn left</button>
        <button class="button small" onClick=${() => turn(-TURN)}>Turn right</button>`}
      ${thing.kind !== "robot" && html`<button class="button small danger" onClick=${() => change("remove", { name }).then(close)}>Remove</button>`}
    </div>`;
}

function ScaleAndCursor({ controller }) {
  const scale = useStore(controller.scale);
  const cursor = useStore(controller.cursor);
  const length = scaleBar(scale, BAR_PX);
  const value = cursor && controller.scene?.grid?.valueAt(...cursor);
  const cell = value === null || value === undefined ? "" : value < 0 ? "unknown" : value < 50 ? "free" : "occupied";
  return html`
    <div class="map-scale">
      <span class="bar" style=${{ width: `${length * scale}px` }}>${length < 1 ? `${Math.round(100 * length)} cm` : `${length} m`}</span>
      ${cursor && html`<span class="cursor">${cursor[0].toFixed(2)}, ${cursor[1].toFixed(2)} m <span class="muted">${cell}</span></span>`}
    </div>`;
}
