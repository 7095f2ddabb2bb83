// The topics of the robot: rates, ages, types, who publishes and subscribes; the last message as a tree.

import { html, useState } from "../vendor/preact-htm.js";
import { useApp, useEvent, useRobot } from "../hooks.js";
import { useStore } from "../store.js";
import { Badge, Empty, Icon, duration, size } from "../ui.js";
import { SearchField, number, shortName, shortType, useComponents, useFresh, useOpenPanel, useRequest } from "./shared.js";

const MESSAGE_HZ = 4;
const FIRST_ITEMS = 50;
const MOST_ITEMS = 2000;
const PREVIEW_ITEMS = 4;
/** Fields of a message that hold one of its constants. */
const ENUMERATIONS = new Set(["state", "kind", "outcome", "behavior", "level", "verdict", "direction"]);

/**
 * Return {topic, type, publishers, subscribers, foreignPublishers, foreignSubscribers, rate, age} per topic, in order of their names.
 *
 * `listed` is that of the event "topics", `advertised` the topics of the connection: in a recording there
 * are no statuses to count by, so a topic may be in one of them only. Numbers that are not known are NaN.
 */
export function mergeTopics(listed, advertised) {
  const rows = new Map();
  for (const { topic, type, channels } of advertised) rows.set(topic, { topic, type, publishers: channels, subscribers: NaN, foreignPublishers: [], foreignSubscribers: [], rate: NaN, age: NaN });
  for (const { topic, type, publishers, subscribers, foreign_publishers: foreignPublishers, foreign_subscribers: foreignSubscribers, rate_hz: rate, age_s: age } of listed)
    rows.set(topic, { topic, type: type || rows.get(topic)?.type || "", publishers, subscribers, foreignPublishers, foreignSubscribers, rate: rate ?? NaN, age: age ?? NaN });
  return [...rows.values()].sort((a, b) => (a.topic < b.topic ? -1 : 1));
}

/** Return who publishes (direction "out") or subscribes ("in") in words: components and foreign nodes by name, others by number. */
export function endpoints(components, topic, direction, count, foreign = []) {
  const names = components.filter((one) => one.ports.some((port) => port.topic === topic && port.direction === direction)).map((one) => one.name);
  names.push(...foreign.map((name) => `${name} (foreign)`));
  const others = Number.isFinite(count) ? count - names.length : 0;
  if (others > 0) names.push(names.length > 0 ? `${others} other${others > 1 ? "s" : ""}` : `${count}`);
  return names.length > 0 ? names.join(", ") : Number.isFinite(count) ? "none" : "not known";
}

