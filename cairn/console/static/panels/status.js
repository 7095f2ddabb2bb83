// The state of navigation at a glance: pose, navigator, velocity gate, each with its reason.

import { html } from "../vendor/preact-htm.js";
import { alternativesOf, isUnderWay, navigationState } from "../navigation.js";
import { Badge, Empty, Meter, duration, healthTone } from "../ui.js";
import { ErrorNote, Facts, degrees, heading, useComponents, useFresh, useOpenPanel } from "./shared.js";
import { failureOf, isFailed } from "./components.js";

const STALE_S = 3;
const MOST_FAILED = 4;
const MAPPED = 0.6; // from this health on the map builder integrates scans
const MOTION = ["standing", "moving", "blocked", "done", "stopped"];
const MOTION_TONES = ["", "ok", "warning", "ok", "bad"];
const meters = (value) => (value < 1 ? `${Math.round(value * 100)} cm` : `${value.toFixed(1)} m`);

export function Status() {
  const pose = useFresh("localization", { maxHz: 5 });
  const navigation = useFresh("navigation_status", { maxHz: 5 });
  const motion = useFresh("motion_status", { maxHz: 5 });
  const gate = useFresh("velocity_gate_status", { maxHz: 5 });
  return html`
    <div class="panel">
      <${Failures} />
      <${PoseCard} ...${pose} />
      <${NavigatorCard} ...${navigation} gate=${gate.message} motion=${motion.message} />
      <${GateCard} ...${gate} />
    </div>`;
}

/** Components that failed: what an operator must know before anything else. */
function Failures() {
  const open = useOpenPanel();
  const failed = (useComponents() ?? []).filter(isFailed);
  if (failed.length === 0) return null;
  return html`
    <section class="card bad" aria-label="Failed components">
      <header><h3>${failed.length === 1 ? "A component has failed" : `${failed.length} components have failed`}</h3></header>
      ${failed.slice(0, MOST_FAILED).map((one) => html`
        <div class="row spread" key=${one.name}>
          <span class="grow"><strong>${one.name}</strong> ${failureOf(one)}</span>
          <button class="button small" onClick=${() => open("logs", { component: one.name })}>Logs</button>
        </div>`)}
      ${failed.length > MOST_FAILED && html`<button class="link" onClick=${() => open("components", {})}>All in the panel Components</button>`}
    </section>`;
}

const Age = ({ age }) => age > STALE_S && Number.isFinite(age) && html`<${Badge} tone="warning">no message for ${duration(age)}<//>`;

function PoseCard({ message: estimate, age }) {
  if (!estimate)
    return html`<section class="card"><header><h3>Pose</h3></header><${Empty} title="No pose yet">
      The localizer publishes it once it is loaded: with the deployment, with the first goal, or by Load in the panel Components.<//></section>`;
  const { pose } = estimate.pose;
  const tone = healthTone(estimate.health);
  const words = estimate.health >= MAPPED ? "reliable" : { ok: "sufficient", warning: "uncertain", bad: "lost" }[tone];
  return html`
    <section class="card" aria-label="Pose">
      <header><h3>Pose</h3><span class="row"><${Age} age=${age} /><${Badge} tone=${tone}>${estimate.located ? words : "not located"}<//></span></header>
      <div class="health-line"><${Meter} value=${estimate.health} tone=${tone} label="Health of the pose" />
        <strong class=${`tone-${tone}`}>${Math.round(estimate.health * 100)} %</strong></div>
      <p class="reason">${estimate.reason || "Nothing lowers the health of the pose."}</p>
      <${Facts} entries=${[
        estimate.located && ["x, y [m]", `${pose.position.x.toFixed(2)}, ${pose.position.y.toFixed(2)}`],
        estimate.located && ["Heading", degrees(heading(pose.orientation))],
        ["Position ±", meters(estimate.position_sd)],
        ["Heading ±", degrees(estimate.heading_sd)],
        ["Scan explained", Number.isNaN(estimate.scan_fit) ? "–" : `${Math.round(estimate.scan_fit * 100)} %`],
        ["Landmarks agree", `${estimate.objects_agreeing} of ${estimate.objects_agreeing + estimate.objects_contradicting}`,
          estimate.objects_contradicting > 0 ? "warning" : ""],
        ["Particles", estimate.particles],
        ...alternativesOf(estimate).map((one) =>
          [`Or at [m], ${Math.round(one.probability * 100)} %`, `${one.x.toFixed(2)}, ${one.y.toFixed(2)}`, "warning"]),
      ]} />
    </section>`;
}

