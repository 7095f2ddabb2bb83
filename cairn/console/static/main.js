// The page's frame: top bar, map, panels, messages to the user, and what holds them together.

import { html, render, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import { Connection, gatewayUrl } from "./connection.js";
import { AppContext, dismiss, toast, toasts, useAction, useApp, useEvent, useRobot, useTopic } from "./hooks.js";
import { LeaseControl } from "./lease.js";
import { MapView } from "./map/index.js";
import { navigationState } from "./navigation.js";
import { panels } from "./panels/index.js";
import { SavedStore, Store, useStore } from "./store.js";
import { Timeline } from "./timeline.js";
import { Badge, Icon, Meter, healthTone } from "./ui.js";

const NARROW = matchMedia("(max-width: 759px)");
const LEAST_DRAWER_PX = 300;
/** For the browser's developer tools and the tests: the connection, and the map's controller. */
globalThis.cairnConsole = {};

const connection = new Connection(gatewayUrl());
globalThis.cairnConsole.connection = connection;
const robot = new Store("");
const theme = new SavedStore("theme", "auto");
const shownPanel = new SavedStore("panel", "drive");
const drawerWidth = new SavedStore("drawer", 400);

/** Keep the chosen robot among those that exist. */
function followRobots() {
  const known = connection.event("robots").value ?? connection.hello.value?.robots ?? [];
  const names = known.map((one) => (typeof one === "string" ? one : one.name));
  if (names.length > 0 && !names.includes(robot.value)) robot.set(names[0]);
}

function applyTheme() {
  document.documentElement.dataset.theme = theme.value;
}

function useRobots() {
  const hello = useStore(connection.hello);
  const event = useEvent("robots");
  return (event ?? hello?.robots ?? []).map((one) => (typeof one === "string" ? one : one.name));
}

const showPanel = (id) => shownPanel.set(id);

const useMode = () => useStore(connection.hello)?.mode ?? "live";

function App() {
  const mode = useMode();
  return html`
    <${AppContext.Provider} value=${{ connection, robot, theme, mode, showPanel }}>
      <${TopBar} />
      <${Banners} />
      <${Stage} />
      ${mode === "recording" && html`<${Timeline} />`}
      <${Toasts} />
    <//>`;
}

function TopBar() {
  const mode = useMode();
  return html`
    <header class="topbar">
      <div class="identity">
        <img src="icon.svg" width="24" height="24" alt="Cairn" />
        <${RobotChoice} />
        <${ModeBadge} />
      </div>
      <div class="chips">
        <${HealthChip} />
        <${NavigatorChip} />
        ${mode === "live" && html`<${LeaseControl} />`}
      </div>
      <div class="actions">
        <${ThemeSwitch} />
        ${mode === "live" && html`<${StopButton} />`}
      </div>
    </header>`;
}

function RobotChoice() {
  const robots = useRobots();
  const chosen = useRobot();
  if (robots.length < 2) return html`<strong class="robot">${chosen || "no robot"}</strong>`;
  return html`
    <select class="robot" aria-label="Robot" value=${chosen} onChange=${(event) => robot.set(event.target.value)}>
      ${robots.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
    </select>`;
}

function ModeBadge() {
  const { phase } = useStore(connection.status);
  const mode = useMode();
  if (phase !== "open") return html`<${Badge} tone="bad" title="No connection to the console">offline<//>`;
  if (mode === "recording") return html`<${Badge} tone="accent" title="A recording: nothing here moves a robot">recording<//>`;
  return html`<${Badge} tone="ok" title="Connected to a running deployment">live<//>`;
}

function HealthChip() {
  const estimate = useTopic("localization", { maxHz: 5 });
  if (!estimate)
    return html`<span class="chip" title="No pose yet: the localizer has published nothing"><span class="label">Pose</span><span class="muted">none</span></span>`;
  const { health, reason, located, position_sd: sd } = estimate;
  const tone = healthTone(health);
  return html`
    <span class="chip health" title=${reason || "The pose is reliable"}>
      <span class="label">Pose</span>
      <${Meter} value=${health} tone=${tone} label="Health of the pose" />
      <span class=${`value tone-${tone}`}>${Math.round(100 * health)} %</span>
      <span class="detail muted">${reason || (located ? `± ${Math.round(100 * sd)} cm` : "not located")}</span>
    </span>`;
}

function NavigatorChip() {
  const status = useTopic("navigation_status", { maxHz: 5 });
  const gate = useTopic("velocity_gate_status", { maxHz: 5 });
  const state = navigationState(status, gate);
  return html`
    <span class="chip navigator" title=${state.reason || state.label}>
      <span class="label">Navigator</span>
      <${Badge} tone=${state.tone}>${state.label}<//>
      <span class="detail muted">${state.detail}</span>
    </span>`;
}

const THEMES = { auto: ["auto", "Theme of the system"], light: ["sun", "Light theme"], dark: ["moon", "Dark theme"] };

function ThemeSwitch() {
  const chosen = useStore(theme);
  const names = Object.keys(THEMES);
  const next = names[(names.indexOf(chosen) + 1) % names.length];
  const [icon, words] = THEMES[chosen] ?? THEMES.auto;
  return html`
    <button class="icon-button theme" onClick=${() => theme.set(next)} title=${`${words}; switch to ${next}`} aria-label=${`${words}; switch to ${next}`}>
      <${Icon} name=${icon} />
    </button>`;
}

function StopButton() {
  const act = useAction();
  const gate = useTopic("velocity_gate_status", { maxHz: 5 });
  const engaged = gate?.emergency_stop ?? false;
  const stop = async () => {
    const answer = await act("stop", { reason: "emergency stop of the console" }, { timeoutMs: 3000 });
    if (answer !== undefined) toast("info", "The emergency stop is engaged.");
  };
  useEffect(() => {
    const onKey = (event) => {
      const target = event.target;
      const inControl = target.closest?.("button, input, select, textarea, a, summary, [role=tab], [contenteditable]");
      if (event.code !== "Space" || event.repeat || inControl) return;
      event.preventDefault();
      stop();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  }, [act]);
  return html`
    <button class=${`stop ${engaged ? "engaged" : ""}`} onClick=${stop} title="Emergency stop (Space)">
      ${engaged ? "Stopped" : "Stop"}
    </button>`;
}

function Banners() {
  const status = useStore(connection.status);
  const mode = useMode();
  return html`
    <div class="banners">
      ${status.phase !== "open" && html`<${ConnectionBanner} status=${status} />`}
      ${status.phase === "open" && html`<${LinkBanner} /><${MachinesBanner} />`} ${mode === "live" && html`<${StoppedBanner} />`}
    </div>`;
}

function ConnectionBanner({ status }) {
  const [, tick] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => tick((count) => count + 1), 500);
    return () => clearInterval(timer);
  }, []);
  const hadConnection = useStore(connection.hello) !== null;
  if (status.phase === "connecting" && !status.reason) return null;
  const left = Math.max(0, Math.ceil((status.retryAt - performance.now()) / 1000));
  return html`
    <div class="banner bad" role="alert">
      <${Icon} name="link" />
      <span>
        <strong>${hadConnection ? "Not connected." : "Cannot connect."}</strong> ${" "}
        ${sentence(status.reason)} ${" "}
        ${status.phase === "refused" ? "Open the address that cairn console printed." : hadConnection ? "What you see is old." : ""}
      </span>
      ${status.phase === "waiting"
        ? html`<button class="button small" onClick=${() => connection.retry()}>Retry${left > 0 ? ` (${left} s)` : ""}</button>`
        : status.phase === "connecting" && html`<span class="muted">connecting …</span>`}
    </div>`;
}

