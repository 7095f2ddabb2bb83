// The components of the robot as a tree: state, load, losses and reasons; restart, load and unload.

import { html, useState } from "../vendor/preact-htm.js";
import { toast, useAction, useEvent, useRobot } from "../hooks.js";
import { Badge, Empty, Icon, duration, size } from "../ui.js";
import { Confirm, Name, ReadOnlyNote, SearchField, shortName, useComponents, useOpenPanel, useReadOnly, useRequest } from "./shared.js";

const SLOW_HANDLER_S = 1;
const ACTION_LIMIT_MS = 60_000; // a localizer that compiles kernels takes its time
const TONES = { active: "ok", error: "bad", "no answer": "bad", lost: "bad", inactive: "warning", unconfigured: "warning" };

const DONE = { restart: "Restarted", load: "Loaded", unload: "Unloaded" };
const LOSSES = [["drops", "dropped"], ["invalid", "invalid"], ["refused", "refused"]];

/** Return whether a component needs an operator: it has failed, or does not answer. */
export const isFailed = (one) => one.state === "error" || one.state === "no answer";

/** Return in words what is wrong with a component that failed or was restarted. */
export function failureOf(one) {
  const what = isFailed(one) ? { error: "has failed", "no answer": "does not answer" }[one.state] : `was restarted ${one.restarts === 1 ? "once" : `${one.restarts} times`}`;
  return one.reason ? `${what}: ${one.reason.replace(/^restarted: /, "")}` : what;
}

const isLoaded = (one) => one.state !== "not loaded";

/** Return [component, depth] for each component, children below their parent in the given order. */
export function asTree(components) {
  const names = new Set(components.map((one) => one.name));
  const children = new Map();
  for (const one of components) {
    const parent = names.has(one.parent) && one.parent !== one.name ? one.parent : "";
    children.set(parent, [...(children.get(parent) ?? []), one]);
  }
  const rows = [];
  const shown = new Set();
  const visit = (parent, depth) => {
    for (const one of children.get(parent) ?? []) {
      if (shown.has(one.name)) continue;
      shown.add(one.name);
      rows.push([one, depth]);
      visit(one.name, depth + 1);
    }
  };
  visit("", 0);
  for (const one of components) if (!shown.has(one.name)) rows.push([one, 0]); // parents in a circle
  return rows;
}

/** Return the names of a component's descendants. */
export function descendants(components, name) {
  const found = [];
  const visit = (parent) => {
    for (const one of components) {
      if (one.parent !== parent || found.includes(one.name) || one.name === name) continue;
      found.push(one.name);
      visit(one.name);
    }
  };
  visit(name);
  return found;
}

/**
 * Return the names of the components that the robot's motion depends on.
 *
 * They are those from which messages lead, over any number of topics, to the publisher of the base's
 * velocity command.
 */
export function drivingComponents(components) {
  const publishers = new Map();
  for (const one of components)
    for (const port of one.ports ?? [])
      if (port.direction === "out") publishers.set(port.topic, [...(publishers.get(port.topic) ?? []), one]);
  const found = new Set();
  const queue = components.filter((one) => (one.ports ?? []).some((port) => port.direction === "in" && port.port === "cmd_vel"));
  while (queue.length > 0) {
    const one = queue.pop();
    if (found.has(one.name)) continue;
    found.add(one.name);
    for (const port of one.ports ?? []) if (port.direction === "in") queue.push(...(publishers.get(port.topic) ?? []));
  }
  return found;
}

/** Return what stopping a component does to the robot, in words. */
export function consequence(components, name) {
  const driving = drivingComponents(components);
  const below = descendants(components, name).filter((other) => components.some((one) => one.name === other && isLoaded(one)));
  const unknown = driving.size === 0; // no base has reported its ports yet
  const stops = unknown || driving.has(name) || below.some((other) => driving.has(other));
  const also = below.length > 0 ? `Its components stop with it: ${below.join(", ")}. ` : "";
  return also + (stops ? "The robot's motion depends on it: the robot may stop." : "The robot's motion does not depend on it.");
}

