// The grid map as a picture with one pixel per cell.

import { poseOf, timeOf } from "./geometry.js";

const MOST_CELLS = 25_000_000; // as schemas/nav_msgs.py

export class GridMap {
  #image = null;
  #colors = null;

  /** Take a nav_msgs/msg/OccupancyGrid. */
  constructor({ header, info, data }) {
    if (info.width * info.height > MOST_CELLS || data.length !== info.width * info.height)
      throw new Error(`a map of ${info.width} x ${info.height} cells with ${data.length} values`);
    this.time = timeOf(header);
    this.width = info.width;
    this.height = info.height;
    this.resolution = info.resolution;
    this.origin = poseOf(info.origin);
    this.cells = data.slice(); // updates change them
  }

  /** Take a map_msgs/msg/OccupancyGridUpdate; one that is not within the map is ignored. */
  update({ x, y, width, height, data }) {
    if (x < 0 || y < 0 || x + width > this.width || y + height > this.height || data.length !== width * height) return;
    for (let row = 0; row < height; row++) this.cells.set(data.subarray(row * width, (row + 1) * width), (y + row) * this.width + x);
    if (this.#image && width > 0 && height > 0) this.#paint(x, y, width, height);
  }

  /** The value of the cell at a position [m]: 0 to 100, -1 unknown; null outside of the map. */
  valueAt(x, y) {
    const [ox, oy, theta] = this.origin;
    const c = Math.cos(theta);
    const s = Math.sin(theta);
    const column = Math.floor((c * (x - ox) + s * (y - oy)) / this.resolution);
    const row = Math.floor((-s * (x - ox) + c * (y - oy)) / this.resolution);
    return column >= 0 && row >= 0 && column < this.width && row < this.height ? this.cells[row * this.width + column] : null;
  }

  /** Return the rectangle [x0, y0, x1, y1] [m] around the known cells, null if there are none. */
  bounds() {
    let [x0, y0, x1, y1] = [this.width, this.height, -1, -1];
    for (let row = 0, at = 0; row < this.height; row++)
      for (let column = 0; column < this.width; column++, at++)
        if (this.cells[at] !== -1) {
          if (column < x0) x0 = column;
          if (column > x1) x1 = column;
          if (row < y0) y0 = row;
          y1 = row;
        }
    if (x1 < 0) return null;
    const [ox, oy, theta] = this.origin;
    const corners = [[x0, y0], [x1 + 1, y0], [x0, y1 + 1], [x1 + 1, y1 + 1]].map(([column, row]) => [
      ox + this.resolution * (column * Math.cos(theta) - row * Math.sin(theta)),
      oy + this.resolution * (column * Math.sin(theta) + row * Math.cos(theta)),
    ]);
    const xs = corners.map((corner) => corner[0]);
    const ys = corners.map((corner) => corner[1]);
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }

  /** Draw the map; `colors` is {free, occupied}, each [red, green, blue]. Unknown cells stay as they are. */
  draw(context, view, colors) {
    if (this.width === 0 || this.height === 0) return;
    if (this.#colors !== colors) {
      this.#colors = colors;
      this.#image ??= new OffscreenCanvas(this.width, this.height);
      this.#paint(0, 0, this.width, this.height);
    }
    const [px, py] = view.toScreen(this.origin[0], this.origin[1]);
    const cell = this.resolution * view.scale;
    context.save();
    context.translate(px, py);
    context.rotate(-this.origin[2]);
    context.imageSmoothingEnabled = cell < 1;
    context.drawImage(this.#image, 0, -this.height * cell, this.width * cell, this.height * cell);
    context.restore();
  }

  /** Paint a window of cells into the picture, whose first row is the map's last one. */
  #paint(x, y, width, height) {
    const picture = new ImageData(width, height);
    const pixels = new Uint32Array(picture.data.buffer);
    const table = colorTable(this.#colors);
    for (let row = 0; row < height; row++) {
      const from = (y + row) * this.width + x;
      const to = (height - 1 - row) * width;
      for (let column = 0; column < width; column++) pixels[to + column] = table[this.cells[from + column] & 0xff];
    }
    this.#image.getContext("2d").putImageData(picture, x, this.height - y - height);
  }
}

const tables = new WeakMap();

/** Return the pixel (RGBA, little endian) of each cell value, as an unsigned byte. */
function colorTable(colors) {
  let table = tables.get(colors);
  if (!table) {
    table = new Uint32Array(256);
    for (let value = 0; value <= 100; value++) {
      const mix = (i) => Math.round(colors.free[i] + (value / 100) * (colors.occupied[i] - colors.free[i]));
      table[value] = (0xff000000 | (mix(2) << 16) | (mix(1) << 8) | mix(0)) >>> 0;
    }
    tables.set(colors, table);
  }
  return table;
}
