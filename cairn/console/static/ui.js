// Small parts that all views share: icons, badges, empty states, bars.

import { html } from "./vendor/preact-htm.js";

const PATHS = {
  map: "M9 4 3 6v14l6-2 6 2 6-2V4l-6 2-6-2zM9 4v14M15 6v14",
  drive: "M12 3v18M3 12h18M12 3l-3 3M12 3l3 3M12 21l-3-3M12 21l3-3M3 12l3-3M3 12l3 3M21 12l-3-3M21 12l-3 3",
  components: "M4 4h7v7H4zM13 13h7v7h-7zM13 4h7v7h-7zM7.5 11v5.500H13",
  logs: "M4 6h16M4 10h10M4 14h16M4 18h12",
  parameters: "M4 7h10M18 7h2M4 17h2M10 17h10M14 4v6M6 14v6",
  plots: "M4 4v16h16M7 15l4-5 3 3 5-7",
  topics: "M4 12a8 8 0 0 1 8-8M4 12a8 8 0 0 0 8 8M8 12a4 4 0 0 1 8 0 4 4 0 0 1-8 0M20 12h-4",
  diagnostics: "M3 12h4l3-8 4 16 3-8h4",
  camera: "M4 7h3l2-3h6l2 3h3v13H4zM12 10a3.500 3.500 0 1 0 0 7 3.500 3.500 0 0 0 0-7z",
  layers: "M12 3 3 8l9 5 9-5-9-5zM3 12l9 5 9-5M3 16l9 5 9-5",
  plus: "M12 5v14M5 12h14",
  minus: "M5 12h14",
  fit: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5",
  follow: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v4M12 18v4M2 12h4M18 12h4",
  close: "M6 6l12 12M18 6 6 18",
  goal: "M6 21V4M6 4h11l-2.500 4L17 12H6",
  waypoints: "M6 19a2 2 0 1 0 0-.01M18 5a2 2 0 1 0 0-.01M8 19h7a3.500 3.500 0 0 0 0-7H9a3.500 3.500 0 0 1 0-7h7",
  pose: "M12 3l6 18-6-4-6 4z",
  pan: "M8 13V6.500a1.500 1.500 0 0 1 3 0V11 5a1.500 1.500 0 0 1 3 0v6-4.500a1.500 1.500 0 0 1 3 0V15a6 6 0 0 1-6 6c-3 0-4-1-6-4.500L3.500 13A1.500 1.500 0 0 1 6 11.500z",
  zone: "M5 5l9-2 6 7-3 10-11-2zM5 5l1 13M14 3l3 17",
  world: "M4 8l8-4 8 4v8l-8 4-8-4zM4 8l8 4 8-4M12 12v8",
  play: "M7 4l13 8-13 8z",
  pause: "M7 5v14M17 5v14",
  sun: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v2M12 20v2M2 12h2M20 12h2M5 5l1.500 1.500M17.500 17.500 19 19M19 5l-1.500 1.500M6.500 17.500 5 19",
  moon: "M20 14A8 8 0 1 1 10 4a6.500 6.500 0 0 0 10 10z",
  auto: "M12 4a8 8 0 1 0 0 16zM12 4a8 8 0 0 1 0 16",
  lock: "M6 11h12v9H6zM8.500 11V8a3.500 3.500 0 0 1 7 0v3",
  link: "M5 12a10 10 0 0 1 14 0M8 15.500a6 6 0 0 1 8 0M12 19h.01M2 8.500a14.500 14.500 0 0 1 20 0",
  warning: "M12 4 2.500 20h19zM12 10v5M12 17.500v.01",
  info: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 11v6M12 7.500v.01",
  search: "M10.500 4a6.500 6.500 0 1 0 0 13 6.500 6.500 0 0 0 0-13zM15.500 15.500 21 21",
  proposal: "M5 9V5h4M15 5h4v4M19 15v4h-4M9 19H5v-4M12 9v6M9 12h6",
  restart: "M4 12a8 8 0 1 0 2.500-5.800M4 3v4.500h4.500",
  trash: "M4 7h16M9 7V4h6v3M6 7l1 13h10l1-13M10 11v5M14 11v5",
  gamepad: "M7 7h10a5 5 0 0 1 5 5v3a3 3 0 0 1-5.500 1.500L15 15H9l-1.500 1.500A3 3 0 0 1 2 15v-3a5 5 0 0 1 5-5zM8 9.500v4M6 11.500h4M16 10v.01M18 13v.01",
};

/** An icon by name, decorative: its button or its neighbor has the words. */
export const Icon = ({ name, size = 20 }) => html`
  <svg class="icon" width=${size} height=${size} viewBox="0 0 24 24" aria-hidden="true">
    <path d=${PATHS[name] ?? PATHS.info} />
  </svg>`;

/** A short state in words; `tone` is "ok", "warning", "bad", "accent" or "" (neutral). */
export const Badge = ({ tone = "", title, children }) =>
  html`<span class=${`badge ${tone}`} title=${title}>${children}</span>`;

/** What a view shows while there is nothing to show: what is missing, and what brings it. */
export const Empty = ({ icon = "info", title, children }) => html`
  <div class="empty">
    <${Icon} name=${icon} size=${28} />
    <strong>${title}</strong>
    ${children && html`<p>${children}</p>`}
  </div>`;

/** A bar from 0 to 1. */
export const Meter = ({ value, tone = "accent", label }) => html`
  <span class="meter" role="meter" aria-valuemin="0" aria-valuemax="1" aria-valuenow=${value} aria-label=${label}>
    <span class=${tone} style=${{ width: `${Math.round(100 * Math.min(1, Math.max(0, value)))}%` }} />
  </span>`;

/** Return the tone of a pose's health: that of the limits at which the components react. */
export const healthTone = (health) => (health >= 0.5 ? "ok" : health >= 0.3 ? "warning" : "bad");

/** Return a duration in words: "8.2 s", "3 min", "2 h". */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

/** Return a size in words: "312 kB". */
export function size(bytes) {
  if (!Number.isFinite(bytes)) return "–";
  if (bytes < 1000) return `${bytes} B`;
  if (bytes < 1e6) return `${(bytes / 1e3).toFixed(bytes < 1e4 ? 1 : 0)} kB`;
  return `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;
}
