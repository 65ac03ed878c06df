// One-line diagram: built once, placed when its size changes, and drawn from a row of values.

import { round, set, shown, svg } from "./dom.js";

const MARGIN = 44; // px, around the grid
const STRIP = 92; // px, for the controllers below it
const FEW = 40; // buses, up to which all are labelled
const STRETCH = 2.2; // largest ratio of the two scales
const SMALLEST = 0.01; // Hz, of the scale of colours
const FADE = 0.995; // of the largest deviation from one drawing to the next
const SYMBOLS = {
  sssc: "M-1,-1H1V1H-1Z", statcom: "M0,-1.3L1.3,0L0,1.3L-1.3,0Z", svc: "M0,-1.2L1.2,1H-1.2Z",
  hvdc: "M-1,-1L1,1V-1L-1,1Z", other: "M-1.2,0L-.6,-1H.6L1.2,0L.6,1H-.6Z",
};
const layer = (name, ...children) => svg("g", { class: name }, ...children);
const at = (x, y) => `translate(${x.toFixed(1)} ${y.toFixed(1)})`;

/** Build the nodes of a diagram; `readout` gets in words what the bus under the pointer or the arrow keys has. */
export function makeDiagram(panel, box, readout) {
  const { buses, branches, machines, devices, links, controllers } = panel.diagram;
  const index = Object.fromEntries(buses.map((bus, i) => [bus.name, i]));
  const root = svg("svg", {
    tabindex: "0", role: "application", "aria-roledescription": "one-line diagram",
    "aria-label": `One-line diagram of ${buses.length} buses. Arrow keys go from bus to bus.`,
  });
  const view = { panel, index, root, readout, selected: null, peak: SMALLEST, range: 0, nominal: null };
  const label = (name, text) => svg("text", { class: `label ${name}` }, text);
  view.branches = branches.map((one) => svg("path", { class: `branch ${one.kind}` }, svg("title", {}, one.name)));
  view.buses = buses.map(() => svg("circle", { class: "bus" }));
  view.pmus = buses.filter((bus) => bus.pmu).map((bus) => [bus, svg("path", { class: "pmu", d: "M0,-5L4.5,3H-4.5Z" })]);
  view.machines = machines.map(() => ({
    stub: svg("path", { class: "stub" }), ring: svg("circle", { class: "machine" }), arrow: svg("path", { class: "arrow" }),
  }));
  view.devices = devices.map((one) => ({
    joint: svg("path", { class: `branch ${one.from ? one.kind : "stub"}` }),
    symbol: svg("path", { class: one.setpoint === null ? "device idle" : "device", d: SYMBOLS[one.kind] ?? SYMBOLS.other }, svg("title", {}, `${one.name} (${one.kind})`)),
  }));
  view.links = links.map((one) => svg("path", { class: "link" }, svg("title", {}, one.name)));
  view.controllers = controllers.map((one) => layer("controller", svg("rect", { rx: "6", height: "38" }),
    svg("text", { class: "name", y: "15" }, one.name), svg("text", { class: "state", y: "30" })));
  view.labels = {
    buses: buses.map((one) => label("of-bus", one.name)),
    machines: machines.map((one) => label("of-machine", one.name)),
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
  root.addEventListener("keydown", (event) => step(view, event));
  box.classList.toggle("large", buses.length > FEW);
  box.append(root);
  new ResizeObserver(([entry]) => place(view, entry.contentRect.width, entry.contentRect.height)).observe(box);
  return view;
}

/** Positions in px: turned so that a long grid lies along the longer side, stretched, and pushed apart where too near. */
function positions(buses, width, height, near) {
  const mean = (of) => buses.reduce((sum, bus) => sum + of(bus), 0) / buses.length;
  const [mx, my] = [mean((b) => b.x), mean((b) => b.y)];
  const [xx, yy, xy] = [(b) => (b.x - mx) ** 2, (b) => (b.y - my) ** 2, (b) => (b.x - mx) * (b.y - my)].map(mean);
  const long = (xx + yy) / 2 + Math.hypot((xx - yy) / 2, xy) > 6 * ((xx + yy) / 2 - Math.hypot((xx - yy) / 2, xy));
  const turn = long ? -0.5 * Math.atan2(2 * xy, xx - yy) + (height > 1.3 * width ? Math.PI / 2 : 0) : 0;
  const [c, s] = [Math.cos(turn), Math.sin(turn)];
  const places = buses.map((b) => [c * (b.x - mx) - s * (b.y - my), -(s * (b.x - mx) + c * (b.y - my))]);
  const limits = [0, 1].map((k) => [Math.min(...places.map((p) => p[k])), Math.max(...places.map((p) => p[k]))]);
  const space = [width, height];
  const full = limits.map(([low, high], k) => (space[k] - 2 * MARGIN) / (high - low || 1));
  const scale = full.map((one) => Math.max(1e-3, Math.min(one, STRETCH * Math.min(...full))));
  for (const p of places) for (const k of [0, 1]) p[k] = space[k] / 2 + scale[k] * (p[k] - (limits[k][0] + limits[k][1]) / 2);
  for (let round = 0; round < 30; round++) {
    for (let i = 0; i < places.length; i++) {
      for (let j = 0; j < i; j++) {
        const [dx, dy] = [places[i][0] - places[j][0] || 0.1, places[i][1] - places[j][1]];
        const distance = Math.hypot(dx, dy);
        if (distance >= near) continue;
        const push = (near - distance) / distance / 3;
        places[i][0] += push * dx, places[i][1] += push * dy, places[j][0] -= push * dx, places[j][1] -= push * dy;
      }
    }
  }
  return places;
}

/** Place all nodes in an area of a width and height, px. */
function place(view, width, height) {
  if (width < 50 || height < 50) return;
  const { buses, branches, machines, devices, links, controllers } = view.panel.diagram;
  const room = height - (controllers.length ? STRIP : 0);
  const size = Math.min(8, Math.max(3, 0.085 * Math.sqrt((width * room) / buses.length)));
  const big = Math.max(7.5, 1.7 * size);
  const p = positions(buses, width, room, 4 * size);
  const where = (name) => p[view.index[name]];
  const taken = p.map(([x, y]) => [x - size, y - size, x + size, y + size]);
  const labels = [];
  view.places = p;
  set(view.root, { viewBox: `0 0 ${width} ${height}` });
  const line = (one) => {
    const [from, to] = [one.from, one.to].sort();
    const beside = [...branches, ...devices].filter((b) => b.from && [b.from, b.to].sort().join() === `${from},${to}`);
    const [[x0, y0], [x1, y1]] = [where(from), where(to)];
    const shift = ((beside.indexOf(one) - (beside.length - 1) / 2) * size) / (Math.hypot(x1 - x0, y1 - y0) || 1);
    const via = (share) => [x0 + share * (x1 - x0) - shift * (y1 - y0), y0 + share * (y1 - y0) + shift * (x1 - x0)];
    return `M${x0},${y0}L${via(0.15)}L${via(0.85)}L${x1},${y1}`;
  };
  const thick = Math.max(1.2, size / 3.5);
  branches.forEach((one, i) => set(view.branches[i], { d: line(one), "stroke-width": thick }));
  view.buses.forEach((node, i) => set(node, { cx: p[i][0], cy: p[i][1], r: size }));
  for (const [bus, node] of view.pmus) set(node, { transform: at(where(bus.name)[0] - size - 3, where(bus.name)[1] - size - 1) });
  // Away from the neighbours of a bus, where there is most room.
  const used = {};
  const free = (name, length) => {
    const [x, y] = where(name);
    const ends = [...branches, ...devices].flatMap((b) => (b.from === name ? [b.to] : b.to === name ? [b.from] : []));
    const busy = [...ends.map((end) => Math.atan2(where(end)[1] - y, where(end)[0] - x)), ...(used[name] ?? [])];
    const apart = (a) => Math.min(7, ...busy.map((b) => Math.abs(Math.atan2(Math.sin(a - b), Math.cos(a - b)))));
    const clear = (a) => {
      const [s, t] = [x + length * Math.cos(a), y + length * Math.sin(a)];
      return Math.min(30, s - 10, t - 10, width - s - 10, ...p.map(([u, v]) => Math.hypot(s - u, t - v)));
    };
    const score = (a) => Math.min(apart(a), 1.6) * 20 + clear(a);
    const best = [...Array(16).keys()].map((k) => (k * Math.PI) / 8).reduce((a, b) => (score(b) > score(a) ? b : a));
    (used[name] ??= []).push(best);
    return [x + length * Math.cos(best), y + length * Math.sin(best)];
  };
  const cover = ([x, y], reach) => taken.push([x - reach, y - reach, x + reach, y + reach]);
  machines.forEach((one, i) => {
    const [x, y] = free(one.bus, 2.2 * size + big);
    const { stub, ring, arrow } = view.machines[i];
    set(stub, { d: `M${where(one.bus)}L${x},${y}` });
    set(ring, { cx: x, cy: y, r: big });
    set(arrow, { d: `M${-0.7 * big},0H${0.75 * big}M${0.2 * big},${-0.45 * big}L${0.78 * big},0L${0.2 * big},${0.45 * big}`, "stroke-width": big / 5 });
    view.machines[i].at = [x, y];
    cover([x, y], big);
    labels.push({ node: view.labels.machines[i], at: [x, y], reach: big + 2 });
  });
  const stands = devices.map((one, i) => {
    const ends = one.from && [where(one.from), where(one.to)];
    const [x, y] = ends ? [(ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2] : free(one.bus, 3 * size + 8);
    set(view.devices[i].joint, { d: ends ? line(one) : `M${where(one.bus)}L${x},${y}`, "stroke-width": thick });
    set(view.devices[i].symbol, { transform: `${at(x, y)} scale(7)` });
    cover([x, y], 9);
    labels.unshift({ node: view.labels.devices[i], at: [x, y], reach: 12, wide: one.setpoint === null ? "" : " −0.000 p.u." });
    return [x, y];
  });
  const wide = Math.min(150, width / controllers.length - 8);
  const top = height - 44;
  const boxes = Object.fromEntries(controllers.map((one, i) => [one.name, ((i + 0.5) * width) / controllers.length]));
  controllers.forEach((one, i) => {
    set(view.controllers[i], { transform: at(boxes[one.name], top) });
    set(view.controllers[i].firstChild, { x: -wide / 2, width: wide });
  });
  links.forEach((one, i) => {
    const mine = links.filter((other) => other.controller === one.controller);
    const x = boxes[one.controller] + wide * (0.35 * ((mine.indexOf(one) + 0.5) / mine.length) - 0.4);
    const out = boxes[one.controller] + wide * 0.3;
    const curve = ([u, v], end) => `M${u},${v}C${u},${v + 0.75 * (top - v)} ${end},${v + 0.55 * (top - v)} ${end},${top}`;
    const known = one.pmus.filter((name) => name in view.index);
    const targets = one.devices.map((name) => stands[devices.findIndex((d) => d.name === name)]).filter(Boolean);
    set(view.links[i], { d: [...known.map((name) => curve(where(name), x)), ...targets.map((to) => curve(to, out))].join("") });
    labels.push({ node: view.labels.links[i], at: [x - 26, top - 10 - 15 * (mine.indexOf(one) % 3)], reach: 2, wide: "1000 ms" });
  });
  if (buses.length <= FEW) buses.forEach((_, i) => labels.push({ node: view.labels.buses[i], at: p[i], reach: size + 3 }));
  else for (const node of view.labels.buses) set(node, { visibility: "hidden" });
  arrange(labels, taken, width, height);
  mark(view);
}

/** Put each label where it covers nothing; hide those for which there is no such place. */
function arrange(labels, taken, width, height) {
  for (const { node, at: [x, y], reach, wide = "" } of labels) {
    const [w, h] = [(node.dataset.name ??= node.textContent).length * 6.4 + wide.length * 5.8 + 2, 13];
    const d = 0.7 * reach;
    const spots = [0, 16].flatMap((more) => {
      const [far, near] = [reach + more, d + more];
      return [[x - w / 2, y - far - h], [x - w / 2, y + far], [x + far, y - h / 2], [x - far - w, y - h / 2],
        [x + near, y - near - h], [x - near - w, y - near - h], [x + near, y + near], [x - near - w, y + near]];
    }).slice(0, wide ? 16 : 8);
    const free = spots.find(([u, v]) => u >= 0 && v >= 0 && u + w <= width && v + h <= height
      && taken.every(([l, t, r, b]) => u >= r || u + w <= l || v >= b || v + h <= t));
    if (free) taken.push([free[0], free[1], free[0] + w, free[1] + h]);
    set(node, free ? { x: free[0] + 1, y: free[1] + 10.5, visibility: "visible" } : { visibility: "hidden" });
  }
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
  const box = view.root.getBoundingClientRect();
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
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
    ...machines.filter((m) => m.bus === bus.name).map((m) => `${m.name}: ${value(m.angle)}, ${value(m.power)}`),
    ...devices.filter((d) => [d.bus, d.from, d.to].includes(bus.name)).map((d) => `${d.name}: ${value(d.setpoint)}`)];
  set(view.readout, { text: parts.join(" · ") });
}

/** Draw a row of values, [t, lag, value of each curve]; `status` has the states, and what is cut or dead. */
export function drawDiagram(view, row, status, palette, legend) {
  const { diagram: { buses, machines, devices, links, controllers }, curves } = view.panel;
  view.row = row;
  const frequencies = buses.map((bus) => row[bus.frequency + 2]);
  view.nominal ??= (([one]) => (one === undefined ? null : one > 30 ? 10 * Math.round(one / 10) : 0))(frequencies.filter(Number.isFinite));
  const deviations = frequencies.map((one) => one - view.nominal);
  view.peak = Math.max(SMALLEST, view.peak * FADE, ...deviations.map((one) => Math.abs(one) || 0));
  const range = round(view.peak);
  const steps = (palette.length - 1) / 2;
  deviations.forEach((one, i) => {
    const colour = Number.isFinite(one) ? palette[Math.round(steps + (steps * one) / range)] : "var(--card)";
    set(view.buses[i], { fill: colour });
  });
  machines.forEach((one, i) => {
    const degrees = row[one.angle + 2] * (curves[one.angle].unit.startsWith("rad") ? 180 / Math.PI : 1);
    const { arrow, at: place } = view.machines[i];
    if (place) set(arrow, { transform: `${at(...place)} rotate(${Number.isFinite(degrees) ? -degrees.toFixed(1) : 0})` });
  });
  devices.forEach((one, i) => {
    if (one.setpoint !== null) set(view.labels.devices[i], { text: `${one.name} ${shown(row[one.setpoint + 2], curves[one.setpoint].unit)}` });
  });
  links.forEach((one, i) => {
    const cut = status.values[`link/${one.name}/cut`] || status.nodes[one.name] === "dead";
    const latency = row[one.latency + 2];
    set(view.links[i], { class: cut ? "link cut" : "link" });
    set(view.labels.links[i], { class: `label of-link${cut ? " cut" : ""}`, text: cut ? "cut" : Number.isFinite(latency) ? `${latency.toFixed(0)} ms` : "–" });
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
