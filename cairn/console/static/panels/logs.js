// Log messages: the history, then live; filters by component, level and text; steps from problem to problem.

import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "../vendor/preact-htm.js";
import { useApp, useInterval, useRobot, useSubscription } from "../hooks.js";
import { useStore } from "../store.js";
import { Badge, Empty, Icon } from "../ui.js";
import { ErrorNote, SearchField, useComponents, useOpenPanel, useRequest } from "./shared.js";
import { failureOf, isFailed } from "./components.js";

const MOST_RECORDS = 5000;
const OVERSCAN = 8; // rows drawn above and below those in view
const ROW_PX = { wide: 24, narrow: 42 };
const WIDE_PX = 560;
const PAINT_MS = 100;
const WARN = 30;
const ERROR = 40;
const LEVELS = [[0, "all levels"], [20, "from info"], [WARN, "from warning"], [ERROR, "errors"]];
const MOST_FAILED = 3; // components whose failure is shown above the messages

/** Return the name of a level of rcl_interfaces/msg/Log. */
export const levelName = (level) =>
  level >= 50 ? "FATAL" : level >= ERROR ? "ERROR" : level >= WARN ? "WARN" : level >= 20 ? "INFO" : "DEBUG";

/** Return a record for the panel from a rcl_interfaces/msg/Log; `component` has no robot's name. */
export function recordOf({ stamp, level, name, msg, file = "", function: caller = "", line = 0 }) {
  const [robot, ...rest] = name.split(".");
  return {
    id: `${stamp.sec}.${stamp.nanosec} ${name} ${msg}`,
    time: stamp.sec + stamp.nanosec * 1e-9,
    level,
    robot: rest.length > 0 ? robot : "",
    component: rest.length > 0 ? rest.join(".") : name,
    text: msg,
    where: file ? `${file}:${line}${caller ? ` in ${caller}` : ""}` : "",
  };
}

/** The newest records in order of time, each once; the oldest are dropped. */
export class LogBuffer {
  constructor(most = MOST_RECORDS) {
    this.most = most;
    this.records = [];
    this.ids = new Set();
    this.dropped = 0;
  }

  /** Add records; return how many were new. */
  add(records) {
    let added = 0;
    let sorted = true;
    for (const record of records) {
      if (this.ids.has(record.id)) continue;
      this.ids.add(record.id);
      sorted &&= this.records.length === 0 || this.records.at(-1).time <= record.time;
      this.records.push(record);
      added += 1;
    }
    if (!sorted) this.records.sort((a, b) => a.time - b.time);
    // Some more than the limit are kept, so that not each new record moves all others.
    if (this.records.length > this.most * 1.1) {
      const excess = this.records.splice(0, this.records.length - this.most);
      for (const { id } of excess) this.ids.delete(id);
      this.dropped += excess.length;
    }
    return added;
  }
}

/**
 * Return the records of a component ("" for all) from a level on that contain all words of a text.
 *
 * Those of other components that name it are among them: its supervisor logs why it was restarted.
 */
export function filterRecords(records, { component = "", level = 0, text = "" }) {
  const named = new RegExp(`(^|[^\\w])${component.replace(/[^\w]/g, "\\$&")}($|[^\\w])`);
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  if (!component && level === 0 && words.length === 0) return records;
  return records.filter(
    (record) =>
      record.level >= level &&
      (!component || record.component === component || named.test(record.text)) &&
      words.every((word) => record.text.toLowerCase().includes(word) || record.component.includes(word)),
  );
}

/** Return the index of the nearest warning or error from `index` on in a direction (1 or -1), -1 without one. */
export function nextProblem(records, index, step) {
  for (let at = index + step; at >= 0 && at < records.length; at += step) if (records[at].level >= WARN) return at;
  return -1;
}