export function Components() {
  const components = useComponents();
  const readOnly = useReadOnly();
  const [text, setText] = useState("");
  const [opened, setOpened] = useState(null);
  useRequest("components", ({ component = null }) => setOpened(component));
  if (!components)
    return html`<div class="panel"><${Empty} icon="components" title="No components yet">
      They appear within a second when a deployment runs; start one with cairn up.<//></div>`;
  const words = text.toLowerCase();
  const rows = asTree(components).filter(([one]) => `${one.name} ${one.machine} ${one.plugin} ${one.state} ${one.reason}`.toLowerCase().includes(words));
  const loaded = components.filter(isLoaded);
  const cpu = loaded.reduce((sum, one) => sum + (one.cpu_percent ?? 0), 0);
  const memory = loaded.reduce((sum, one) => sum + (one.memory_bytes ?? 0), 0);
  return html`
    <div class="panel">
      <${ReadOnlyNote} readOnly=${readOnly} />
      <${Machines} />
      <div class="row">
        <${SearchField} label="Filter components" value=${text} onInput=${setText} />
        <span class="muted">${loaded.length} of ${components.length} loaded · ${cpu.toFixed(0)} % CPU · ${size(memory)}</span>
      </div>
      ${rows.length === 0 && html`<${Empty} icon="search" title="No component matches">Change the filter.<//>`}
      <ul class="components" aria-label="Components">
        ${rows.map(([one, depth]) => html`
          <${Row} key=${one.name} one=${one} depth=${words ? 0 : depth} components=${components} readOnly=${readOnly}
            open=${opened === one.name} onToggle=${() => setOpened(opened === one.name ? null : one.name)} />`)}
      </ul>
    </div>`;
}

const milliseconds = (value) => (value === null ? "–" : `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(1)}`);

/** The machines of a robot that has several, as each of them sees the others. */
function Machines() {
  const links = useEvent("machines", { ofRobot: true })?.machines ?? [];
  if (links.length === 0) return null;
  return html`
    <table class="data" aria-label="Machines">
      <thead><tr><th>machine</th><th>seen from</th><th>state</th>
        <th class="number" title="Since its last message arrived">silent</th>
        <th class="number" title="How far its clock is ahead, and within which error this is known">clock [ms]</th></tr></thead>
      <tbody>${links.map((one) => html`
        <tr key=${`${one.machine} ${one.seen_from}`}>
          <td>${one.machine}</td><td>${one.seen_from}</td>
          <td><${Badge} tone=${one.state === "up" ? "ok" : "bad"}>${one.state}<//></td>
          <td class="number">${duration(one.silent_s)}</td>
          <td class="number">${milliseconds(one.clock_offset_ms)}${one.clock_error_ms === null ? "" : ` ± ${one.clock_error_ms.toFixed(1)}`}</td>
        </tr>
        ${one.missing.length > 0 && html`<tr key=${`${one.machine} ${one.seen_from} missing`}>
          <td class="tone-warning wrap" colspan="5">missing on ${one.seen_from}: ${one.missing.join("; ")}</td></tr>`}`)}</tbody>
    </table>`;
}

function Row({ one, depth, components, readOnly, open, onToggle }) {
  const absent = one.state === "not loaded";
  const tone = TONES[one.state] ?? "";
  const busy = one.handler && one.handler_s >= SLOW_HANDLER_S;
  return html`
    <li class=${`component ${absent ? "absent" : ""} ${isFailed(one) ? "failed" : ""}`} style=${{ "--depth": depth }}>
      <button class="component-row" aria-expanded=${open} onClick=${onToggle}>
        <span class="component-name">${one.name}</span>
        ${one.machine && html`<span class="muted component-machine">${one.machine}</span>`}
        <${Badge} tone=${tone}>${one.state}<//>
        <span class="component-figures">
          ${one.restarts > 0 && html`<span class="tone-warning"><${Icon} name="restart" size=${13} />${one.restarts} restart${one.restarts > 1 ? "s" : ""}</span>`}
          ${LOSSES.map(([key, words]) => one[key] > 0 && html`<span key=${key} class="tone-warning">${one[key]} ${words}</span>`)}
          ${busy && html`<span class="tone-warning">in ${one.handler} for ${duration(one.handler_s)}</span>`}
          ${!absent && Number.isFinite(one.cpu_percent) && html`<span class="figure">${one.cpu_percent.toFixed(one.cpu_percent < 10 ? 1 : 0)} %</span>`}
          ${!absent && Number.isFinite(one.memory_bytes) && html`<span class="figure">${size(one.memory_bytes)}</span>`}
        </span>
      </button>
      ${one.reason && html`<p class=${`component-reason ${isFailed(one) ? "tone-bad" : one.restarts > 0 ? "tone-warning" : "muted"}`}>${one.reason}</p>`}
      ${open && html`<${Details} one=${one} components=${components} readOnly=${readOnly} />`}
    </li>`;
}

const lost = (port) => port.dropped + port.invalid + port.refused;

function Details({ one, components, readOnly }) {
  const robot = useRobot();
  const act = useAction();
  const open = useOpenPanel();
  const [asked, setAsked] = useState("");
  const [running, setRunning] = useState("");
  const perform = async (method) => {
    setAsked("");
    setRunning(method);
    const state = await act(method, { component: one.name }, { timeoutMs: ACTION_LIMIT_MS });
    setRunning("");
    if (state !== undefined) toast("info", `${DONE[method]} ${one.name}: ${state}.`);
  };
  const loaded = isLoaded(one);
  const managed = Boolean(one.parent);
  const disabled = Boolean(readOnly || running || !managed);
  const why = readOnly?.words || (!managed ? "The root supervisor ends with the deployment." : "");
  return html`
    <div class="component-details">
      <div class="row">
        ${loaded && html`
          <button class="button small" disabled=${disabled} title=${why} onClick=${() => setAsked("restart")}><${Icon} name="restart" size=${14} />Restart</button>
          <button class="button small" disabled=${disabled} title=${why} onClick=${() => setAsked("unload")}>Unload</button>`}
        ${!loaded && html`<button class="button small primary" disabled=${disabled} title=${why} onClick=${() => perform("load")}>Load</button>`}
        <button class="button small" onClick=${() => open("logs", { component: one.name })}>Logs</button>
        <button class="button small" disabled=${!loaded} onClick=${() => open("parameters", { component: one.name })}>Parameters</button>
        ${running && html`<span class="muted" role="status">${running} …</span>`}
      </div>
      ${asked && html`
        <${Confirm} question=${`${asked === "restart" ? "Restart" : "Unload"} ${one.name}?`} action=${asked === "restart" ? "Restart" : "Unload"}
          onConfirm=${() => perform(asked)} onCancel=${() => setAsked("")}>${consequence(components, one.name)}<//>`}
      <dl class="pairs">
        ${one.plugin && html`<dt>Plugin</dt><dd class="mono">${one.plugin}</dd>`}
        ${one.parent && html`<dt>Supervisor</dt><dd>${one.parent}</dd>`}
        ${one.machine && html`<dt>Machine</dt><dd>${one.machine}</dd>`}
        ${one.pid > 0 && loaded && html`<dt>Process</dt><dd>${one.pid}</dd>`}
        ${one.handler && html`<dt>Handler</dt><dd>${one.handler}, for ${duration(one.handler_s ?? 0)}</dd>`}
      </dl>
      ${one.ports?.length > 0 && html`
        <table class="data">
          <caption class="hidden">Ports of ${one.name}</caption>
          <thead><tr><th>port</th><th>topic</th><th class="number">messages</th><th class="number">lost</th></tr></thead>
          <tbody>${one.ports.map((port) => html`
            <tr key=${`${port.direction} ${port.port}`}>
              <td title=${port.direction === "in" ? "input" : "output"}><span class="muted" aria-hidden="true">${port.direction === "in" ? "→ " : "← "}</span>
                <span class="hidden">${port.direction === "in" ? "input" : "output"} </span><${Name} text=${port.port} /></td>
              <td><button class="link" onClick=${() => open("topics", { topic: port.topic })}><${Name} text=${shortName(port.topic, robot)} /></button></td>
              <td class="number">${port.messages}</td>
              <td class=${`number ${lost(port) > 0 ? "tone-warning" : ""}`} title=${`${port.dropped} dropped, ${port.invalid} invalid, ${port.refused} refused`}>${lost(port)}</td>
            </tr>`)}</tbody>
        </table>`}
    </div>`;
}
