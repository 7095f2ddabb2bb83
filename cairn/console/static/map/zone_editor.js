// The parts of the page that draw and change zones: the hint of the tool, and the details of a zone.

import { html, useEffect, useState } from "../vendor/preact-htm.js";
import { useApp, useTopic } from "../hooks.js";
import { useStore } from "../store.js";
import { Badge } from "../ui.js";
import { ringsOf, shape } from "./zone_shape.js";
import { draft, isArea, KIND_TITLES, KINDS, LEAST_POINTS, newZone, zonesOf } from "./zones.js";

const TONES = { keepout: "bad", slow: "warning", lane: "accent", place: "ok" };
const DEGREES = 180 / Math.PI;

/** What is said and offered while the tool for zones is active; `add(zone)` adds what was drawn, `saveShape()` saves a changed one. */
export function ZoneHint({ controller, add, saveShape }) {
  const { kind, points } = useStore(draft);
  const edited = useStore(shape);
  const message = useTopic("zones");
  const selected = useStore(controller.selected);
  const set = (value) => {
    draft.set(value);
    controller.selected.set(null); // its details would cover a part of the map
    controller.redraw();
  };
  useEffect(
    () => () => {
      draft.set({ kind: "", points: [] });
      shape.set(null);
    },
    [],
  );
  // The changed shape belongs to the selected zone.
  useEffect(() => {
    if (shape.value && shape.value.name !== selected?.name) shape.set(null);
    controller.redraw();
  }, [selected]);
  const discard = () => {
    shape.set(null);
    controller.redraw();
  };
  const words = () => {
    const zone = selected?.kind === "zone" && message && zonesOf(message).find((one) => one.name === selected.name);
    if (!zone) return "Press on a zone to change it, or draw one:";
    if (zone.kind === "place") return "Drag the place to move it, or draw another zone:";
    return "Drag corners; double-click adds or removes one. Or draw:";
  };
  if (edited?.rings)
    return html`
      <span>The shape of ${edited.name} is changed.</span>
      <button class="button small primary" onClick=${saveShape}>Save shape</button>
      <button class="button small" onClick=${discard}>Discard</button>`;
  if (!kind)
    return html`
      <span>${words()}</span>
      ${KINDS.map((one) => html`<button key=${one} class="button small" onClick=${() => set({ kind: one, points: [] })}>${KIND_TITLES[one]}</button>`)}`;
  const task = { place: "Press at the place, drag toward the heading.", lane: "Press at each point of the lane." }[kind] ?? "Press at each corner.";
  const done = () => add(newZone(kind, points, controller.scene?.zones ?? []));
  return html`
    <span>${points.length === 0 ? task : `${points.length} point${points.length > 1 ? "s" : ""}`}</span>
    ${points.length >= LEAST_POINTS[kind] && html`<button class="button small primary" onClick=${done}>Add zone</button>`}
    ${points.length > 0 && html`<button class="button small" onClick=${() => set({ kind, points: points.slice(0, -1) })}>Undo</button>`}
    <button class="button small" onClick=${() => set({ kind: "", points: [] })}>Cancel</button>`;
}

/** A zone: what it is; change it, remove it, and drive to it if it is a place. */
export function ZoneDetails({ name, head, change, go, close, mayChange }) {
  const message = useTopic("zones");
  const zone = message && zonesOf(message).find((one) => one.name === name);
  if (!zone) return html`${head(name, null)}<p class="muted">It is no longer on the map.</p>`;
  return html`
    ${head(name, html`<${Badge} tone=${TONES[zone.kind]}>${KIND_TITLES[zone.kind]}<//>`)}
    ${zone.kind === "place" &&
    mayChange &&
    html`<div class="row"><button class="button small primary" onClick=${() => go(name)}>Go to ${name}</button></div>`}
    ${mayChange ? html`<${ZoneForm} key=${name} zone=${zone} change=${change} close=${close} />` : html`<${ZoneFacts} zone=${zone} />`}`;
}

function ZoneFacts({ zone }) {
  const [x, y] = zone.rings[0][0];
  return html`
    <dl class="facts">
      <div><dt>${zone.kind === "place" ? "Position" : "First point"}</dt><dd>${x.toFixed(2)}, ${y.toFixed(2)} m</dd></div>
      ${zone.kind === "slow" && html`<div><dt>Speed</dt><dd>${zone.speed} m/s</dd></div>`}
      ${zone.kind === "lane" && html`<div><dt>Width</dt><dd>${zone.width} m</dd></div>`}
    </dl>`;
}

function ZoneForm({ zone, change, close }) {
  const [name, setName] = useState(zone.name);
  const [kind, setKind] = useState(zone.kind);
  const [speed, setSpeed] = useState(zone.speed || 0.2);
  const [width, setWidth] = useState(zone.width || 0.8);
  const [degrees, setDegrees] = useState(zone.heading === null ? "" : String(Math.round(zone.heading * DEGREES)));
  const save = (event) => {
    event.preventDefault();
    const heading = degrees === "" ? null : Number(degrees) / DEGREES;
    change({ ...zone, rings: ringsOf(zone), kind, name: name.trim(), speed: Number(speed), width: Number(width), heading }, zone.name);
  };
  const number = (label, value, set, extra) => html`
    <label class="field"><span>${label}</span>
      <input class="input" type="number" value=${value} onInput=${(event) => set(event.target.value)} ...${extra} />
    </label>`;
  return html`
    <form class="zone-form" onSubmit=${save}>
      <label class="field"><span>Name</span>
        <input class="input" value=${name} maxlength="64" required onInput=${(event) => setName(event.target.value)} />
      </label>
      ${isArea(zone) &&
      html`<label class="field"><span>Kind</span>
        <select value=${kind} onChange=${(event) => setKind(event.target.value)}>
          <option value="keepout">Keepout</option><option value="slow">Slow</option>
        </select>
      </label>`}
      ${kind === "slow" && number("Speed [m/s]", speed, setSpeed, { min: 0.05, max: 3, step: 0.05, required: true })}
      ${kind === "lane" && number("Width [m]", width, setWidth, { min: 0.1, max: 20, step: 0.1, required: true })}
      ${kind === "place" && number("Heading [°], empty for any", degrees, setDegrees, { min: -360, max: 360, step: 1 })}
      <div class="row">
        <button class="button small" type="submit">Save</button>
        <button class="button small danger" type="button" onClick=${() => change(null, zone.name).then((done) => done && close())}>Remove</button>
      </div>
    </form>`;
}
