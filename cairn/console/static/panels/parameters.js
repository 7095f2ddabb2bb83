// The parameters of a component, editable with their bounds; the component checks each change.

import { html, useEffect, useMemo, useState } from "../vendor/preact-htm.js";
import { toast, useApp, useRobot } from "../hooks.js";
import { SavedStore, useStore } from "../store.js";
import { Badge, Empty } from "../ui.js";
import { ErrorNote, ReadOnlyNote, SearchField, useComponents, useReadOnly, useRequest } from "./shared.js";

const chosenComponent = new SavedStore("parameters.component", "");
const formerValues = new Map(); // of each component, by name: the value when this page read it first

/**
 * Return how a parameter is edited: {kind, choices, optional, unit, words, minimum, maximum}.
 *
 * `kind` is "boolean", "choice", "integer", "number", "text" or "json"; the unit is the one in brackets of
 * the description, and `words` the description without it.
 */
export function editorOf({ type, bounds, description }) {
  const alternatives = splitAlternatives(type);
  const optional = alternatives.includes("None");
  const types = alternatives.filter((one) => one !== "None");
  const unit = /\[([^\]]{1,16})\]\.?\s*$/.exec(description)?.[1] ?? "";
  const words = unit ? description.replace(/\s*\[[^\]]{1,16}\](\.?)\s*$/, "$1") : description;
  const editor = { kind: "json", choices: [], optional, unit, words, ...limitsOf(bounds) };
  if (types.length === 1) {
    const [only] = types;
    if (only.startsWith("Literal[")) {
      const choices = only.slice(8, -1).split(", ").map((one) => literal(one));
      return { ...editor, kind: "choice", choices };
    }
    const kind = { bool: "boolean", int: "integer", float: "number", str: "text", Path: "text" }[only];
    if (kind) return { ...editor, kind };
  }
  return editor;
}

/** Return the parts of "A | B", not those within brackets. */
function splitAlternatives(type) {
  const parts = [];
  let depth = 0;
  let start = 0;
  for (let at = 0; at < type.length; at += 1) {
    if (type[at] === "[") depth += 1;
    else if (type[at] === "]") depth -= 1;
    else if (depth === 0 && type.startsWith(" | ", at)) {
      parts.push(type.slice(start, at));
      start = at + 3;
    }
  }
  return [...parts, type.slice(start)];
}

function literal(text) {
  if (/^'.*'$/.test(text)) return text.slice(1, -1);
  if (text === "True" || text === "False") return text === "True";
  return Number(text);
}

function limitsOf(bounds) {
  const limit = (sign) => {
    const match = new RegExp(`(?:^|, )${sign}=? (-?[\\d.]+(?:e[+-]?\\d+)?)`).exec(bounds);
    return match ? Number(match[1]) : null;
  };
  return { minimum: limit(">"), maximum: limit("<") };
}

/**
 * Return {value} of what was typed, or {error}: what is wrong with it, in words.
 *
 * Only what cannot be sent is an error here: the component checks bounds and everything else.
 */
export function parseInput(text, editor) {
  const trimmed = text.trim();
  if (editor.optional && trimmed === "") return { value: null };
  if (editor.kind === "text") return { value: text };
  if (editor.kind === "json") {
    try {
      return { value: JSON.parse(trimmed) };
    } catch {
      return { error: `${trimmed || "empty"} is not JSON; write for example [[1, 2], [3, 4]]` };
    }
  }
  const value = Number(trimmed);
  if (trimmed === "" || !Number.isFinite(value)) return { error: `${trimmed || "empty"} is not a number` };
  if (editor.kind === "integer" && !Number.isInteger(value)) return { error: `${trimmed} is not an integer` };
  return { value };
}

/** Return a value as it is typed; `parseInput` of it gives the value. */
export function inputText(value, editor) {
  if (value === null || value === undefined) return "";
  return editor.kind === "json" ? JSON.stringify(value) : String(value);
}

