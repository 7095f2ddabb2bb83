// Plots of numeric fields of any topic over time.

import uPlot from "../vendor/uplot.js";
import { html, useEffect, useMemo, useRef, useState } from "../vendor/preact-htm.js";
import { useApp, useInterval, usePageVisible, useRobot } from "../hooks.js";
import { SavedStore, useStore } from "../store.js";
import { Empty, Icon } from "../ui.js";
import { SearchField, number, shortName, useRequest } from "./shared.js";
import { numberAt, numericFields, parsePath, searchFields, unitOf } from "./fields.js";
import { Series, decimate } from "./series.js";

const MOST_SERIES = 8;
const MOST_PLOTS = 6;
const MOST_FOUND = 60;
const PAINT_MS = 100;
const SLOWEST_PAINT_MS = 500; // of long windows, in which a pixel is long
const WINDOWS = [[10, "10 s"], [30, "30 s"], [120, "2 min"], [600, "10 min"]];
const HEAVY = /\/(Image|CompressedImage|PointCloud2|OccupancyGrid)$/; // a browser gets these at 2 Hz
const HEAVY_HZ = 2;
const GAP_S = 1; // a subscription that was away for longer leaves a gap
const COLORS = ["--plot-1", "--plot-2", "--plot-3", "--plot-4", "--plot-5", "--plot-6", "--plot-7", "--plot-8"];

/** What is plotted: {plots: [[{topic, path, color}]], window: s}; `topic` without the robot's name. */
const layout = new SavedStore("plots", { plots: [[]], window: 30 });
// Values by connection and "topic path": they stay while the panel is closed.
const seriesOf = new WeakMap();

const keyOf = (topic, path) => `${topic} ${path}`;

/** Return a layout with a field added to a plot, in a color that the plot does not use. */
export function withField(plots, index, topic, path) {
  const plot = plots[index];
  if (plot.length >= MOST_SERIES || plot.some((one) => one.topic === topic && one.path === path)) return plots;
  const used = new Set(plot.map((one) => one.color));
  const color = COLORS.findIndex((_, at) => !used.has(at));
  return plots.map((one, at) => (at === index ? [...one, { topic, path, color }] : one));
}

export function Plots() {
  const { connection } = useApp();
  const robot = useRobot();
  const { plots, window } = useStore(layout);
  const [pausedAt, setPausedAt] = useState(null); // the right edge [s] while paused
  const [target, setTarget] = useState(0); // the plot that gets what is picked
  const clock = useRef(new PlotClock());
  const buffers = useBuffers(connection, robot, plots, clock.current);
  const mode = useStore(connection.hello)?.mode ?? "live";
  const change = (next) => layout.update((current) => ({ ...current, ...next }));
  const add = (topic, path) => change({ plots: withField(plots, Math.min(target, plots.length - 1), topic, path) });
  useRequest("plots", ({ topic, path }) => add(shortName(topic, robot), path));
  const remove = (index, at) => change({ plots: plots.map((plot, one) => (one === index ? plot.filter((_, other) => other !== at) : plot)) });
  const rename = (index, at, path) =>
    change({ plots: plots.map((plot, one) => (one === index ? plot.map((series, other) => (other === at ? { ...series, path } : series)) : plot)) });
  const removePlot = (index) => {
    change({ plots: plots.length > 1 ? plots.filter((_, one) => one !== index) : [[]] });
    setTarget(0);
  };
  return html`
    <div class="panel">
      <${FieldPicker} connection=${connection} robot=${robot} onPick=${add} />
      <div class="row tools">
        <select class="window" aria-label="Time window" value=${String(window)} onChange=${(event) => change({ window: Number(event.target.value) })}>
          ${WINDOWS.map(([seconds, words]) => html`<option key=${seconds} value=${String(seconds)}>${words}</option>`)}
        </select>
        <button class="button small" aria-pressed=${pausedAt !== null} onClick=${() => setPausedAt(pausedAt === null ? clock.current.now(mode) : null)}>
          <${Icon} name=${pausedAt === null ? "pause" : "play"} size=${14} />${pausedAt === null ? "Pause" : "Resume"}</button>
        <button class="button small" disabled=${plots.length >= MOST_PLOTS} onClick=${() => {
          change({ plots: [...plots, []] });
          setTarget(plots.length);
        }}><${Icon} name="plus" size=${14} />Plot</button>
      </div>
      ${plots.map((plot, index) => html`
        <${Plot} key=${`${index} ${plot.map((one) => keyOf(one.topic, one.path)).join(" ")}`} plot=${plot} buffers=${buffers} span=${window} clock=${clock.current} mode=${mode}
          pausedAt=${pausedAt} onPause=${setPausedAt} number=${index + 1} chosen=${plots.length > 1 && index === target} onChoose=${() => setTarget(index)}
          onRemove=${(at) => remove(index, at)} onRename=${(at, path) => rename(index, at, path)} onClose=${plots.length > 1 ? () => removePlot(index) : null} />`)}
    </div>`;
}

