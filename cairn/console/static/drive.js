// The panel "Drive": who steers, the goal under way, and driving by hand.

import { html, useEffect, useMemo, useRef, useState } from "./vendor/preact-htm.js";
import { toast, useAction, useApp, useRobot, useTopic } from "./hooks.js";
import { useLease } from "./lease.js";
import { isUnderWay, navigationState } from "./navigation.js";
import { useSteer } from "./steering.js";
import { SavedStore, useStore } from "./store.js";
import { Teleoperation } from "./teleoperation.js";
import { Badge, Icon, duration } from "./ui.js";

const savedLimits = new SavedStore("limits", { speed: 0.3, turn: 0.8 });
const FASTEST = { speed: 0.6, turn: 1.5 }; // of a velocity gate by default

export function Drive() {
  const { connection } = useApp();
  const mayWatchOnly = useStore(connection.hello)?.may === "watch";
  return html`
    <${Goal} />
    ${mayWatchOnly
      ? html`<p class="muted">This console may watch only: it was started or opened without the right to steer.</p>`
      : html`<${Manual} /><${Numbers} />`}
    <${Gate} />`;
}

function Goal() {
  const status = useTopic("navigation_status", { maxHz: 5 });
  const gate = useTopic("velocity_gate_status", { maxHz: 5 });
  const steer = useSteer();
  const state = navigationState(status, gate);
  const hasMission = status && status.mission_id > 0;
  return html`
    <section class="card">
      <header><h3>Goal</h3><${Badge} tone=${state.tone}>${state.label}<//></header>
      ${hasMission
        ? html`
            <dl class="facts">
              <div><dt>Goal</dt><dd>${Math.min(status.goal + 1, status.goals)} of ${status.goals}</dd></div>
              <div><dt>Left</dt><dd>${isUnderWay(status) ? `${status.distance_left.toFixed(1)} m` : "–"}</dd></div>
              <div><dt>Time left</dt><dd>${isUnderWay(status) ? duration(status.time_left) : "–"}</dd></div>
              <div><dt>Elapsed</dt><dd>${duration(status.elapsed)}</dd></div>
              <div><dt>Recoveries</dt><dd>${status.recoveries}</dd></div>
            </dl>
            ${status.reason && html`<p class="reason">${status.reason}</p>`}`
        : html`<p class="muted">No goal. Choose the flag on the map, press at the goal and drag toward the heading.</p>`}
      ${isUnderWay(status) && html`<button class="button" onClick=${() => steer("cancel")}>Cancel the goal</button>`}
    </section>`;
}

/** A goal or the initial pose in numbers: what a drag on the map gives, for the keyboard. */
function Numbers() {
  const steer = useSteer();
  const [text, setText] = useState({ x: "", y: "", theta: "" });
  const pose = [Number(text.x), Number(text.y), (Number(text.theta || 0) * Math.PI) / 180];
  const isValid = text.x.trim() !== "" && text.y.trim() !== "" && pose.every(Number.isFinite);
  const field = (name, label) => html`
    <label class="field">${label}
      <input class="input" inputmode="decimal" value=${text[name]} onInput=${(event) => setText({ ...text, [name]: event.target.value })} />
    </label>`;
  const go = async (event) => {
    event.preventDefault();
    if (isValid && (await steer("go", { poses: [pose] })) !== undefined) toast("info", "Goal sent.");
  };
  const locate = async () => {
    if ((await steer("locate", { x: pose[0], y: pose[1], theta: pose[2] })) !== undefined) toast("info", "The initial pose was sent.");
  };
  return html`
    <form class="card" onSubmit=${go}>
      <header><h3>Pose in numbers</h3></header>
      <div class="fields">${field("x", "x [m]")} ${field("y", "y [m]")} ${field("theta", "heading [°]")}</div>
      <div class="row">
        <button class="button primary" disabled=${!isValid}>Go there</button>
        <button class="button" type="button" disabled=${!isValid} onClick=${locate}>Set as initial pose</button>
      </div>
    </form>`;
}