/** Return parameters by group, [group, parameters]: "base.noise" is in group "base"; the first group is "". */
export function grouped(parameters) {
  const groups = new Map([["", []]]);
  for (const one of parameters) {
    const group = one.name.split(".").slice(0, -1).join(".");
    groups.set(group, [...(groups.get(group) ?? []), one]);
  }
  return [...groups].filter(([, members]) => members.length > 0);
}

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

export function Parameters() {
  const { connection } = useApp();
  const robot = useRobot();
  const components = useComponents();
  const readOnly = useReadOnly();
  const chosen = useStore(chosenComponent);
  const [text, setText] = useState("");
  useRequest("parameters", ({ component }) => chosenComponent.set(component));
  const attached = useStore(connection.hello)?.recording?.parameters ?? null;
  if (attached?.length === 0)
    return html`<div class="panel"><${Empty} icon="parameters" title="No parameters in this recording">
      cairn record attaches them, if the deployment that runs is the only one.<//></div>`;
  if (!components && !attached)
    return html`<div class="panel"><${Empty} icon="parameters" title="No components yet">Parameters appear when a deployment runs.<//></div>`;
  const names = attached ?? components.filter((one) => ["active", "inactive"].includes(one.state)).map((one) => one.name);
  const component = names.includes(chosen) ? chosen : (names.find((name) => name === "motion_control") ?? names[0] ?? "");
  const absent = chosen && !names.includes(chosen) && components?.some((one) => one.name === chosen);
  return html`
    <div class="panel">
      <div class="row tools">
        <select aria-label="Component" value=${component} onChange=${(event) => chosenComponent.set(event.target.value)}>
          ${names.map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
        </select>
        <${SearchField} label="Filter parameters" value=${text} onInput=${setText} />
      </div>
      <${ReadOnlyNote} readOnly=${readOnly} />
      ${absent && html`<p class="note">${chosen} ${attached ? "has no attached parameters" : "is not loaded"}; these are the parameters of ${component}.</p>`}
      ${component && html`<${ComponentParameters} key=${`${robot} ${component}`} connection=${connection} robot=${robot} component=${component} text=${text} readOnly=${readOnly} />`}
    </div>`;
}

function ComponentParameters({ connection, robot, component, text, readOnly }) {
  const [parameters, setParameters] = useState(null);
  const [error, setError] = useState("");
  const key = `${robot}/${component}`;
  if (!formerValues.has(key)) formerValues.set(key, new Map());
  const former = formerValues.get(key);
  const read = async () => {
    try {
      const found = await connection.call("parameters", { robot, component });
      for (const one of found) if (!former.has(one.name)) former.set(one.name, one.value);
      setParameters(found);
      setError("");
    } catch (reason) {
      setError(reason.message);
    }
  };
  useEffect(() => {
    read();
    return connection.hello.subscribe((hello) => hello && read());
  }, []);
  const set = async (name, value) => {
    const before = parameters.find((one) => one.name === name).value;
    await connection.call("set_parameters", { robot, component, values: { [name]: value } });
    toast("info", `Changed ${component}.${name} from ${JSON.stringify(before)} to ${JSON.stringify(value)}.`);
    await read();
  };
  const words = text.toLowerCase();
  const groups = useMemo(
    () => grouped((parameters ?? []).filter((one) => `${one.name} ${one.description}`.toLowerCase().includes(words))),
    [parameters, words],
  );
  if (error && !parameters)
    return html`<${ErrorNote}>${error}<//><button class="button" onClick=${read}>Read again</button>`;
  if (!parameters) return html`<p class="muted" role="status">Reading the parameters of ${component} …</p>`;
  if (parameters.length === 0) return html`<${Empty} icon="parameters" title=${`${component} has no parameters`} />`;
  if (groups.length === 0) return html`<${Empty} icon="search" title="No parameter matches">Change the filter.<//>`;
  return html`
    <${ErrorNote}>${error}<//>
    ${groups.map(([group, members]) => html`
      <section key=${group} class="parameter-group" aria-label=${group || component}>
        ${group && html`<h3>${group}</h3>`}
        ${members.map((one) => html`
          <${Parameter} key=${one.name} parameter=${one} former=${former.get(one.name)} readOnly=${readOnly} onSet=${(value) => set(one.name, value)} />`)}
      </section>`)}
    <p class="muted small-print">${connection.hello.value?.recording
      ? "The values with which the recording began; changes during it are not attached."
      : "Changes hold until the component is restarted; the deployment file has the lasting values."}</p>`;
}