/** The time of the data's newest message, carried on by the browser's clock. */
class PlotClock {
  newest = 0;
  at = 0;

  saw(time) {
    if (time < this.newest - 1) this.newest = 0; // a seek to the past
    if (time > this.newest) {
      this.newest = time;
      this.at = performance.now();
    }
  }

  /** Return the right edge [s]; a recording that is paused stands still. */
  now(mode) {
    if (this.newest === 0) return Date.now() / 1000;
    return mode === "recording" ? this.newest : this.newest + Math.min(60, (performance.now() - this.at) / 1000);
  }
}

/** Subscribe to the topics of all plots, and return the function that gives a field's series. */
function useBuffers(connection, robot, plots, clock) {
  if (!seriesOf.has(connection)) seriesOf.set(connection, new Map());
  const all = seriesOf.get(connection);
  const full = (topic) => (topic.startsWith("/") ? topic : `/${robot}/${topic}`);
  const wanted = [...new Set(plots.flat().map((one) => keyOf(full(one.topic), one.path)))].sort().join("\n");
  const topics = useStore(connection.topics);
  const heavy = [...new Set(plots.flat().map((one) => full(one.topic)))].filter((topic) => HEAVY.test(topics.get(topic)?.type ?? "")).join(" ");
  const visible = usePageVisible();
  const get = (topic, path) => {
    const key = keyOf(full(topic), path);
    if (!all.has(key)) all.set(key, new Series());
    return all.get(key);
  };
  useEffect(() => {
    if (!robot || !visible) return undefined;
    const byTopic = new Map();
    for (const key of wanted.split("\n").filter(Boolean)) {
      const [topic, path] = key.split(" ");
      byTopic.set(topic, [...(byTopic.get(topic) ?? []), [parsePath(path), all.get(key) ?? all.set(key, new Series()).get(key)]]);
    }
    for (const key of all.keys()) if (!wanted.split("\n").includes(key)) all.delete(key);
    const ends = [...byTopic].map(([topic, fields]) => {
      let first = true;
      return connection.subscribe(
        topic,
        (message, { receivedNs }) => {
          const time = Number(receivedNs / 1000n) / 1e6;
          clock.saw(time);
          for (const [steps, series] of fields) {
            if (first && series.length > 0 && time - series.timeAt(series.length - 1) > GAP_S) series.gap();
            series.push(time, numberAt(message, steps));
          }
          first = false;
        },
        { maxHz: heavy.split(" ").includes(topic) ? HEAVY_HZ : 0 },
      );
    });
    return () => ends.forEach((end) => end());
  }, [connection, robot, wanted, heavy, visible]);
  return get;
}

