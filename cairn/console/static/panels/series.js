// Values over time for plots: a bounded buffer, and its reduction to one line per pixel column.

/** The newest values of one field, oldest first, with their times [s]; NaN marks a gap. */
export class Series {
  constructor(capacity = 60_000) {
    this.times = new Float64Array(capacity);
    this.values = new Float64Array(capacity);
    this.start = 0;
    this.length = 0;
  }

  /** Append a value; a time before the last one (time was set back, or a seek) clears the buffer. */
  push(time, value) {
    if (this.length && time < this.timeAt(this.length - 1)) this.clear();
    const capacity = this.times.length;
    const at = (this.start + this.length) % capacity;
    this.times[at] = time;
    this.values[at] = value;
    if (this.length < capacity) this.length += 1;
    else this.start = (this.start + 1) % capacity;
  }

  /** Mark that values are missing from here on, so that no line is drawn across. */
  gap() {
    if (this.length && !Number.isNaN(this.valueAt(this.length - 1))) {
      this.push(this.timeAt(this.length - 1), NaN);
    }
  }

  clear() {
    this.start = this.length = 0;
  }

  timeAt(index) {
    return this.times[(this.start + index) % this.times.length];
  }

  valueAt(index) {
    return this.values[(this.start + index) % this.values.length];
  }

  /** Return the newest number, or NaN. */
  last() {
    for (let index = this.length - 1; index >= 0; index -= 1) {
      const value = this.valueAt(index);
      if (!Number.isNaN(value)) return value;
    }
    return NaN;
  }

  /** Return the index of the first value at `time` or later. */
  indexAt(time) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.timeAt(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

/**
 * Reduce series to a common time axis of two points per column: the least and the greatest value.
 *
 * Every extreme value stays visible, and the cost of drawing does not grow with the rate of a topic.
 * A column without a value is `undefined` (the line passes over it), a gap is `null` (it ends).
 *
 * @param {Series[]} series
 * @param {number} from start of the window [s]
 * @param {number} to end of the window [s]
 * @param {number} columns
 * @returns {Array} the times [s], then the values of each series, as uPlot takes them
 */
export function decimate(series, from, to, columns) {
  const width = (to - from) / columns;
  const times = Float64Array.from({ length: 2 * columns }, (_, index) => from + (index / 2 + 0.25) * width);
  return [times, ...series.map((one) => reduced(one, from, to, columns))];
}

function reduced(series, from, to, columns) {
  const out = new Array(2 * columns).fill(undefined);
  const { times, values, length } = series;
  const scale = columns / (to - from);
  // From the last value before the window on: the line enters it from there.
  let index = series.indexAt(from);
  if (index > 0 && index < length && !Number.isNaN(series.valueAt(index - 1))) out[0] = series.valueAt(index - 1);
  let column = -1;
  let least = 0;
  let greatest = 0;
  let rising = true; // the value that comes first in time is drawn first
  const store = () => {
    if (column < 0) return;
    out[2 * column] = rising ? least : greatest;
    if (least !== greatest) out[2 * column + 1] = rising ? greatest : least;
  };
  let at = (series.start + index) % times.length;
  for (; index < length; index += 1) {
    const time = times[at];
    const value = values[at];
    at += 1;
    if (at === times.length) at = 0;
    if (time > to) break;
    const next = Math.min(columns - 1, Math.max(0, Math.floor((time - from) * scale)));
    if (value !== value) {
      store();
      column = -1;
      out[2 * next + 1] = null;
    } else if (next !== column) {
      store();
      column = next;
      least = greatest = value;
      rising = true;
    } else if (value > greatest) {
      greatest = value;
      rising = true;
    } else if (value < least) {
      least = value;
      rising = false;
    }
  }
  store();
  return out;
}