function Parameter({ parameter, former, readOnly, onSet }) {
  const editor = useMemo(() => editorOf(parameter), [parameter.type, parameter.bounds, parameter.description]);
  const current = inputText(parameter.value, editor);
  const [typed, setTyped] = useState(null); // null while it is not being changed
  const [error, setError] = useState("");
  const [busy, setBusy] = useState(false);
  const id = `parameter-${parameter.name}`;
  const changed = !same(parameter.value, former);
  const dirty = typed !== null && typed !== current;

  const submit = async (value) => {
    setBusy(true);
    try {
      await onSet(value);
      setError("");
      setTyped(null);
    } catch (reason) {
      setError(reason.message);
    }
    setBusy(false);
  };
  const submitTyped = () => {
    if (!dirty || busy) return;
    const { value, error: wrong } = parseInput(typed, editor);
    if (wrong) setError(`${parameter.name}: ${wrong}`);
    else submit(value);
  };
  const revert = () => {
    setTyped(null);
    setError("");
  };
  const onKey = (event) => {
    if (event.key === "Enter") submitTyped();
    else if (event.key === "Escape" && dirty) revert();
    else return;
    event.preventDefault();
    event.stopPropagation();
  };

  const shared = {
    id, class: "input", disabled: Boolean(readOnly) || busy, "aria-describedby": `${id}-words ${error ? `${id}-error` : ""}`,
    "aria-invalid": error ? "true" : undefined,
  };
  let control;
  if (editor.kind === "boolean" && !editor.optional)
    control = html`<input ...${shared} class="switch" type="checkbox" role="switch" checked=${parameter.value} onChange=${(event) => submit(event.target.checked)} />`;
  else if (editor.kind === "choice" || editor.kind === "boolean") {
    const choices = [...(editor.optional ? [null] : []), ...(editor.kind === "boolean" ? [true, false] : editor.choices)];
    control = html`
      <select ...${shared} value=${String(choices.findIndex((choice) => same(choice, parameter.value)))}
        onChange=${(event) => submit(choices[Number(event.target.value)])}>
        ${choices.map((choice, index) => html`<option key=${index} value=${String(index)}>${choice === null ? "none" : String(choice)}</option>`)}
      </select>`;
  } else
    control = html`
      <input ...${shared} type="text" inputmode=${editor.kind === "integer" || editor.kind === "number" ? "decimal" : "text"} value=${typed ?? current}
        placeholder=${editor.optional ? "none" : ""} autocomplete="off" spellcheck=${false} onInput=${(event) => setTyped(event.target.value)} onKeyDown=${onKey} />`;
  const name = parameter.name.split(".").at(-1);
  return html`
    <div class=${`parameter ${changed ? "changed" : ""}`}>
      <label for=${id} title=${`${parameter.name}: ${parameter.type}`}>${name}</label>
      <div class="parameter-control">${control}${editor.unit && html`<span class="unit">${editor.unit}</span>`}
        ${dirty && html`<button class="button small primary" disabled=${busy} onClick=${submitTyped}>Set</button><button class="button small" onClick=${revert}>Undo</button>`}
        ${changed && !dirty && html`<button class="button small" disabled=${Boolean(readOnly) || busy} title="Set the value that it had before"
          onClick=${() => submit(former)}>Reset to ${inputText(former, editor) || "none"}</button>`}
        ${changed && html`<${Badge} tone="accent">changed<//>`}
      </div>
      <p class="parameter-words muted" id=${`${id}-words`}>${editor.words} ${parameter.bounds && html`<span class="bounds">${parameter.bounds.replaceAll(">=", "≥").replaceAll("<=", "≤")}</span>`}</p>
      <${ErrorNote} id=${`${id}-error`}>${error}<//>
    </div>`;
}