function FieldPicker({ connection, robot, onPick }) {
  const topics = useStore(connection.topics);
  const [text, setText] = useState("");
  const [open, setOpen] = useState(false);
  const [active, setActive] = useState(0);
  const root = useRef(null);
  const fields = useMemo(() => {
    const all = [];
    if (!open) return all;
    for (const { topic } of topics.values()) {
      const decode = connection.decoder(topic);
      if (!decode || (topic.split("/").length > 2 && !topic.startsWith(`/${robot}/`))) continue;
      for (const field of numericFields(decode)) all.push({ topic: shortName(topic, robot), ...field });
    }
    return all;
  }, [topics, robot, open]);
  const found = useMemo(() => searchFields(fields, text, (one) => `${one.topic}.${one.path}`), [fields, text]);
  const shown = found.slice(0, MOST_FOUND);
  const pick = (one) => {
    onPick(one.topic, one.path);
    setText("");
    setOpen(false);
  };
  const onKey = (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) {
      setOpen(true);
      const next = Math.min(shown.length - 1, Math.max(0, active + (open ? step : 0)));
      setActive(next);
      root.current.querySelectorAll("[role=option]")[next]?.scrollIntoView({ block: "nearest" });
    } else if (event.key === "Enter" && open && shown[active]) pick(shown[active]);
    else if (event.key === "Escape" && open) setOpen(false);
    else return;
    event.preventDefault();
    event.stopPropagation();
  };
  const leave = (event) => root.current.contains(event.relatedTarget) || setOpen(false);
  return html`
    <div class="picker" ref=${root} onFocusOut=${leave}>
      <label class="search"><span class="hidden">Add a field to the plot</span><${Icon} name="search" size=${16} />
        <input class="input" type="text" role="combobox" aria-expanded=${open} aria-controls="picker-fields" aria-autocomplete="list"
          aria-activedescendant=${open && shown[active] ? `picker-${active}` : undefined} placeholder="Add a field, such as odom linear x" value=${text}
          autocomplete="off" spellcheck=${false} onFocus=${() => setOpen(true)} onClick=${() => setOpen(true)}
          onInput=${(event) => {
            setText(event.target.value);
            setActive(0);
            setOpen(true);
          }} onKeyDown=${onKey} />
      </label>
      ${open && html`
        <ul class="picker-list" id="picker-fields" role="listbox" aria-label="Numeric fields">
          ${shown.map((one, index) => html`
            <li key=${keyOf(one.topic, one.path)} id=${`picker-${index}`} role="option" aria-selected=${index === active}
              onPointerDown=${(event) => event.preventDefault()} onClick=${() => pick(one)}>
              <span class="muted">${one.topic}</span> <span>${one.path}</span> <span class="muted unit">${unitOf(one.path) || one.type}</span></li>`)}
          ${found.length > shown.length && html`<li class="muted" aria-disabled="true">${found.length - shown.length} more; type to narrow them down</li>`}
          ${shown.length === 0 && html`<li class="muted" aria-disabled="true">${fields.length === 0 ? "No topic with numbers yet" : "No field matches"}</li>`}
        </ul>`}
    </div>`;
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
/** Return the color of a token as a canvas takes it, in the theme that is shown. */
function color(name, element) {
  element.style.color = `var(${name})`;
  return getComputedStyle(element).color;
}