const clock = (time) => {
  const date = new Date(time * 1000);
  const two = (value) => String(value).padStart(2, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.${String(date.getMilliseconds()).padStart(3, "0")}`;
};

// Of each connection and robot: what was read stays when the panel is closed.
const buffers = new WeakMap();

function bufferOf(connection, robot) {
  if (!buffers.has(connection)) buffers.set(connection, new Map());
  const ofRobots = buffers.get(connection);
  if (!ofRobots.has(robot)) ofRobots.set(robot, new LogBuffer());
  return ofRobots.get(robot);
}

export function Logs() {
  const { connection } = useApp();
  const robot = useRobot();
  const buffer = bufferOf(connection, robot);
  const [filter, setFilter] = useState({ component: "", level: 0, text: "" });
  const [version, setVersion] = useState(0);
  const [held, setHeld] = useState(null); // the records when the view was paused
  const [selected, setSelected] = useState("");
  const [error, setError] = useState("");
  const waiting = useRef([]);
  const isLive = useStore(connection.hello)?.mode === "live"; // a recording has its messages on the topic

  const change = (changes) => setFilter((current) => ({ ...current, ...changes }));
  useRequest("logs", ({ component }) => {
    setFilter({ component, level: 0, text: "" });
    setHeld(null);
  });
  useSubscription("/rosout", (message) => {
    const record = recordOf(message);
    if (!record.robot || record.robot === robot) waiting.current.push(record);
    if (waiting.current.length > MOST_RECORDS) waiting.current.shift();
  });
  useInterval(() => {
    if (waiting.current.length === 0) return;
    if (buffer.add(waiting.current.splice(0)) > 0) setVersion((count) => count + 1);
  }, PAINT_MS);
  useEffect(() => {
    if (!robot || !isLive) return undefined;
    let current = true;
    const read = () =>
      connection.call("logs", { robot }).then(
        (entries) => {
          if (!current) return;
          setError("");
          if (buffer.add(entries.map(recordOf)) > 0) setVersion((count) => count + 1);
        },
        (reason) => current && setError(reason.message),
      );
    read();
    const end = connection.hello.subscribe((hello) => hello && read());
    return () => {
      current = false;
      end();
    };
  }, [connection, robot, isLive]);

  const records = held ?? buffer.records;
  const shown = useMemo(() => filterRecords(records, filter), [records, filter, version, buffer]);
  const names = [...new Set(buffer.records.map((record) => record.component))].sort();
  if (filter.component && !names.includes(filter.component)) names.push(filter.component);
  const problems = shown.reduce((count, record) => count + (record.level >= WARN ? 1 : 0), 0);
  const at = shown.findIndex((record) => record.id === selected);
  const step = (direction) => {
    const from = at >= 0 ? at : direction < 0 ? shown.length : -1;
    const found = nextProblem(shown, from, direction);
    if (found >= 0) setSelected(shown[found].id);
  };

  return html`
    <div class="panel fill">
      <div class="row tools">
        <${SearchField} label="Filter by text" value=${filter.text} onInput=${(text) => change({ text })} />
        <select aria-label="Component" value=${filter.component} onChange=${(event) => change({ component: event.target.value })}>
          <option value="">all components</option>
          ${names.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
        </select>
        <select aria-label="Level" value=${String(filter.level)} onChange=${(event) => change({ level: Number(event.target.value) })}>
          ${LEVELS.map(([level, words]) => html`<option key=${level} value=${String(level)}>${words}</option>`)}
        </select>
      </div>
      <div class="row tools">
        <button class="button small" aria-pressed=${held !== null} onClick=${() => setHeld(held ? null : [...buffer.records])}>
          <${Icon} name=${held ? "play" : "pause"} size=${14} />${held ? "Resume" : "Pause"}</button>
        <button class="button small" disabled=${problems === 0} title="Previous warning or error" aria-label="Previous problem" onClick=${() => step(-1)}>▲</button>
        <button class="button small" disabled=${problems === 0} title="Next warning or error" aria-label="Next problem" onClick=${() => step(1)}>▼</button>
        <span class="muted">${problems > 0 ? `${problems} problem${problems > 1 ? "s" : ""}` : `${shown.length} messages`}
          ${held && buffer.records.length > held.length ? `, ${buffer.records.length - held.length} new` : ""}</span>
      </div>
      <${FailedComponents} onChoose=${(component) => change({ component, level: 0, text: "" })} />
      <${ErrorNote}>${error && `The history cannot be read: ${error}`}<//>
      ${shown.length === 0
        ? html`<${Empty} icon="logs" title=${records.length === 0 ? "No log messages yet" : "No message matches"}>
            ${records.length === 0 ? "Components log when they are loaded, and when something changes." : html`
              <button class="button small" onClick=${() => setFilter({ component: "", level: 0, text: "" })}>Show all messages</button>`}<//>`
        : html`<${Rows} records=${shown} selected=${selected} onSelect=${setSelected} onComponent=${(component) => change({ component })} paused=${held !== null} />`}
      ${buffer.dropped > 0 && html`<p class="muted small-print">The newest ${buffer.records.length} messages; older ones are in the log files of the run's folder.</p>`}
    </div>`;
}

/** Components that failed, with their reason; a click shows their messages. */
function FailedComponents({ onChoose }) {
  const open = useOpenPanel();
  const failed = (useComponents() ?? []).filter((one) => isFailed(one) || (one.restarts > 0 && one.reason));
  const more = failed.length - MOST_FAILED;
  return html`
    ${failed.slice(0, MOST_FAILED).map((one) => html`
      <button key=${one.name} class=${`note button-note ${isFailed(one) ? "bad" : "warning"}`} onClick=${() => onChoose(one.name)} title=${`Show the messages of ${one.name}`}>
        <${Icon} name="warning" size=${16} />
        <span><strong>${one.name}</strong> ${failureOf(one)}</span>
      </button>`)}
    ${more > 0 && html`<button class="link" onClick=${() => open("components", {})}>${more} more in the panel Components</button>`}`;
}

/** The rows in view of a long list; arrow keys move the selection, whose details are below. */
function Rows({ records, selected, onSelect, onComponent, paused }) {
  const list = useRef(null);
  const [view, setView] = useState({ top: 0, height: 400, wide: false });
  const [following, setFollowing] = useState(true);
  const row = view.wide ? ROW_PX.wide : ROW_PX.narrow;
  const at = records.findIndex((record) => record.id === selected);
  const chosen = at >= 0 ? records[at] : null;

  useLayoutEffect(() => {
    const element = list.current;
    const measure = () => setView((current) => ({ ...current, height: element.clientHeight, wide: element.clientWidth >= WIDE_PX }));
    const observer = new ResizeObserver(measure);
    observer.observe(element);
    measure();
    return () => observer.disconnect();
  }, []);
  useLayoutEffect(() => {
    if (following && !paused) list.current.scrollTop = records.length * row;
  }, [records, records.length, row, view.height, following, paused]);
  useLayoutEffect(() => {
    if (at < 0) return;
    const element = list.current;
    const top = at * row;
    if (top < element.scrollTop || top + row > element.scrollTop + element.clientHeight) {
      element.scrollTop = top - element.clientHeight / 2;
    }
  }, [selected, row]);

  const onScroll = (event) => {
    const { scrollTop, clientHeight, scrollHeight } = event.currentTarget;
    setView((current) => ({ ...current, top: scrollTop }));
    setFollowing(scrollTop + clientHeight >= scrollHeight - row);
  };
  const onKey = (event) => {
    const page = Math.max(1, Math.floor(view.height / row) - 1);
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -records.length, End: records.length };
    const step = steps[event.key];
    if (event.key === "Escape" && selected) onSelect("");
    else if (step === undefined) return;
    else {
      const from = at >= 0 ? at : step < 0 ? records.length : -1;
      onSelect(records[Math.min(records.length - 1, Math.max(0, from + step))].id);
    }
    event.preventDefault();
    event.stopPropagation();
  };

  const first = Math.max(0, Math.floor(view.top / row) - OVERSCAN);
  const last = Math.min(records.length, Math.ceil((view.top + view.height) / row) + OVERSCAN);
  return html`
    <div class="log-frame">
      <div class=${`log ${view.wide ? "wide" : "narrow"}`} ref=${list} tabindex="0" role="listbox" aria-label="Log messages" style=${{ "--row": `${row}px` }}
        aria-activedescendant=${at >= first && at < last ? `log-${at}` : undefined} onScroll=${onScroll} onKeyDown=${onKey}>
        <div style=${{ height: `${records.length * row}px`, position: "relative" }}>
          ${records.slice(first, last).map((record, index) => html`
            <div key=${record.id} id=${`log-${first + index}`} role="option" aria-selected=${record.id === selected} aria-setsize=${records.length}
              aria-posinset=${first + index + 1} class=${`log-row ${levelName(record.level).toLowerCase()}`}
              style=${{ top: `${(first + index) * row}px` }} onClick=${() => onSelect(record.id === selected ? "" : record.id)}>
              <span class="log-time">${clock(record.time)}</span>
              <span class="log-level">${levelName(record.level)}</span>
              <span class="log-name">${record.component}</span>
              <span class="log-text">${record.text}</span>
            </div>`)}
        </div>
      </div>
      ${!following && html`<button class="button small primary log-newest" onClick=${() => {
        setFollowing(true);
        list.current.scrollTop = list.current.scrollHeight;
      }}>Newest</button>`}
    </div>
    ${chosen && html`
      <section class="card log-details" aria-label="Message" aria-live="polite">
        <div class="row"><${Badge} tone=${chosen.level >= ERROR ? "bad" : chosen.level >= WARN ? "warning" : ""}>${levelName(chosen.level)}<//>
          <button class="link" onClick=${() => onComponent(chosen.component)} title="Only this component">${chosen.component}</button>
          <span class="muted">${new Date(chosen.time * 1000).toLocaleString()}</span></div>
        <p class="log-message">${chosen.text}</p>
        ${chosen.where && html`<p class="muted mono">${chosen.where}</p>`}
      </section>`}`;
}