/** The console answers, but it has lost the robots' router. */
function LinkBanner() {
  const link = useEvent("link");
  if (!link || link.connected) return null;
  return html`
    <div class="banner bad" role="alert">
      <${Icon} name="link" />
      <span><strong>The console has no connection to the robot.</strong> ${" "} ${sentence(link.reason)} What you see is old.</span>
    </div>`;
}

/** Machines of the robot that another one, which the console reaches, has lost. */
function MachinesBanner() {
  const lost = (useEvent("machines", { ofRobot: true })?.machines ?? []).filter((one) => one.state === "lost");
  return lost.map((one) => html`
    <div class="banner bad" role="alert" key=${`${one.machine} ${one.seen_from}`}>
      <${Icon} name="link" />
      <span><strong>Machine ${one.machine} cannot be reached from ${one.seen_from}.</strong> ${" "}
        ${["Nothing is", "One topic is"][one.missing.length] ?? `${one.missing.length} topics are`} missing there.</span>
      <button class="button small" onClick=${() => showPanel("components")}>Components</button>
    </div>`);
}

const sentence = (words) => (words ? words[0].toUpperCase() + words.slice(1) + (words.endsWith(".") ? "" : ".") : "");

function StoppedBanner() {
  const gate = useTopic("velocity_gate_status", { maxHz: 5 });
  const act = useAction();
  if (!gate?.emergency_stop) return null;
  return html`
    <div class="banner stop-banner" role="alert">
      <${Icon} name="warning" />
      <span><strong>Emergency stop engaged.</strong> ${" "} ${sentence(gate.reason)}</span>
      <button class="button small" onClick=${() => act("release_stop")}>Release</button>
    </div>`;
}