export function Topics() {
  const { connection } = useApp();
  const robot = useRobot();
  const listed = useEvent("topics") ?? [];
  const advertised = useStore(connection.topics);
  const [text, setText] = useState("");
  const [opened, setOpened] = useState("");
  useRequest("topics", ({ topic }) => {
    setText("");
    setOpened(topic);
    requestAnimationFrame(() => document.getElementById(`topic-${topic}`)?.scrollIntoView({ block: "start" }));
  });
  const ofRobot = (one) => one.topic.startsWith(`/${robot}/`) || one.topic.split("/").length === 2;
  const all = mergeTopics(listed, advertised.values()).filter(ofRobot);
  const words = text.toLowerCase().split(/\s+/);
  const rows = all.filter((one) => words.every((word) => `${one.topic} ${one.type}`.toLowerCase().includes(word)));
  if (all.length === 0)
    return html`<div class="panel"><${Empty} icon="topics" title="No topics yet">They appear when a component publishes or subscribes.<//></div>`;
  return html`
    <div class="panel">
      <div class="row tools"><${SearchField} label="Filter topics and types" value=${text} onInput=${setText} />
        <span class="muted">${rows.length === all.length ? `${all.length} topics` : `${rows.length} of ${all.length}`}</span></div>
      ${rows.length === 0 && html`<${Empty} icon="search" title="No topic matches">Change the filter.<//>`}
      <ul class="topics" aria-label="Topics">
        ${rows.map((one) => html`
          <li key=${one.topic} id=${`topic-${one.topic}`}>
            <button class="topic-row" aria-expanded=${opened === one.topic} onClick=${() => setOpened(opened === one.topic ? "" : one.topic)}>
              <span class="topic-name">${shortName(one.topic, robot)}</span>
              <span class=${`topic-rate ${one.rate > 0 ? "" : "muted"}`}>${one.publishers === 0 ? "no publisher" : Number.isFinite(one.rate) ? rate(one.rate) : ""}</span>
              <span class="topic-type muted">${shortType(one.type)}</span>
              <span class="topic-age muted">${Number.isFinite(one.age) ? `${duration(one.age)} ago` : ""}</span>
            </button>
            ${opened === one.topic && html`<${Details} one=${one} connection=${connection} />`}
          </li>`)}
      </ul>
    </div>`;
}

const rate = (hertz) => (hertz === 0 ? "silent" : hertz < 0.95 ? `every ${duration(1 / hertz)}` : `${hertz.toFixed(hertz < 9.95 ? 1 : 0)} Hz`);

function Details({ one, connection }) {
  const [held, setHeld] = useState(null);
  const open = useOpenPanel();
  const live = useFresh(one.topic, { maxHz: MESSAGE_HZ });
  const { message, info, age } = held ?? live;
  const decode = connection.decoder(one.topic);
  const components = useComponents() ?? [];
  return html`
    <div class="topic-details">
      <dl class="pairs">
        <dt>Topic</dt><dd class="mono">${one.topic}</dd>
        <dt>Type</dt><dd class="mono">${one.type}</dd>
        <dt>Publishers</dt><dd>${endpoints(components, one.topic, "out", one.publishers, one.foreignPublishers)}</dd>
        <dt>Subscribers</dt><dd>${endpoints(components, one.topic, "in", one.subscribers, one.foreignSubscribers)}</dd>
      </dl>
      ${message
        ? html`
          <div class="row"><strong>Last message</strong><span class="muted">${size(info.bytes)}${held ? ", held" : `, ${duration(age)} ago`}</span><span class="grow" />
            <button class="button small" aria-pressed=${held !== null} onClick=${() => setHeld(held ? null : live)}>
              <${Icon} name=${held ? "play" : "pause"} size=${14} />${held ? "Resume" : "Hold"}</button></div>
          <div class="tree" aria-label=${`Message of ${one.topic}`}>
            <${Entries} value=${message} path="" constants=${decode?.constants ?? {}} onPlot=${(path) => open("plots", { topic: one.topic, path })} /></div>`
        : html`<${Empty} title="No message yet">${decode ? "It is shown as soon as one is published." : "This topic has no publisher, or its type is not known."}<//>`}
    </div>`;
}

/** Return the name of the constant that a field holds, "" without one. */
export function constantName(name, value, constants) {
  if (!ENUMERATIONS.has(name) || typeof value !== "number") return "";
  return Object.keys(constants).find((key) => constants[key] === value) ?? "";
}

/** Return what stands beside the name of a field that contains others. */
export function preview(value) {
  if (ArrayBuffer.isView(value) || Array.isArray(value)) {
    const simple = Array.from(value.slice(0, PREVIEW_ITEMS)).filter((item) => typeof item !== "object");
    const more = value.length > PREVIEW_ITEMS ? ", …" : "";
    return value.length === 0 ? "empty" : `${value.length} element${value.length > 1 ? "s" : ""}${simple.length ? `: ${simple.map(plain).join(", ")}${more}` : ""}`;
  }
  if ("sec" in value && "nanosec" in value) return `${value.sec}.${String(value.nanosec).padStart(9, "0")} s`;
  const names = Object.keys(value);
  if (names.length <= 4 && names.every((name) => typeof value[name] === "number")) return names.map((name) => `${name} ${plain(value[name])}`).join(", ");
  return "";
}

const plain = (value) => (typeof value === "number" || typeof value === "bigint" ? number(value) : typeof value === "string" ? `"${value}"` : String(value));
const isContainer = (value) => value !== null && typeof value === "object";

function Entries({ value, path, constants, onPlot }) {
  const [most, setMost] = useState(FIRST_ITEMS);
  const isList = ArrayBuffer.isView(value) || Array.isArray(value);
  const keys = isList ? Array.from({ length: Math.min(most, value.length) }, (_, index) => index) : Object.keys(value);
  return html`
    ${keys.map((key) => {
      const inner = isList ? `${path}[${key}]` : path ? `${path}.${key}` : key;
      return html`<${Entry} key=${key} name=${isList ? `[${key}]` : key} value=${value[key]} path=${inner} constants=${path ? {} : constants} onPlot=${onPlot} />`;
    })}
    ${isList && value.length > most && most < MOST_ITEMS && html`
      <button class="button small" onClick=${() => setMost(Math.min(MOST_ITEMS, most * 4))}>${value.length - most} more</button>`}`;
}

function Entry({ name, value, path, constants, onPlot }) {
  const [open, setOpen] = useState(false);
  if (isContainer(value)) {
    return html`
      <details open=${open} onToggle=${(event) => setOpen(event.currentTarget.open)}>
        <summary><span class="tree-name">${name}</span> <span class="muted">${preview(value)}</span></summary>
        ${open && html`<div class="tree-inner"><${Entries} value=${value} path=${path} constants=${{}} onPlot=${onPlot} /></div>`}
      </details>`;
  }
  const constant = constantName(name, value, constants);
  const numeric = ["number", "bigint", "boolean"].includes(typeof value);
  return html`
    <div class="tree-leaf"><span class="tree-name">${name}</span>
      <span class="tree-value">${value === "" ? html`<span class="muted">empty</span>` : typeof value === "string" ? value : plain(value)}</span>
      ${constant && html`<${Badge}>${constant}<//>`}
      ${numeric && html`<button class="icon-button tiny" aria-label=${`Plot ${path}`} title=${`Plot ${path}`} onClick=${() => onPlot(path)}><${Icon} name="plots" size=${14} /></button>`}
    </div>`;
}
