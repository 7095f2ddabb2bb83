// The image of a camera with the recognized objects outlined.

import { html, useEffect, useRef, useState } from "../vendor/preact-htm.js";
import { seconds } from "../cdr.js";
import { useApp, useInterval, useRobot, useSubscription, useTopic } from "../hooks.js";
import { SavedStore, useStore } from "../store.js";
import { Badge, Empty, duration } from "../ui.js";
import { degrees, shortName } from "./shared.js";

const IMAGE = "sensor_msgs/msg/Image";
const OBJECTS = "cairn_msgs/msg/RecognizedObjectArray";
const RATES = [[1, "1 Hz"], [5, "5 Hz"], [10, "10 Hz"]];
const SHOWN_S = 1; // outlines disappear so long after the last recognition
const SILENT_S = 3;

const chosenImage = new SavedStore("camera.topic", "");
const chosenRate = new SavedStore("camera.rate", 5);

/** Return the CameraInfo topic beside an image topic: "left/image_raw" has "left/camera_info", "left_image" "left_info". */
export function infoTopicOf(image, topics) {
  const folder = image.slice(0, image.lastIndexOf("/"));
  const name = image.slice(folder.length + 1);
  const candidates = [`${folder}/camera_info`, `${folder}/${name.replace("image", "info")}`, `${folder}/${name.replace("image", "camera_info")}`];
  return candidates.find((topic) => topic !== image && topics.has(topic)) ?? null;
}

/**
 * Return where a point of the rectified image lies in the image as the camera took it, [u, v] in px.
 *
 * `info` is a sensor_msgs/msg/CameraInfo (plumb_bob or rational_polynomial); null, or one without a
 * calibration or with another model, leaves the point where it is.
 */
export function distorted([u, v], info) {
  if (!info || !(info.k[0] > 0) || !["plumb_bob", "rational_polynomial"].includes(info.distortion_model)) return [u, v];
  const { k, r, p, d } = info;
  const projected = p[0] > 0 ? p : [k[0], 0, k[2], 0, 0, k[4], k[5], 0];
  const x = (u - projected[2]) / projected[0];
  const y = (v - projected[6]) / projected[5];
  // The rectification is a rotation: its transpose leads back into the camera's frame.
  const rotates = r.some((value) => value !== 0);
  const [X, Y, W] = rotates ? [0, 1, 2].map((row) => r[row] * x + r[3 + row] * y + r[6 + row]) : [x, y, 1];
  const [a, b] = [X / W, Y / W];
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = d;
  const square = a * a + b * b;
  const radial = (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)));
  const x2 = a * radial + 2 * p1 * a * b + p2 * (square + 2 * a * a);
  const y2 = b * radial + p1 * (square + 2 * b * b) + 2 * p2 * a * b;
  return [k[0] * x2 + k[1] * y2 + k[2], k[4] * y2 + k[5]];
}

/** Return the four image points [u, v] of an object's corners, [] if it has none. */
export function outlineOf({ corners }, info) {
  if (corners.length !== 8) return [];
  return [0, 2, 4, 6].map((at) => distorted([corners[at], corners[at + 1]], info));
}

export function Camera() {
  const { connection } = useApp();
  const robot = useRobot();
  const topics = useStore(connection.topics);
  const saved = useStore(chosenImage);
  const rate = useStore(chosenRate);
  const of = (type) => [...topics.values()].filter((one) => one.type === type && one.channels > 0 && one.topic.startsWith(`/${robot}/`)).map((one) => one.topic);
  const images = of(IMAGE);
  const objectTopics = of(OBJECTS);
  if (images.length === 0)
    return html`<div class="panel"><${Empty} icon="camera" title="No camera">
      No component of ${robot || "the robot"} publishes images. In simulation, cairn up sim --overlay pixels adds a stereo camera.<//></div>`;
  const image = images.includes(`/${robot}/${saved}`) ? `/${robot}/${saved}` : (images.find((topic) => topic.includes("left")) ?? images[0]);
  return html`
    <div class="panel">
      <div class="row tools">
        <select aria-label="Image topic" value=${image} onChange=${(event) => chosenImage.set(shortName(event.target.value, robot))}>
          ${images.map((topic) => html`<option key=${topic} value=${topic}>${shortName(topic, robot)}</option>`)}
        </select>
        <select aria-label="Rate" value=${String(rate)} onChange=${(event) => chosenRate.set(Number(event.target.value))}>
          ${RATES.map(([hertz, words]) => html`<option key=${hertz} value=${String(hertz)}>at most ${words}</option>`)}
        </select>
      </div>
      <${View} key=${image} image=${image} objectTopic=${objectTopics[0] ?? null} infoTopic=${infoTopicOf(image, topics)} rate=${rate} outlined=${!image.includes("right")} />
    </div>`;
}

