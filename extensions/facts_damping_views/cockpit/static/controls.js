// Controls: native inputs by group and by what they act on; each sends its id and value, and shows the answer beside it.

import { html, set } from "./dom.js";

const GROUPS = { run: "Run", preset: "Presets", link: "Links", grid: "Grid", supervisor: "Supervisor", nodes: "Nodes" };
const PAUSE = 120; // ms, between values that a slider sends while it moves

/** What a control acts on, "wan_link" in "link/wan_link/delay"; its label without that name. */
const subject = (control) => control.id.split("/").slice(1, -1).join("/");
const label = ({ label, ...control }) => (label.startsWith(`${subject(control)}: `) ? label.slice(subject(control).length + 2) : label);
/** The word on its button: "arm" in "supervisor/controller/arm". */
const action = (control) => (subject(control) || control.group === "run" ? control.id.split("/").at(-1) : control.label);

/** A name that a line may break after "_" and "/". */
const breakable = (name) => name.split(/(?<=[_/])/).flatMap((part) => [part, html("wbr")]);

/** Build all controls; `send(id, value, output)` sends one. Those of the run go to the toolbar. */
export function makeControls(controls, box, toolbar, send, wide) {
  const rows = {};
  box.replaceChildren();
  toolbar.replaceChildren();
  for (const [group, title] of Object.entries(GROUPS)) {
    const mine = controls.filter((one) => one.group === group);
    if (!mine.length) continue;
    const inside = html("div", { class: `group ${group}` });
    if (group === "run") toolbar.append(inside);
    else box.append(html("details", { open: wide && group !== "nodes" }, html("summary", {}, title), inside));
    for (const name of new Set(mine.map(subject))) {
      const state = html("span", { class: "state" });
      const output = html("output", { class: "answer" });
      const act = (control) => (value) => send(control.id, value, output);
      const shared = new Map(); // fields of sliders, such as their channel
      const parts = mine.filter((one) => subject(one) === name).map((one) => KINDS[one.kind](one, act(one), shared));
      parts.unshift(...[...shared.values()].map((one) => one.node));
      const legend = html("legend", {}, ...breakable(name), " ", state);
      const row = name ? html("fieldset", {}, legend, ...parts, output) : html("div", { class: "bare" }, ...parts, output);
      inside.append(row);
      if (name) (rows[name] ??= []).push(state);
    }
  }
  return rows;
}

/** Show values that controls stand at by what any page has sent, by id, or id and channel. */
export function takeValues(values) {
  for (const [key, value] of Object.entries(values)) {
    const [id, channel] = key.split(" ");
    for (const node of document.querySelectorAll(`[data-control="${CSS.escape(id)}"]`)) node.take?.(value, channel ?? "");
  }
}

/** Show the states of nodes and controllers beside their names. */
export function drawStates(rows, { nodes, states }) {
  for (const [name, places] of Object.entries(rows)) {
    const text = nodes[name] === "dead" ? "dead" : states[name] ?? nodes[name] ?? "";
    for (const place of places) set(place, { text, class: `state ${text.split(" ")[0]}` });
  }
}

/** Text attributes of an input for the values of a control or a field. */
const bounds = (of, type, step) => ({ type, min: String(of.low), max: String(of.high), step, value: String(of.value ?? of.low) });
const number = (of, extra = {}) => html("input", { ...bounds(of, "number", "any"), required: true, ...extra });
const valid = (input) => input.reportValidity() && Number(input.value);

/** A field of a form: a number, or a choice. */
function field(of) {
  const input = of.kind === "choice"
    ? html("select", {}, ...of.choices.map((one) => html("option", { selected: one === of.value }, String(one)))) : number(of);
  const node = html("label", { class: "field" }, html("span", {}, of.name, of.unit && of.unit !== of.name ? html("small", {}, ` ${of.unit}`) : ""), input);
  const read = () => (of.kind === "choice" ? of.choices[input.selectedIndex] : Number(input.value));
  return { node, name: of.name, read };
}
const gathered = (fields) => Object.fromEntries(fields.map((one) => [one.name, one.read()]));

const KINDS = {
  slider(control, send, shared) {
    const range = html("input", bounds(control, "range", String(control.step)));
    const exact = number(control, { "aria-label": `${control.label}, ${control.unit}` });
    for (const of of control.fields ?? []) if (!shared.has(of.name)) shared.set(of.name, field(of));
    const fields = (control.fields ?? []).map((of) => shared.get(of.name));
    const now = () => {
      stands[channel()] = sent = range.value;
      send(fields.length ? { value: Number(range.value), ...gathered(fields) } : Number(range.value));
    };
    const channel = () => fields.map((one) => one.read()).join();
    const stands = { [channel()]: control.value }; // at which value, by channel
    let [timer, sent] = [0, ""];
    const soon = () => {
      exact.value = range.value;
      timer ||= setTimeout(() => {
        timer = 0;
        if (range.value !== sent) now();
      }, PAUSE);
    };
    range.addEventListener("input", soon);
    exact.addEventListener("change", () => {
      if (valid(exact) === false) return;
      range.value = exact.value;
      now();
    });
    for (const one of fields) one.node.addEventListener("change", () => (range.value = exact.value = sent = stands[channel()] ?? control.low));
    const take = (value, of) => {
      stands[of] = String(value);
      if (of === channel() && !node.contains(document.activeElement)) range.value = exact.value = sent = stands[of];
    };
    const node = html("div", { class: "slider", "data-control": control.id }, html("label", {}, html("span", {}, label(control)), range), exact,
      html("small", {}, control.unit), control.hint ? html("small", { class: "hint" }, control.hint) : "");
    return Object.assign(node, { take });
  },
  button(control, send) {
    const node = html("button", { type: "button", title: control.label, "data-control": control.id }, action(control));
    node.addEventListener("click", () => send(null));
    return node;
  },
  toggle(control, send) {
    const box = html("input", { type: "checkbox", role: "switch", checked: Boolean(control.value) });
    box.addEventListener("change", () => send(box.checked));
    const node = html("label", { class: "toggle", "data-control": control.id }, box, label(control));
    return Object.assign(node, { take: (value) => (box.checked = value) });
  },
  form(control, send) {
    const fields = (control.fields ?? []).map(field);
    const node = html("form", { "data-control": control.id }, html("strong", {}, control.label), ...fields.map((one) => one.node),
      html("button", { title: control.label }, control.group === "run" ? action(control) : "Apply"));
    node.addEventListener("submit", (event) => {
      event.preventDefault();
      send(gathered(fields));
    });
    return node;
  },
};
