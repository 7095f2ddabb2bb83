// The navigator's state in words, from its messages.

const LABELS = ["loading", "localizing", "planning", "driving", "recovering", "arrived", "failed", "canceled"];
const TONES = ["accent", "accent", "accent", "ok", "warning", "ok", "bad", ""];
const FIRST_END_STATE = 5;

const ALTERNATIVE = 0.01, MOST_ALTERNATIVES = 3; // how probable positions must be to be shown, and how many

/** Return the other positions at which a robot may be, of a LocalizationEstimate; older recordings have none. */
export const alternativesOf = (estimate) =>
  (estimate.alternatives ?? []).filter((one) => one.probability >= ALTERNATIVE).slice(0, MOST_ALTERNATIVES);

/** Return whether a NavigationStatus is that of a mission under way. */
export const isUnderWay = (status) => Boolean(status) && status.mission_id > 0 && status.state < FIRST_END_STATE;

/** Return {label, tone, detail, reason} for a NavigationStatus and a VelocityGateStatus; either may be null. */
export function navigationState(status, gate) {
  if (gate?.operator && gate.source === "teleoperation")
    return { label: "manual", tone: "accent", detail: `${gate.operator} drives`, reason: gate.reason };
  if (!status || status.mission_id === 0) return { label: "idle", tone: "", detail: "", reason: "No goal has been sent." };
  const label = LABELS[status.state] ?? `state ${status.state}`;
  const tone = TONES[status.state] ?? "";
  const goals = status.goals > 1 ? `goal ${Math.min(status.goal + 1, status.goals)} of ${status.goals}, ` : "";
  const detail = isUnderWay(status) && status.distance_left > 0 ? `${goals}${status.distance_left.toFixed(1)} m left` : goals.slice(0, -2);
  return { label, tone, detail, reason: status.reason };
}