function Plot({ plot, buffers, span, clock, mode, pausedAt, onPause, number: index, chosen, onChoose, onRemove, onRename, onClose }) {
  const frame = useRef(null);
  const probe = useRef(null);
  const chart = useRef(null);
  const values = useRef([]);
  const state = useRef({});
  const due = useRef(0); // when the next painting shows something new
  const [zoom, setZoom] = useState(null); // [from, to] in s, while paused
  state.current = { span, pausedAt, zoom, mode, onPause };
  useEffect(() => pausedAt === null && setZoom(null), [pausedAt]);

  const paint = () => {
    if (!chart.current) return;
    const { span, pausedAt, zoom, mode } = state.current;
    const right = pausedAt ?? clock.now(mode);
    const [from, to] = zoom ?? [right - span, right];
    const width = Math.max(50, Math.round(frame.current.clientWidth - 50));
    due.current = performance.now() + Math.min(SLOWEST_PAINT_MS, ((to - from) * 1000) / width);
    chart.current.setData(decimate(plot.map((one) => buffers(one.topic, one.path)), from, to, width), false);
    chart.current.setScale("x", { min: from, max: to });
    if (chart.current.cursor.idx === null || chart.current.cursor.idx === undefined) showValues(null);
  };
  const showValues = (at) => {
    plot.forEach((one, series) => {
      const element = values.current[series];
      if (!element) return;
      let value = buffers(one.topic, one.path).last();
      if (at !== null) {
        const data = chart.current.data[series + 1];
        value = NaN;
        for (let back = at; back >= 0 && back > at - 400; back -= 1)
          if (data[back] !== undefined && data[back] !== null) {
            value = data[back];
            break;
          }
      }
      element.textContent = Number.isNaN(value) ? "–" : number(Number(value.toPrecision(4)));
    });
  };
  useEffect(() => {
    if (plot.length === 0) return undefined;
    const element = frame.current;
    const token = (name) => () => color(name, probe.current);
    const axis = { stroke: token("--muted"), grid: { stroke: token("--border"), width: 1 }, ticks: { stroke: token("--border"), width: 1, size: 4 }, font: `11px ${css("--font")}` };
    chart.current = new uPlot(
      {
        width: element.clientWidth, height: element.clientHeight, legend: { show: false }, pxAlign: 0, padding: [8, 8, 0, 0],
        cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false, setScale: false } },
        scales: { x: { time: true, auto: false }, y: { auto: true } },
        axes: [{ ...axis, size: 26, space: 70 }, { ...axis, size: 50, values: (_, ticks) => ticks.map((value) => number(Number(value.toPrecision(8)))) }],
        series: [{}, ...plot.map((one) => ({ stroke: token(COLORS[one.color] ?? COLORS[0]), width: 1.5, points: { show: false } }))],
        hooks: {
          setCursor: [(self) => showValues(self.cursor.idx ?? null)],
          setSelect: [(self) => {
            const { left, width } = self.select;
            if (width < 4) return;
            const range = [self.posToVal(left, "x"), self.posToVal(left + width, "x")];
            self.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
            state.current.onPause(state.current.pausedAt ?? clock.now(state.current.mode));
            setZoom(range);
          }],
        },
      },
      [[], ...plot.map(() => [])],
      element,
    );
    const observer = new ResizeObserver(() => chart.current?.setSize({ width: element.clientWidth, height: element.clientHeight }));
    observer.observe(element);
    paint();
    return () => {
      observer.disconnect();
      chart.current.destroy();
      chart.current = null;
    };
  }, []);
  useInterval(() => pausedAt === null && performance.now() >= due.current && paint(), PAINT_MS);
  useEffect(paint, [zoom, pausedAt, span]);

  const words = plot.map((one) => `${one.topic} ${one.path}`).join(", ");
  return html`
    <section class=${`card plot ${chosen ? "chosen" : ""}`} aria-label=${`Plot ${index}: ${words || "empty"}`} onClick=${onChoose} onFocusIn=${onChoose}>
      <div class="plot-series">
        ${plot.map((one, at) => html`
          <${SeriesChip} key=${keyOf(one.topic, one.path)} one=${one} value=${(element) => (values.current[at] = element)}
            onRemove=${() => onRemove(at)} onRename=${(path) => onRename(at, path)} />`)}
        ${zoom && html`<button class="button small" onClick=${() => setZoom(null)}>Reset zoom</button>`}
        ${onClose && html`<button class="icon-button tiny plot-close" aria-label=${`Remove plot ${index}`} title="Remove this plot" onClick=${(event) => {
          event.stopPropagation();
          onClose();
        }}><${Icon} name="close" size=${16} /></button>`}
      </div>
      ${plot.length === 0
        ? html`<${Empty} icon="plots" title="Nothing is plotted yet">${chosen || !onClose ? "Search a field above, or choose one in the panel Topics." : html`<button class="button small" onClick=${onChoose}>Add fields here</button>`}<//>`
        : html`<div class="plot-frame" ref=${frame} role="img" aria-label=${`${words} over ${span} seconds`} onDblClick=${() => setZoom(null)} />`}
      <i ref=${probe} hidden />
    </section>`;
}

/** A field with its color and last value; the path can be edited, for the index in a sequence. */
function SeriesChip({ one, value, onRemove, onRename }) {
  const [typed, setTyped] = useState(null);
  const [error, setError] = useState("");
  const input = useRef(null);
  useEffect(() => typed !== null && input.current?.focus(), [typed !== null]);
  const submit = () => {
    try {
      parsePath(typed);
      if (typed !== one.path) onRename(typed);
      setTyped(null);
      setError("");
    } catch (reason) {
      setError(reason.message);
    }
  };
  const onKey = (event) => {
    if (event.key === "Enter") submit();
    else if (event.key === "Escape") {
      setTyped(null);
      setError("");
    } else return;
    event.stopPropagation();
  };
  return html`
    <span class="series-chip" style=${{ "--series": `var(${COLORS[one.color] ?? COLORS[0]})` }}>
      <i class="swatch" />
      ${typed === null
        ? html`<button class="link series-name" title="Change the field or its index" onClick=${() => setTyped(one.path)}><span class="muted">${one.topic}</span> ${one.path}</button>`
        : html`<input ref=${input} class="input series-input" aria-label=${`Field of ${one.topic}`} aria-invalid=${error ? "true" : undefined} title=${error} value=${typed}
            onInput=${(event) => setTyped(event.target.value)} onKeyDown=${onKey} onBlur=${submit} />`}
      <output class="series-value" ref=${value}>–</output><span class="muted unit">${unitOf(one.path)}</span>
      <button class="icon-button tiny" aria-label=${`Remove ${one.topic} ${one.path}`} onClick=${onRemove}><${Icon} name="close" size=${13} /></button>
    </span>`;
}