function Stage() {
  const mode = useMode();
  const shown = useStore(shownPanel);
  const width = useStore(drawerWidth);
  const robots = useRobots();
  const available = panels.filter((panel) => !panel.modes || panel.modes.includes(mode));
  const panel = available.find((one) => one.id === shown) ?? null;
  const PanelView = panel?.component;
  return html`
    <main class=${`stage ${panel ? "with-panel" : ""}`} style=${{ "--drawer": `${width}px` }}>
      <${MapView} robots=${robots} />
      ${panel && html`<${DrawerEdge} />`}
      ${panel &&
      html`<section class="drawer" id="drawer" role="tabpanel" aria-labelledby=${`tab-${panel.id}`} key=${panel.id}>
        <header class="drawer-head">
          <h2>${panel.title}</h2>
          <button class="icon-button" onClick=${() => shownPanel.set("")} aria-label="Close the panel" title="Close the panel">
            <${Icon} name="close" />
          </button>
        </header>
        <div class="drawer-body"><${PanelView} /></div>
      </section>`}
      <${Rail} available=${available} shown=${panel?.id ?? ""} />
    </main>`;
}

/** The tabs; arrow keys move among them, and the tab that is shown closes its panel. */
function Rail({ available, shown }) {
  const list = useRef(null);
  useEffect(() => {
    list.current.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  }, [shown]);
  const onKey = (event) => {
    const step = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const tabs = [...list.current.querySelectorAll("[role=tab]")];
    const next = (tabs.indexOf(document.activeElement) + step + tabs.length) % tabs.length;
    tabs[next].focus();
  };
  const tab = (id, title, icon) => html`
    <button
      key=${id} id=${`tab-${id || "map"}`} role="tab" aria-selected=${shown === id} aria-controls="drawer"
      class=${id ? "tab" : "tab map-tab"} tabindex=${shown === id || (!shown && id === available[0]?.id) ? 0 : -1}
      onClick=${() => shownPanel.set(shown === id && !NARROW.matches ? "" : id)}
    >
      <${Icon} name=${icon} /><span>${title}</span>
    </button>`;
  return html`
    <nav class="rail" aria-label="Panels">
      <div role="tablist" ref=${list} onKeyDown=${onKey}>
        ${tab("", "Map", "map")} ${available.map((one) => tab(one.id, one.title, one.icon))}
      </div>
    </nav>`;
}

/** The edge between map and panel, moved with the pointer or the arrow keys. */
function DrawerEdge() {
  const width = useStore(drawerWidth);
  const limit = (value) => drawerWidth.set(Math.round(Math.min(innerWidth * 0.7, Math.max(LEAST_DRAWER_PX, value))));
  const onPointerDown = (event) => {
    const edge = event.currentTarget;
    edge.setPointerCapture(event.pointerId);
    const right = event.clientX + drawerWidth.value;
    edge.onpointermove = (move) => limit(right - move.clientX);
    edge.onpointerup = edge.onpointercancel = () => (edge.onpointermove = null);
  };
  const onKey = (event) => {
    if (event.key === "ArrowLeft") limit(drawerWidth.value + 20);
    else if (event.key === "ArrowRight") limit(drawerWidth.value - 20);
    else return;
    event.preventDefault();
  };
  return html`
    <div class="edge" role="separator" tabindex="0" aria-orientation="vertical" aria-label="Width of the panel"
      aria-valuenow=${width} onPointerDown=${onPointerDown} onKeyDown=${onKey} />`;
}

function Toasts() {
  const list = useStore(toasts);
  return html`
    <div class="toasts" role="status" aria-live="polite">
      ${list.map(
        (one) => html`
          <div key=${one.id} class=${`toast ${one.level}`}>
            <${Icon} name=${one.level === "info" ? "info" : "warning"} size=${18} />
            <span>${sentence(one.text)}</span>
            <button class="icon-button" onClick=${() => dismiss(one.id)} aria-label="Dismiss"><${Icon} name="close" size=${16} /></button>
          </div>`,
      )}
    </div>`;
}

applyTheme();
theme.subscribe(applyTheme);
connection.hello.subscribe(followRobots);
connection.event("robots").subscribe(followRobots);
connection.notices.subscribe((notices) => {
  const last = notices.at(-1);
  if (last && last.level !== "info") toast(last.level, last.message);
});
addEventListener("online", () => connection.retry());
document.addEventListener("visibilitychange", () => document.hidden || connection.retry());
render(html`<${App} />`, document.getElementById("app"));
connection.open();