function View({ image, objectTopic, infoTopic, rate, outlined }) {
  const { mode } = useApp();
  const [size, setSize] = useState(null);
  const [error, setError] = useState("");
  const [recognized, setRecognized] = useState([]);
  const canvas = useRef(null);
  const overlay = useRef(null);
  const decoding = useRef(false);
  const next = useRef(null);
  const arrived = useRef([]);
  const lastObjects = useRef({ at: -Infinity });
  const visualMap = useTopic("visual_map");
  const info = useTopic(infoTopic, { maxHz: 1 });
  const names = new Map((visualMap?.objects ?? []).map((one) => [one.object_id, one.name]));
  const nameOf = (one) => names.get(one.object_id) || `object ${one.object_id}`;

  // One image is decoded at a time, off the main thread; those that arrive meanwhile replace each other.
  const show = async () => {
    if (decoding.current) return;
    decoding.current = true;
    while (next.current && canvas.current) {
      const { jpeg, width, height } = next.current;
      next.current = null;
      try {
        const bitmap = await createImageBitmap(jpeg);
        const element = canvas.current;
        if (!element) break;
        if (element.width !== bitmap.width || element.height !== bitmap.height) {
          element.width = bitmap.width;
          element.height = bitmap.height;
        }
        element.getContext("2d").drawImage(bitmap, 0, 0);
        bitmap.close();
        setSize((current) => (current?.width === width && current.height === height ? current : { width, height }));
        setError("");
      } catch {
        setError("The browser cannot decode the image.");
      }
    }
    decoding.current = false;
  };
  useSubscription(image, (message) => {
    next.current = message;
    arrived.current = [...arrived.current.slice(-9), performance.now()];
    show();
  }, { jpeg: true, maxHz: rate });
  useSubscription(outlined ? objectTopic : null, (message) => {
    lastObjects.current = { at: performance.now(), stamp: seconds(message.header.stamp) };
    setRecognized(message.objects);
  }, { maxHz: Math.max(rate, 5) });
  const [, render] = useState(0);
  useInterval(() => {
    if (performance.now() - lastObjects.current.at > SHOWN_S * 1000 && recognized.length > 0) setRecognized([]);
    render((count) => count + 1);
  }, 500);
  useEffect(() => drawOutlines(overlay.current, size, recognized, info, nameOf), [recognized, size, info, visualMap]);
  // The outlines have the resolution of the screen, not of the image.
  useEffect(() => {
    const observer = new ResizeObserver(() => drawOutlines(overlay.current, size, recognized, info, nameOf));
    if (overlay.current) observer.observe(overlay.current);
    return () => observer.disconnect();
  });

  const times = arrived.current;
  const age = times.length > 0 ? (performance.now() - times.at(-1)) / 1000 : Infinity;
  const hertz = times.length > 1 && age < SILENT_S ? ((times.length - 1) * 1000) / (times.at(-1) - times[0]) : NaN;
  const words = recognized.length > 0 ? recognized.map(nameOf).join(", ") : "no recognized object";
  return html`
    <div class=${`camera ${size ? "" : "waiting"}`} style=${size ? { aspectRatio: `${size.width} / ${size.height}` } : {}}>
      <canvas ref=${canvas} role="img" aria-label=${`Image of ${image} with ${words}`} />
      <canvas ref=${overlay} class="overlay" aria-hidden="true" />
      ${!size && html`<${Empty} icon="camera" title=${error || "Waiting for an image"}>${image}<//>`}
    </div>
    <div class="row muted">
      ${size && html`<span>${size.width} × ${size.height}</span>`}
      ${Number.isFinite(hertz) && html`<span>${hertz.toFixed(1)} Hz</span>`}
      ${mode === "live" && Number.isFinite(age) && age > SILENT_S && html`<${Badge} tone="warning">no image for ${duration(age)}<//>`}
      ${error && size && html`<span class="tone-bad">${error}</span>`}
    </div>
    ${outlined && html`
      <h3>Recognized objects</h3>
      ${recognized.length === 0
        ? html`<p class="muted">${objectTopic ? "None in the last second." : "No component recognizes objects."}</p>`
        : html`<table class="data"><thead><tr><th>object</th><th class="number">range</th><th class="number">bearing</th><th class="number">features</th></tr></thead>
            <tbody>${recognized.map((one, index) => html`
              <tr key=${one.object_id}><td><i class="swatch" style=${{ "--series": `var(--outline-${(index % 8) + 1})` }} /> ${nameOf(one)}
                ${one.corners.length === 0 && html` <span class="muted">(no outline)</span>`}</td>
                <td class="number">${one.range.toFixed(2)} m</td><td class="number">${degrees(one.bearing)}</td><td class="number">${one.inliers || "–"}</td></tr>`)}</tbody></table>`}`}`;
}

function drawOutlines(canvas, size, objects, info, nameOf) {
  if (!canvas || !size) return;
  const scale = devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
  if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  const style = getComputedStyle(canvas);
  context.font = `600 12px ${style.fontFamily}`;
  context.textBaseline = "middle";
  objects.forEach((one, index) => {
    // Pixel centers have whole coordinates: the image reaches from -0.5 to width - 0.5.
    const points = outlineOf(one, info).map(([u, v]) => [((u + 0.5) * width) / size.width, ((v + 0.5) * height) / size.height]);
    if (points.length === 0) return;
    const path = new Path2D();
    points.forEach(([x, y], at) => (at === 0 ? path.moveTo(x, y) : path.lineTo(x, y)));
    path.closePath();
    context.lineWidth = 4;
    context.strokeStyle = "rgb(0 0 0 / 55%)";
    context.stroke(path);
    context.lineWidth = 2;
    context.strokeStyle = style.getPropertyValue(`--outline-${(index % 8) + 1}`) || "#ffd23f";
    context.stroke(path);
    const [x, y] = points.reduce((best, point) => (point[1] < best[1] ? point : best));
    const label = `${nameOf(one)}  ${one.range.toFixed(1)} m`;
    const wide = context.measureText(label).width + 10;
    const left = Math.min(Math.max(0, x - wide / 2), Math.max(0, width - wide));
    const top = Math.min(Math.max(0, y - 22), height - 18);
    context.fillStyle = "rgb(0 0 0 / 70%)";
    context.fillRect(left, top, wide, 18);
    context.fillStyle = "#fff";
    context.fillText(label, left + 5, top + 9.5);
  });
}
