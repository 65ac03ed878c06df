// One-line diagram: built once, placed when its size changes, and drawn from a row of values.

import { ceiling, set, shown, svg } from "./dom.js";
import { arrange, beside, positions, route } from "./places.js";

const STRIP = 92; // px, for the controllers below it
const FEW = 40; // buses, up to which all are labelled, and each machine of a bus is drawn
const ZOOMS = { "+": 2, "=": 2, "-": 0.5, 0: 0 }; // by key; 0: all in view
const CLOSEST = 8;
const SMALLEST = 0.01; // Hz, of the scale of colours
const FADE = 0.995; // of the largest deviation from one drawing to the next
const layer = (name, ...children) => svg("g", { class: name }, ...children);
const around = ([x, y], reach) => [x - reach, y - reach, x + reach, y + reach];
const move = (x, y) => `translate(${x.toFixed(1)} ${y.toFixed(1)})`;

/** Build the nodes of a diagram; `readout` gets in words what the bus under the pointer or the arrow keys has. */
export function makeDiagram(panel, box, readout) {
  const { buses, branches, machines, devices, links, controllers } = panel.diagram;
  const index = Object.fromEntries(buses.map((bus, i) => [bus.name, i]));
  const root = svg("svg", {
    tabindex: "0", role: "application", "aria-roledescription": "one-line diagram",
    "aria-label": `One-line diagram of ${buses.length} buses. Arrow keys go from bus to bus, + and - zoom.`,
  });
  const view = { panel, index, root, readout, selected: null, peak: SMALLEST, range: 0, nominal: null, box, zoom: 1, corner: [0, 0] };
  const label = (name, text) => svg("text", { class: `label ${name}` }, text ?? "");
  view.branches = branches.map((one) => svg("path", { class: `branch ${one.kind}` }, svg("title", {}, one.name)));
  view.buses = buses.map(() => svg("circle", { class: "bus" }));
  view.pmus = buses.filter((bus) => bus.pmu).map((bus) => [bus, svg("path", { class: "pmu", d: "M0,-5L4.5,3H-4.5Z" })]);
  view.machines = machines.map((one) => ({ // an inverter has no angle, and is a square
    stub: svg("path", { class: "stub" }), arrow: svg("path", { class: "arrow" }),
    ring: svg(one.angle === null ? "path" : "circle", { class: "machine" }),
  }));
  view.devices = devices.map((one) => ({
    joint: svg("path", { class: `branch ${one.from ? one.kind : "stub"}` }),
    symbol: svg("path", { class: one.setpoint === null ? "device idle" : "device", d: one.outline },
      svg("title", {}, `${one.name} (${one.kind})`)),
  }));
  view.links = links.map((one) => svg("path", { class: "link" }, svg("title", {}, one.name)));
  view.controllers = controllers.map((one) => layer("controller", svg("rect", { rx: "6", height: "38" }),
    svg("text", { class: "name", y: "15" }, one.name), svg("text", { class: "state", y: "30" })));
  view.labels = {
    buses: buses.map((one) => label("of-bus", one.name)),
    machines: machines.map((one, i) => label("of-machine", named(machines, i, buses.length))),
    devices: devices.map((one) => label("of-device", one.name)),
    links: links.map(() => label("of-link", "")),
  };
  view.mark = svg("circle", { class: "mark", r: "0" });
  root.append(layer("links", ...view.links), layer("branches", ...view.branches, ...view.devices.map((d) => d.joint)),
    layer("machines", ...view.machines.flatMap((m) => [m.stub, m.ring, m.arrow])), layer("buses", ...view.buses),
    layer("devices", ...view.devices.map((d) => d.symbol)), layer("pmus", ...view.pmus.map(([, node]) => node)),
    layer("controllers", ...view.controllers), layer("labels", ...Object.values(view.labels).flat()), view.mark);
  root.addEventListener("pointermove", (event) => point(view, event));
  root.addEventListener("pointerleave", () => select(view, null));
  root.addEventListener("keydown", (event) => (event.key in ZOOMS ? zoom(view, ZOOMS[event.key]) : step(view, event)));
  if (buses.length > FEW) root.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(view, event.deltaY < 0 ? 1.25 : 0.8, within(view, event));
  }, { passive: false });
  root.addEventListener("dblclick", (event) => zoom(view, 2, within(view, event)));
  box.classList.toggle("large", buses.length > FEW);
  box.append(root);
  new ResizeObserver(() => zoom(view, 1)).observe(box);
  return view;
}

