// Diagnostics of devices and components (diagnostic_msgs), the worst first, with their age.

import { html, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { useApp, useInterval, usePageVisible, useRobot } from "../hooks.js";
import { useStore } from "../store.js";
import { Badge, Empty, duration } from "../ui.js";
import { useClock } from "./shared.js";

const TYPE = "diagnostic_msgs/msg/DiagnosticArray";
const LEVELS = ["ok", "warning", "error", "stale"];
const TONES = ["ok", "warning", "bad", "warning"];
const URGENCY = [3, 1, 0, 2]; // of the levels: errors first, then warnings, stale, ok
const SILENT_S = 5;
const MOST_STATUSES = 500;

/** Take a DiagnosticArray into the map of statuses by topic and name; `at` is the time of arrival [ms]. */
export function takeStatuses(statuses, topic, { status }, at) {
  for (const one of status) {
    const key = `${one.hardware_id} ${one.name}`; // with `ros_names` it arrives on two topics
    const known = statuses.get(key);
    if (known || statuses.size < MOST_STATUSES) statuses.set(key, { key, topic: known?.topic ?? topic, at, ...one });
  }
}

/** Return statuses with {age [s], silent}, the most urgent first; silent ones count as stale. */
export function sortStatuses(statuses, now) {
  return [...statuses]
    .map((one) => {
      const age = Math.max(0, now - one.at) / 1000;
      const silent = age > SILENT_S;
      return { ...one, age, silent, shown: silent && one.level === 0 ? 3 : one.level };
    })
    .sort((a, b) => (URGENCY[a.shown] ?? 0) - (URGENCY[b.shown] ?? 0) || (a.name < b.name ? -1 : a.name > b.name ? 1 : 0));
}

/** Return the tone of a sorted status: what is silent is a warning, in all that is shown of it. */
export const toneOf = ({ shown }) => TONES[shown] ?? "bad";

export function Diagnostics() {
  const { connection } = useApp();
  const robot = useRobot();
  const topics = useStore(connection.topics);
  const names = [...topics.values()].filter((one) => one.type === TYPE && (one.topic.startsWith(`/${robot}/`) || one.topic === "/diagnostics")).map((one) => one.topic);
  const statuses = useRef(new Map());
  const [, render] = useState(0);
  const [opened, setOpened] = useState(new Set());
  const key = names.join(" ");
  const visible = usePageVisible();
  const clock = useRef(null);
  const shownAt = clock.current?.now ?? 0;
  clock.current = useClock();
  if (clock.current.now < shownAt) // a recording has gone back
    for (const [key, one] of statuses.current) if (one.at > clock.current.now) statuses.current.delete(key);
  useEffect(() => {
    statuses.current = new Map();
  }, [connection, robot]);
  useEffect(() => {
    if (!visible) return undefined;
    const ends = names.map((name) => connection.subscribe(name, (message, info) => takeStatuses(statuses.current, name, message, clock.current.at(info)), { maxHz: 5 }));
    return () => ends.forEach((end) => end());
  }, [connection, robot, key, visible]);
  useInterval(() => render((count) => count + 1), 500);
  if (names.length === 0)
    return html`<div class="panel"><${Empty} icon="diagnostics" title="No diagnostics">
      No component of ${robot || "the robot"} publishes diagnostic messages. Drivers of devices do; simulated devices do not.<//></div>`;
  const rows = sortStatuses(statuses.current.values(), clock.current.now);
  if (rows.length === 0) return html`<div class="panel"><${Empty} icon="diagnostics" title="No diagnostics yet">${names.join(", ")}: no message so far.<//></div>`;
  const toggle = (one) =>
    setOpened((current) => {
      const next = new Set(current);
      if (!next.delete(one.key)) next.add(one.key);
      return next;
    });
  const counts = LEVELS.map((_, level) => rows.filter((one) => one.shown === level).length);
  return html`
    <div class="panel">
      <div class="row" role="status">${[2, 1, 3, 0].filter((level) => counts[level] > 0).map((level) => html`<${Badge} key=${level} tone=${TONES[level]}>${counts[level]} ${LEVELS[level]}<//>`)}</div>
      <ul class="components" aria-label="Diagnostics">
        ${rows.map((one) => html`
          <li key=${one.key} class="component">
            <button class="component-row" aria-expanded=${opened.has(one.key)} onClick=${() => toggle(one)}>
              <span class="component-name">${one.name}</span>
              <${Badge} tone=${toneOf(one)}>${LEVELS[one.shown] ?? `level ${one.shown}`}<//>
              <span class=${`component-figures ${one.silent ? "tone-warning" : ""}`}>${one.silent ? `no message for ${duration(one.age)}` : `${duration(one.age)} ago`}</span>
            </button>
            <p class=${`component-reason ${one.shown > 0 ? `tone-${toneOf(one)}` : "muted"}`}>${one.message}</p>
            ${opened.has(one.key) && html`
              <div class="component-details"><dl class="pairs">
                ${one.hardware_id && html`<dt>Hardware</dt><dd>${one.hardware_id}</dd>`}
                ${one.values.map(({ key: name, value }) => html`<dt key=${name}>${name}</dt><dd class="mono">${value}</dd>`)}
                <dt>Topic</dt><dd class="mono">${one.topic}</dd>
              </dl></div>`}
          </li>`)}
      </ul>
    </div>`;
}
