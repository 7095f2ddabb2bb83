// The time line of a recording: play, pause, seek and speed.

import { html, useEffect, useRef, useState } from "./vendor/preact-htm.js";
import { toast, useApp, useEvent } from "./hooks.js";
import { useStore } from "./store.js";
import { Icon } from "./ui.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const SEEK_PERIOD_MS = 150;
const STEP_NS = 1e9;

function clock(seconds) {
  const whole = Math.max(0, seconds);
  const minutes = Math.floor(whole / 60);
  return `${minutes}:${(whole % 60).toFixed(1).padStart(4, "0")}`;
}

export function Timeline() {
  const { connection } = useApp();
  const recording = useStore(connection.hello)?.recording;
  const playback = useEvent("playback");
  const act = (method, parameters = {}) => connection.call(method, parameters).catch((error) => toast("error", error.message));
  const [dragged, setDragged] = useState(null); // time chosen by the user [ns], until playback has it
  const sentAt = useRef(0);
  const timer = useRef(0);
  const start = recording?.start_ns ?? 0;
  const end = recording?.end_ns ?? 1;
  const now = dragged ?? playback?.time_ns ?? start;
  const playing = playback?.playing ?? false;
  const toggle = () => act(playing ? "pause" : "play");

  // While the slider is dragged, the newest time is sent, not more often than the picture can follow.
  const seek = (time) => {
    const at = Math.min(end, Math.max(start, time));
    setDragged(at);
    clearTimeout(timer.current);
    const wait = Math.max(0, sentAt.current + SEEK_PERIOD_MS - performance.now());
    timer.current = setTimeout(async () => {
      sentAt.current = performance.now();
      await act("seek", { time_ns: Math.round(at) });
      setDragged((current) => (current === at ? null : current));
    }, wait);
  };
  useEffect(() => () => clearTimeout(timer.current), []);
  useEffect(() => {
    const onKey = (event) => {
      if (event.target.closest?.("button, input, select, textarea, a, [role=tab], canvas")) return;
      if (event.code === "Space") toggle();
      else if (event.key === "ArrowLeft") seek(now - STEP_NS);
      else if (event.key === "ArrowRight") seek(now + STEP_NS);
      else return;
      event.preventDefault();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  });
  if (!recording) return null;
  const seconds = (time) => (time - start) / 1e9;
  return html`
    <footer class="timeline" aria-label="Time line of the recording">
      <button class="icon-button play" onClick=${toggle} aria-label=${playing ? "Pause" : "Play"} title=${`${playing ? "Pause" : "Play"} (Space)`}>
        <${Icon} name=${playing ? "pause" : "play"} />
      </button>
      <output class="time">${clock(seconds(now))} <span class="muted">/ ${clock(seconds(end))}</span></output>
      <input type="range" class="seek" aria-label="Time" aria-valuetext=${clock(seconds(now))} min="0" max=${seconds(end)} step="0.1"
        value=${seconds(now)} onInput=${(event) => seek(start + Number(event.target.value) * 1e9)} />
      <time class="muted wall">${new Date(now / 1e6).toLocaleTimeString()}</time>
      <select aria-label="Speed" value=${playback?.speed ?? 1} onChange=${(event) => act("speed", { factor: Number(event.target.value) })}>
        ${SPEEDS.map((speed) => html`<option key=${speed} value=${speed}>${speed}×</option>`)}
      </select>
      <span class="file muted" title=${recording.file}>${String(recording.file ?? "").split("/").at(-1)}</span>
    </footer>`;
}
