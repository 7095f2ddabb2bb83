// Poses in the plane, the view of the map, and the frames of a robot.
//
// A pose is [x, y, theta] in m and rad; angles are positive to the left.

export const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

/** Return the pose `b`, given in the frame of pose `a`, in the frame of `a`. */
export function compose(a, b) {
  const c = Math.cos(a[2]);
  const s = Math.sin(a[2]);
  return [a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap(a[2] + b[2])];
}

export const yawOf = (q) => Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z));
export const poseOf = (message) => [message.position.x, message.position.y, yawOf(message.orientation)];
export const transformPose = (transform) => [transform.translation.x, transform.translation.y, yawOf(transform.rotation)];
export const timeOf = (header) => header.stamp.sec + header.stamp.nanosec * 1e-9;

/** Return whether a laser is mounted upside down (z axis down), so that its angles run clockwise. */
export const isUpsideDown = (q) => 1 - 2 * (q.x * q.x + q.y * q.y) < 0;

/** Poses of one frame in another over time, interpolated between the samples of the last seconds. */
export class PoseHistory {
  #samples = []; // [time in s, pose], in order

  constructor(seconds = 3) {
    this.seconds = seconds;
  }

  /** Add a sample; returns whether it does not continue the ones before, as after a jump in time. */
  add(time, pose) {
    const last = this.#samples.at(-1);
    const jumps = !last || time < last[0] || time > last[0] + this.seconds;
    if (jumps) this.#samples = []; // time was set back, or a recording goes on elsewhere
    if (last && time === last[0]) return false;
    this.#samples.push([time, pose]);
    while (this.#samples.length > 2 && this.#samples[0][0] < time - this.seconds) this.#samples.shift();
    return jumps;
  }

  get latest() {
    return this.#samples.at(-1)?.[1] ?? null;
  }

  /** Return the pose at a time, that of the nearest sample outside of them; null without samples. */
  at(time) {
    const samples = this.#samples;
    if (samples.length === 0) return null;
    if (time >= samples.at(-1)[0]) return samples.at(-1)[1];
    let after = samples.length - 1;
    while (after > 0 && samples[after - 1][0] > time) after--;
    if (after === 0) return samples[0][1];
    const [t0, a] = samples[after - 1];
    const [t1, b] = samples[after];
    const share = (time - t0) / (t1 - t0);
    return [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * wrap(b[2] - a[2])];
  }
}

const LEAST_SCALE = 2;
const LARGEST_SCALE = 2000;

/** What part of the plane a canvas shows: `x`, `y` [m] is at its center, `scale` is in pixels per meter. */
export class Viewport {
  x = 0;
  y = 0;
  scale = 60;
  width = 1;
  height = 1;

  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Zoom by a factor; the point under the pixel `px`, `py` stays. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(LARGEST_SCALE, Math.max(LEAST_SCALE, this.scale * factor));
    const [nx, ny] = this.toWorld(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }

  /** Show the rectangle [x0, y0, x1, y1] within margins [px], which what floats above the map needs. */
  fit([x0, y0, x1, y1], { left, right, top, bottom }) {
    const width = Math.max(1, this.width - left - right);
    const height = Math.max(1, this.height - top - bottom);
    const scale = Math.min(width / Math.max(0.5, x1 - x0), height / Math.max(0.5, y1 - y0));
    this.scale = Math.min(LARGEST_SCALE, Math.max(LEAST_SCALE, scale));
    this.x = (x0 + x1) / 2 + (right - left) / 2 / this.scale;
    this.y = (y0 + y1) / 2 + (top - bottom) / 2 / this.scale;
  }
}

/** Return the half axes [m] and the angle [rad] of the ellipse of a 2x2 covariance, for `sigmas`. */
export function ellipseOf(xx, xy, yy, sigmas) {
  const mean = (xx + yy) / 2;
  const root = Math.hypot((xx - yy) / 2, xy);
  const axis = (value) => sigmas * Math.sqrt(Math.max(0, value));
  return { a: axis(mean + root), b: axis(mean - root), angle: Math.atan2(2 * xy, xx - yy) / 2 };
}

/** Return the length [m] of a scale bar: 1, 2 or 5 times a power of ten, at most `most` pixels. */
export function scaleBar(scale, most) {
  const limit = most / scale;
  const power = 10 ** Math.floor(Math.log10(limit));
  return power * ([5, 2, 1].find((step) => step * power <= limit) ?? 1);
}