function Manual() {
  const { connection } = useApp();
  const robot = useRobot();
  const lease = useLease();
  const act = useAction();
  const saved = useStore(savedLimits);
  const fastest = { speed: lease.limits?.speed ?? FASTEST.speed, turn: lease.limits?.turn_speed ?? FASTEST.turn };
  const limits = { speed: Math.min(saved.speed, fastest.speed), turn: Math.min(saved.turn, fastest.turn) };
  const teleoperation = useMemo(() => new Teleoperation(connection), [connection]);
  const state = useStore(teleoperation.state);
  const gamepad = useStore(teleoperation.gamepad);
  const [keyboard, setKeyboard] = useState(false);
  teleoperation.limits = limits;
  const isReady = lease.mine;
  useEffect(() => {
    if (!isReady) return undefined;
    teleoperation.start(robot);
    return () => teleoperation.stop();
  }, [teleoperation, robot, isReady]);
  useEffect(() => void (teleoperation.keyboard = isReady && keyboard), [teleoperation, keyboard, isReady]);
  const slider = (name, label, unit) => html`
    <label class="field">
      <span>${label} <output>${limits[name].toFixed(2)} ${unit}</output></span>
      <input type="range" min="0.05" max=${fastest[name]} step="0.05" value=${limits[name]}
        onInput=${(event) => savedLimits.set({ ...limits, [name]: Number(event.target.value) })} />
    </label>`;
  return html`
    <section class="card">
      <header><h3>Drive by hand</h3>${state.source && html`<${Badge} tone="accent">${state.source}<//>`}</header>
      ${!isReady &&
      html`<p class="muted">${lease.holder ? `${lease.holder} steers. Ask for the lease to drive.` : "Driving needs the lease."}</p>
        ${!lease.holder && html`<button class="button primary" onClick=${() => act("acquire_lease")}><${Icon} name="lock" size=${16} />Take the lease</button>`}`}
      ${isReady &&
      html`
        <div class="manual">
          <${Pad} hold=${(shares) => (teleoperation.pad = shares)} shares=${state.source ? [state.speed / limits.speed, state.turn / limits.turn] : null} />
          <div class="manual-side">
            <p class="readout"><output>${state.speed.toFixed(2)} m/s</output><output>${state.turn.toFixed(2)} rad/s</output></p>
            <label class="check"><input type="checkbox" checked=${keyboard} onChange=${(event) => setKeyboard(event.target.checked)} /> Keyboard</label>
            <p class="muted">${keyboard ? "Hold Shift, and drive with W A S D or the arrows." : "Hold the pad to drive; let go to stop."}</p>
            ${gamepad && html`<p class="muted"><${Icon} name="gamepad" size=${16} /> Hold a shoulder button, and drive with the sticks.</p>`}
          </div>
        </div>
        ${state.error && html`<p class="tone-bad" role="alert">${state.error}</p>`}
        <div class="fields two">${slider("speed", "Speed", "m/s")} ${slider("turn", "Turn rate", "rad/s")}</div>
        <p class="muted">While you drive, a goal waits; it goes on some seconds after.</p>`}
    </section>`;
}

/** A pad: held, it drives in the direction of the pointer from its center. */
function Pad({ hold, shares }) {
  const element = useRef(null);
  const pointer = useRef(null);
  const shareOf = (event) => {
    const box = element.current.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width - 0.5;
    const y = 0.5 - (event.clientY - box.top) / box.height;
    const length = Math.max(0.5, Math.hypot(x, y)) * 2;
    return [(2 * y) / length, (-2 * x) / length];
  };
  const down = (event) => {
    if (pointer.current !== null || event.button > 0) return;
    pointer.current = event.pointerId;
    element.current.setPointerCapture(event.pointerId);
    hold(shareOf(event));
  };
  const move = (event) => event.pointerId === pointer.current && hold(shareOf(event));
  const up = (event) => {
    if (event.pointerId !== pointer.current) return;
    pointer.current = null;
    hold(null);
  };
  const [speed, turn] = shares ?? [0, 0];
  return html`
    <div class=${`pad ${shares ? "held" : ""}`} ref=${element} role="application" aria-label="Pad: hold to drive, drag for direction"
      onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up} onLostPointerCapture=${up}>
      <span class="pad-knob" style=${{ transform: `translate(${-38 * turn}px, ${-38 * speed}px)` }} />
    </div>`;
}

/** What holds or limits the robot: the velocity gate's words. */
function Gate() {
  const gate = useTopic("velocity_gate_status", { maxHz: 5 });
  if (!gate) return null;
  return html`
    <section class="card">
      <header><h3>Velocity gate</h3><${Badge} tone=${gate.emergency_stop ? "bad" : gate.stopped ? "warning" : gate.source ? "ok" : ""}>
        ${gate.emergency_stop ? "emergency stop" : gate.stopped ? "holds the robot" : gate.source || "no source"}<//></header>
      <dl class="facts">
        <div><dt>Speed</dt><dd>${gate.speed.toFixed(2)} m/s</dd></div>
        <div><dt>Turn</dt><dd>${gate.turn.toFixed(2)} rad/s</dd></div>
        <div><dt>Operator</dt><dd>${gate.operator || "–"}</dd></div>
        ${gate.limits.length > 0 && html`<div><dt>Limited by</dt><dd>${gate.limits.join(", ")}</dd></div>`}
      </dl>
      ${gate.stopped && gate.reason && html`<p class="reason">${gate.reason}</p>`}
    </section>`;
}