/** What stands at a machine: in a large grid only the first machine or inverter of a bus is drawn, for all; null: hidden. */
function named(machines, i, buses) {
  const alike = machines.filter((one) => one.bus === machines[i].bus && (one.angle === null) === (machines[i].angle === null));
  if (buses <= FEW || alike.length === 1) return machines[i].name;
  return alike[0] === machines[i] ? `${machines[i].name.replace(/_.*/, "")} ×${alike.length}` : null;
}

/** Where the pointer is, of the part in view, px. */
function within(view, event) {
  const box = view.root.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

/** Place all, closer by a factor (0: the whole grid), with what is at a point in view left there. */
function zoom(view, factor, at) {
  const { width, height } = view.box.getBoundingClientRect();
  const chosen = view.selected === null ? null : view.places?.[view.selected].map((one, k) => one - view.corner[k]);
  const point = at ?? chosen ?? [width / 2, height / 2];
  const before = view.zoom;
  view.zoom = factor ? Math.max(1, Math.min(CLOSEST, view.zoom * factor)) : 1;
  const room = [width, height].map((one) => one * (view.zoom - 1));
  view.corner = point.map((one, k) => Math.max(0, Math.min(room[k], (view.corner[k] + one) * (view.zoom / before) - one)));
  place(view, width * view.zoom, height * view.zoom);
  set(view.root, { viewBox: `${view.corner[0]} ${view.corner[1]} ${width} ${height}` });
}

/** Place all nodes in an area of a width and height, px. */
function place(view, width, height) {
  if (width < 50 || height < 50) return;
  const { buses, branches, devices, controllers } = view.panel.diagram;
  const room = height - (controllers.length ? STRIP : 0);
  const size = Math.min(8, Math.max(3, 0.085 * Math.sqrt((width * room) / buses.length)));
  const p = positions(buses, width, room, 4 * size);
  const where = (name) => p[view.index[name]];
  const busy = {}; // directions at a bus in which something lies
  for (const { from, to } of [...branches, ...devices]) {
    if (!from) continue;
    const [[x0, y0], [x1, y1]] = [where(from), where(to)];
    (busy[from] ??= []).push(Math.atan2(y1 - y0, x1 - x0));
    (busy[to] ??= []).push(Math.atan2(y0 - y1, x0 - x1));
  }
  const on = { where, size, width, height, labels: [], taken: p.map((at) => around(at, size)), thick: Math.max(1.2, size / 3.5) };
  on.beside = (bus, length) => beside(where(bus), length, (busy[bus] ??= []), p, width);
  on.route = (one) => route(one, [...branches, ...devices], where, size);
  view.places = p;
  branches.forEach((one, i) => set(view.branches[i], { d: on.route(one), "stroke-width": on.thick }));
  view.buses.forEach((node, i) => set(node, { cx: p[i][0], cy: p[i][1], r: size }));
  for (const [bus, node] of view.pmus) set(node, { transform: move(where(bus.name)[0] - size - 3, where(bus.name)[1] - size - 1) });
  placeMachines(view, on);
  placeLinks(view, on, placeDevices(view, on));
  if (buses.length <= FEW || view.zoom >= 2) buses.forEach((_, i) => on.labels.push({ node: view.labels.buses[i], at: p[i], reach: size + 3 }));
  else for (const node of view.labels.buses) set(node, { visibility: "hidden" });
  arrange(on.labels, on.taken, width, height);
  mark(view);
}

function placeMachines(view, on) {
  const r = Math.max(7.5, 1.7 * on.size);
  view.panel.diagram.machines.forEach((one, i) => {
    if (!view.labels.machines[i].textContent) return;
    const [x, y] = on.beside(one.bus, 2.2 * on.size + r);
    const { stub, ring, arrow } = view.machines[i];
    set(stub, { d: `M${on.where(one.bus)}L${x},${y}` });
    if (one.angle === null) set(ring, { d: `M${x - r},${y - r}h${2 * r}v${2 * r}h${-2 * r}zl${2 * r},${2 * r}` });
    else set(ring, { cx: x, cy: y, r });
    if (one.angle !== null) set(arrow, { d: `M${-0.7 * r},0H${0.75 * r}M${0.2 * r},${-0.45 * r}L${0.78 * r},0L${0.2 * r},${0.45 * r}`, "stroke-width": r / 5 });
    view.machines[i].at = [x, y];
    on.taken.push(around([x, y], r));
    on.labels.push({ node: view.labels.machines[i], at: [x, y], reach: r + 2 });
  });
}

/** Place the devices; returns where. */
function placeDevices(view, on) {
  return view.panel.diagram.devices.map((one, i) => {
    const ends = one.from && [on.where(one.from), on.where(one.to)];
    const [x, y] = ends ? [(ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2] : on.beside(one.bus, 3 * on.size + 8);
    set(view.devices[i].joint, { d: ends ? on.route(one) : `M${on.where(one.bus)}L${x},${y}`, "stroke-width": on.thick });
    set(view.devices[i].symbol, { transform: `${move(x, y)} scale(7)` });
    on.taken.push(around([x, y], 9));
    on.labels.unshift({ node: view.labels.devices[i], at: [x, y], reach: 12, wide: one.setpoint === null ? "" : " −0.000 p.u." });
    return [x, y];
  });
}

/** Place the controllers below the grid, and their links from PMUs and to devices. */
function placeLinks(view, on, stands) {
  const { devices, links, controllers } = view.panel.diagram;
  const wide = Math.min(Math.max(120, ...controllers.map((one) => 7.2 * one.name.length + 16)), on.width / controllers.length - 8);
  const top = on.height - 44;
  const middle = (name) => ((controllers.findIndex((one) => one.name === name) + 0.5) * on.width) / controllers.length;
  controllers.forEach((one, i) => {
    set(view.controllers[i], { transform: move(middle(one.name), top) });
    set(view.controllers[i].firstChild, { x: -wide / 2, width: wide });
    const text = view.controllers[i].children[1];
    text.dataset.wide ??= text.getComputedTextLength();
    set(text, { textLength: Math.min(text.dataset.wide, wide - 10), lengthAdjust: "spacingAndGlyphs" });
  });
  links.forEach((one, i) => {
    const mine = links.filter((other) => other.controller === one.controller);
    const x = middle(one.controller) + wide * (0.35 * ((mine.indexOf(one) + 0.5) / mine.length) - 0.4);
    const out = middle(one.controller) + wide * 0.3;
    const curve = ([u, v], end) => `M${u},${v}C${u},${v + 0.75 * (top - v)} ${end},${v + 0.55 * (top - v)} ${end},${top}`;
    const known = one.buses.filter((name) => name in view.index);
    const targets = one.devices.map((name) => stands[devices.findIndex((d) => d.name === name)]).filter(Boolean);
    set(view.links[i], { d: [...known.map((name) => curve(on.where(name), x)), ...targets.map((to) => curve(to, out))].join("") });
    on.labels.push({ node: view.labels.links[i], at: [x - 26, top - 10 - 15 * (mine.indexOf(one) % 3)], reach: 2, wide: "1000 ms" });
  });
}

function select(view, i) {
  view.selected = i;
  mark(view);
  if (view.row) read(view);
}

function mark(view) {
  const found = view.selected !== null && view.places?.[view.selected];
  set(view.mark, found ? { cx: found[0], cy: found[1], r: 13 } : { r: 0 });
}

function point(view, event) {
  const [x, y] = within(view, event).map((one, k) => one + view.corner[k]);
  const far = (view.places ?? []).map(([u, v]) => Math.hypot(u - x, v - y));
  const nearest = far.indexOf(Math.min(...far));
  const found = far[nearest] < 24 ? nearest : null;
  if (found !== view.selected) select(view, found);
}

/** Arrow keys: the nearest bus in that direction. */
function step(view, event) {
  const towards = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!towards || !view.places) return;
  event.preventDefault();
  const [x, y] = view.places[view.selected ?? 0];
  const cost = view.places.map(([u, v]) => {
    const [along, across] = [(u - x) * towards[0] + (v - y) * towards[1], (u - x) * towards[1] + (v - y) * towards[0]];
    return along > 1 ? along + 2 * Math.abs(across) : Infinity;
  });
  const best = Math.min(...cost);
  select(view, view.selected === null ? 0 : best < Infinity ? cost.indexOf(best) : view.selected);
}

/** Say what the selected bus and its machines have. */
function read(view) {
  const { diagram: { buses, machines, devices }, curves } = view.panel;
  const bus = buses[view.selected];
  if (!bus) return set(view.readout, { text: "" });
  const value = (i) => (i === null ? "not installed" : shown(view.row[i + 2], curves[i].unit));
  const parts = [`${bus.name}: ${value(bus.frequency)}`,
    ...machines.filter((m) => m.bus === bus.name)
      .map((m) => `${m.name}: ${[m.angle, m.power].filter((i) => i !== null).map(value).join(", ") || "no PMU"}`),
    ...devices.filter((d) => [d.bus, d.from, d.to].includes(bus.name)).map((d) => `${d.name}: ${value(d.setpoint)}`)];
  set(view.readout, { text: parts.join(" · ") });
}

/** Draw a row of values, [t, lag, value of each curve]; names out of service and released; the status has cut and dead. */
export function drawDiagram(view, row, { out, released }, status, palette, legend) {
  const { diagram: { buses, branches, machines, devices, links, controllers }, curves } = view.panel;
  branches.forEach((one, i) => set(view.branches[i], { class: `branch ${one.kind}${out.includes(one.name) ? " out" : ""}` }));
  view.row = row;
  const frequencies = buses.map((bus) => row[bus.frequency + 2]);
  view.nominal ??= (([one]) => (one === undefined ? null : one > 30 ? 10 * Math.round(one / 10) : 0))(frequencies.filter(Number.isFinite));
  const deviations = frequencies.map((one) => one - view.nominal);
  view.peak = Math.max(SMALLEST, view.peak * FADE, ...deviations.map((one) => Math.abs(one) || 0));
  const range = ceiling(view.peak);
  const steps = (palette.length - 1) / 2;
  deviations.forEach((one, i) => {
    const colour = Number.isFinite(one) ? palette[Math.round(steps + (steps * one) / range)] : "var(--card)";
    set(view.buses[i], { fill: colour });
  });
  machines.forEach((one, i) => {
    if (one.angle === null) return;
    const degrees = row[one.angle + 2] * (curves[one.angle].unit.startsWith("rad") ? 180 / Math.PI : 1);
    const { arrow, at } = view.machines[i];
    if (at) set(arrow, { transform: `${move(...at)} rotate(${Number.isFinite(degrees) ? -Math.round(2 * degrees) / 2 : 0})` });
  });
  devices.forEach((one, i) => {
    if (one.setpoint === null) return;
    const free = released.includes(one.name);
    set(view.devices[i].symbol, { class: free ? "device released" : "device" });
    set(view.labels.devices[i], { class: `label of-device${free ? " released" : ""}`,
      text: `${one.name} ${free ? "released" : shown(row[one.setpoint + 2], curves[one.setpoint].unit)}` });
  });
  links.forEach((one, i) => {
    const cut = status.nodes[one.name] === "dead" ? "dead" : status.cut.includes(one.name) ? "cut" : "";
    const latency = row[one.latency + 2];
    const text = cut || (Number.isFinite(latency) ? `${latency.toFixed(0)} ms` : "–");
    set(view.links[i], { class: cut ? "link cut" : "link" });
    set(view.labels.links[i], { class: `label of-link${cut ? " cut" : ""}`, text });
  });
  controllers.forEach((one, i) => {
    const state = status.nodes[one.name] === "dead" ? "dead" : status.states[one.name] ?? "";
    set(view.controllers[i], { class: `controller ${state.split(" ")[0]}` });
    set(view.controllers[i].lastChild, { text: state });
  });
  if (range !== view.range) legend(range, view.nominal);
  view.range = range;
  if (view.selected !== null) read(view);
}
