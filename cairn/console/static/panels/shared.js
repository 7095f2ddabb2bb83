// What several panels use: freshness of messages, permission to act, confirmations, numbers, search fields.

import { html, useEffect, useLayoutEffect, useRef, useState } from "../vendor/preact-htm.js";
import { useAction, useApp, useEvent, useInterval, useRobot, useSubscription } from "../hooks.js";
import { useLease } from "../lease.js";
import { Store, useStore } from "../store.js";
import { Icon } from "../ui.js";

/** What a panel shows when it is opened from another one: {panel: value}. */
export const requests = new Store({});

/** Return a function that opens another panel with a request, such as the logs of a component. */
export function useOpenPanel() {
  const { showPanel } = useApp();
  return (panel, request) => {
    requests.set({ ...requests.value, [panel]: request });
    showPanel(panel);
    // The button that was pressed is gone: the focus goes to the tab of the new panel.
    requestAnimationFrame(() => document.getElementById(`tab-${panel}`)?.focus());
  };
}

/** Call `take(request)` once for each request to this panel. */
export function useRequest(panel, take) {
  const request = useStore(requests)[panel];
  useEffect(() => {
    if (request === undefined) return;
    const { [panel]: _, ...others } = requests.value;
    requests.set(others);
    take(request);
  }, [request]);
}

/** Return the components of the chosen robot, null before the first event. */
export function useComponents() {
  return useEvent("components", { ofRobot: true })?.components ?? null;
}

/**
 * Return why nothing can be changed from here, {words, lease}, null if it can.
 *
 * `lease` is "take" or "ask" if the lease is what is missing, else "".
 */
export function useReadOnly() {
  const { connection } = useApp();
  const hello = useStore(connection.hello);
  const { phase } = useStore(connection.status);
  const lease = useLease();
  if (hello?.mode === "recording") return { words: "This is a recording: nothing can be changed.", lease: "" };
  if (phase !== "open") return { words: "Not connected to the console: nothing can be changed.", lease: "" };
  if (hello?.may === "watch") return { words: "This console may watch only: nothing can be changed.", lease: "" };
  if (lease.mine) return null;
  if (lease.holder) return { words: `${lease.holder} steers; changes need the lease.`, lease: "ask" };
  return { words: "Changes need the lease.", lease: "take" };
}

/** A note above controls that are disabled, with the way to enable them. */
export function ReadOnlyNote({ readOnly }) {
  const act = useAction();
  if (!readOnly) return null;
  return html`
    <div class="note" role="note">
      <${Icon} name="lock" size=${16} /><span class="grow">${readOnly.words}</span>
      ${readOnly.lease === "take" && html`<button class="button small primary" onClick=${() => act("acquire_lease")}>Steer</button>`}
      ${readOnly.lease === "ask" && html`<button class="button small" onClick=${() => act("ask_lease")}>Ask</button>`}
    </div>`;
}

/** An error beside what caused it. */
export const ErrorNote = ({ id, children }) =>
  children && html`<p class="note bad" role="alert" id=${id}><${Icon} name="warning" size=${16} /><span>${children}</span></p>`;

/**
 * Return the clock [ms] by which ages are measured, {now, at(info)}: `at` is the time of a message.
 *
 * In a recording it is the time that is shown, so that nothing ages while it is held.
 */
export function useClock() {
  const { mode } = useApp();
  const playback = useEvent("playback");
  if (mode === "recording") return { now: (playback?.time_ns ?? 0) / 1e6, at: (info) => Number(info.receivedNs) / 1e6 };
  return { now: performance.now(), at: () => performance.now() };
}

/**
 * Return {message, info, age} of a topic's last message; `age` [s] is the time since it arrived here.
 *
 * It renders with each message, and once per second without one.
 */
export function useFresh(name, options = {}) {
  const robot = useRobot();
  const clock = useClock();
  const key = `${robot} ${name}`;
  const last = useRef({ key: "", message: null, info: null, at: 0 });
  const frame = useRef(0);
  const [, render] = useState(0);
  useSubscription(
    name,
    (message, info) => {
      last.current = { key, message, info, at: clock.at(info) };
      if (frame.current) return;
      frame.current = requestAnimationFrame(() => {
        frame.current = 0;
        render((count) => count + 1);
      });
    },
    options,
  );
  useEffect(() => () => cancelAnimationFrame(frame.current), []);
  useInterval(() => render((count) => count + 1), 1000);
  const { message, info, at } = last.current;
  if (last.current.key !== key) return { message: null, info: null, age: Infinity };
  return { message, info, age: Math.max(0, clock.now - at) / 1000 };
}

/**
 * A question before something that stops the robot; the safe answer has the focus, and Escape gives it.
 *
 * Afterwards the focus is where it was before.
 */
export function Confirm({ question, children, action, onConfirm, onCancel }) {
  const cancel = useRef(null);
  // Before it is painted: a key pressed as soon as the question is seen must reach it.
  useLayoutEffect(() => {
    const before = document.activeElement;
    cancel.current.focus();
    return () => before?.focus();
  }, []);
  const onKey = (event) => {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    onCancel();
  };
  return html`
    <div class="confirm" role="alertdialog" aria-label=${question} onKeyDown=${onKey}>
      <strong>${question}</strong>
      <p>${children}</p>
      <div class="row">
        <button class="button small danger" onClick=${onConfirm}>${action}</button>
        <button class="button small" ref=${cancel} onClick=${onCancel}>Cancel</button>
      </div>
    </div>`;
}

/** A search field with its label for screen readers and a button that empties it. */
export function SearchField({ label, value, onInput }) {
  return html`
    <label class="search">
      <span class="hidden">${label}</span>
      <${Icon} name="search" size=${16} />
      <input class="input" type="search" placeholder=${label} value=${value} autocomplete="off" spellcheck=${false}
        onInput=${(event) => onInput(event.target.value)}
        onKeyDown=${(event) => event.key === "Escape" && value && (event.stopPropagation(), onInput(""))} />
    </label>`;
}

/** Return a number for people: at most six significant digits, without a tail of zeros. */
export function number(value) {
  if (typeof value === "bigint") return value.toString();
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "NaN" : value > 0 ? "∞" : "−∞";
  if (Number.isInteger(value) && Math.abs(value) < 1e12) return String(value).replace("-", "−");
  const size = Math.abs(value);
  const text = size >= 1e6 || size < 1e-4 ? value.toExponential(3) : String(Number(value.toPrecision(6)));
  return text.replace("-", "−");
}

/** Return an angle in degrees with its sign: "−12.3°". */
export const degrees = (radians) => `${((radians * 180) / Math.PI).toFixed(1).replace("-", "−")}°`;

/** Return the heading [rad] of a quaternion about the vertical axis. */
export const heading = ({ x, y, z, w }) => Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));

/** Return a name without the robot's: "/robot/scan" of robot "robot" is "scan". */
export const shortName = (name, robot) => (name.startsWith(`/${robot}/`) ? name.slice(robot.length + 2) : name);

/** A name that may be broken after its underscores, where it is too long for its column. */
export const Name = ({ text }) => text.split(/(?<=_)/).map((part, index) => html`${index > 0 && html`<wbr />`}${part}`);

/** Return the class name of a message type without its package: "LaserScan". */
export const shortType = (type) => type.split("/").at(-1);

/** A list of names with values; entries are [name, value] or null. */
export const Facts = ({ entries }) => html`
  <dl class="facts">
    ${entries.filter(Boolean).map(([name, value, tone]) => html`<div key=${name}><dt>${name}</dt><dd class=${tone ? `tone-${tone}` : ""}>${value}</dd></div>`)}
  </dl>`;