function NavigatorCard({ message: status, age, gate, motion }) {
  const state = navigationState(status, gate);
  const active = isUnderWay(status);
  return html`
    <section class="card" aria-label="Navigator">
      <header><h3>Navigator</h3><span class="row">${active && html`<${Age} age=${age} />`}<${Badge} tone=${state.tone}>${state.label}<//></span></header>
      <p class="reason">${state.reason || (active ? "On the way to the goal." : "The last mission has ended.")}</p>
      ${active && status.goals > 0 && html`<${GoalProgress} status=${status} />`}
      ${status && status.mission_id > 0 && html`<${Facts} entries=${[
        ["Goal", `${Math.min(status.goal + 1, status.goals)} of ${status.goals}`],
        active && ["Distance left", meters(status.distance_left)],
        active && ["Time left", status.time_left > 0 ? duration(status.time_left) : "–"],
        ["Elapsed", duration(status.elapsed)],
        ["Recoveries", status.recoveries, status.recoveries > 0 ? "warning" : ""],
      ]} />`}
      ${motion && html`
        <div class="row"><span class="muted">Motion</span><${Badge} tone=${MOTION_TONES[motion.state]}>${MOTION[motion.state] ?? motion.state}<//>
          <span>${motion.speed.toFixed(2)} m/s</span><span class="muted">clearance ${meters(motion.clearance)}</span></div>
        ${motion.reason && motion.reason !== status?.reason && html`<p class="reason">${motion.reason}</p>`}`}
    </section>`;
}

function GoalProgress({ status }) {
  const goals = status.goals;
  return html`
    <div class="goals" role="progressbar" aria-valuemin="0" aria-valuemax=${goals} aria-valuenow=${status.goal}
      aria-label=${`Goal ${status.goal + 1} of ${goals}`}>
      ${Array.from({ length: Math.min(goals, 40) }, (_, index) => {
        const at = Math.floor((index * goals) / Math.min(goals, 40));
        return html`<span key=${index} class=${at < status.goal ? "done" : at === status.goal ? "now" : ""} />`;
      })}
    </div>`;
}

function GateCard({ message: gate, age }) {
  if (!gate)
    return html`<section class="card"><header><h3>Velocity gate</h3></header><${Empty} title="No status of the velocity gate">
      Without it the emergency stop is not known. See the panel Components.<//></section>`;
  const refused = gate.refused_lease + gate.refused_late + gate.refused_invalid + gate.refused_disabled;
  const tone = gate.emergency_stop ? "bad" : gate.stopped ? "warning" : gate.source ? "ok" : "";
  const words = gate.emergency_stop ? "emergency stop" : gate.stopped ? "held" : gate.source ? "drives" : "no command";
  return html`
    <section class="card" aria-label="Velocity gate">
      <header><h3>Velocity gate</h3><span class="row"><${Age} age=${age} /><${Badge} tone=${tone}>${words}<//></span></header>
      ${gate.emergency_stop && html`<${ErrorNote}>The emergency stop is engaged: ${gate.reason || "no reason given"}<//>`}
      ${!gate.emergency_stop && gate.reason && html`<p class="reason">${gate.reason}</p>`}
      <${Facts} entries=${[
        ["Source", gate.source || "none"],
        ["Operator", gate.operator || "none"],
        ["Speed", `${gate.speed.toFixed(2)} m/s`],
        ["Turn", `${gate.turn.toFixed(2)} rad/s`],
        gate.limits.length > 0 && ["Limited by", gate.limits.join(", ")],
        refused > 0 && ["Refused", `${refused} commands`],
      ]} />
    </section>`;
}
