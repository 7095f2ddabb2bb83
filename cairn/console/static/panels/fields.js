// The numeric fields of a message type, and the value of a field in a message.

const MAX_DEPTH = 8;
const MAX_FIELDS = 2000;
const NUMBER = /^(u?int(8|16|32|64)|float(32|64)|byte|char)$/;

/** Return whether values of a primitive type can be plotted; a bool is 0 or 1. */
export function isNumeric(type) {
  return type === "bool" || NUMBER.test(type);
}

/**
 * Return the numeric fields of a message type, in the order of its definition.
 *
 * @param {{type: string, fields: (type?: string) => Array}} decode a decoder of cdr.js
 * @returns {Array<{path: string, type: string}>} the index in a sequence is 0, to be changed by the user:
 *   `transforms[0].transform.translation.x`
 */
export function numericFields(decode) {
  const found = [];
  const visit = (name, prefix, depth) => {
    if (depth > MAX_DEPTH) return;
    for (const field of decode.fields(name)) {
      if (found.length === MAX_FIELDS) return;
      const path = `${prefix}${field.name}${field.isArray ? "[0]" : ""}`;
      if (field.type.includes("/")) visit(field.type, `${path}.`, depth + 1);
      else if (isNumeric(field.type)) found.push({ path, type: field.type });
    }
  };
  visit(decode.type, "", 0);
  return found;
}

/**
 * Return the steps of a field's path: `ranges[3]` is ["ranges", 3].
 *
 * Raises `Error` if the text is not a path.
 */
export function parsePath(text) {
  const steps = [];
  const pattern = /(?:^|\.)([A-Za-z_]\w*)|\[(\d{1,9})\]/y;
  while (pattern.lastIndex < text.length) {
    const match = pattern.exec(text);
    if (!match) throw new Error(`${text}: not a field; write a.b or a[3].b`);
    steps.push(match[1] ?? Number(match[2]));
  }
  if (typeof steps[0] !== "string" || text.startsWith(".")) throw new Error(`${text || "empty"}: not a field; write a.b or a[3].b`);
  return steps;
}

/** Return the number at the steps of a path in a message; NaN if there is none. */
export function numberAt(message, steps) {
  let value = message;
  for (const step of steps) {
    if (value === null || value === undefined) return NaN;
    value = value[step];
  }
  switch (typeof value) {
    case "number":
      return value;
    case "bigint":
    case "boolean":
      return Number(value);
    default:
      return NaN;
  }
}

/** Return the unit of a field by Cairn's and ROS's conventions, "" if it is not known. */
export function unitOf(path) {
  const name = path.split(".").at(-1).replace(/\[\d+\]$/, "");
  for (const [pattern, unit] of UNITS) if (pattern.test(name) || pattern.test(path)) return unit;
  return "";
}

const UNITS = [
  [/(^|\.)twist\.(twist\.)?linear\.|^linear\.|^(requested_)?speed$/, "m/s"],
  [/(^|\.)twist\.(twist\.)?angular\.|^angular\.|^(requested_)?turn$/, "rad/s"],
  [/position\.[xyz]$|translation\.[xyz]$|^ranges$|^range(_min|_max)?$|^distance_left$|^clearance$|^position_sd$|^robot_[xy]$/, "m"],
  [/^bearing$|^angle_(min|max|increment)$|^heading_sd$|theta$/, "rad"],
  [/^(time_left|elapsed|scan_time|time_increment|handler_s|sec)$/, "s"],
];

/**
 * Return the fields that match the words of a search, those whose name starts with it first.
 *
 * Every word must occur in the label, in any order and case.
 */
export function searchFields(fields, text, label = (field) => field.path) {
  const words = text.toLowerCase().split(/\s+/).filter(Boolean);
  if (!words.length) return fields;
  const scored = [];
  for (const field of fields) {
    const name = label(field).toLowerCase();
    if (words.every((word) => name.includes(word))) {
      const last = name.split(/[./]/).at(-1);
      scored.push([words.some((word) => last.startsWith(word)) ? 0 : 1, field]);
    }
  }
  return scored.sort((a, b) => a[0] - b[0]).map(([, field]) => field);
}
