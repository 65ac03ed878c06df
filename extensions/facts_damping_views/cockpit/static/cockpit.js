// The page: one state, the socket or the recordings that fill it, and what draws it.

import { drawChart, drawMonitors, makeChart, makeMonitors, settings, until } from "./charts.js";
import { drawStates, makeControls, takeValues } from "./controls.js";
import { drawDiagram, makeDiagram } from "./diagram.js";
import { clock, html, set, shown } from "./dom.js";

const LONGEST = 500; // lines of the event log
const GAP = 1; // s without values, over which charts draw no line
const [FULL, OLDER] = [900, 1800]; // most rows: the newest, which all stay, and older ones, of which half stay when there are so many
const WAITS = [0.5, 1, 2, 4, 8]; // s, before the socket is opened again
const find = (id) => document.getElementById(id);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const dark = matchMedia("(prefers-color-scheme: dark)");

const [DIAGRAM, CHARTS] = [80, 180]; // ms: least time between two drawings, as painting is dear without a GPU
const state = {
  layout: null, text: "", panels: [], time: NaN, lag: NaN, playing: false, speed: 1, drawn: 0, charted: 0, asked: 0, answers: new Map(),
  status: { run: "", reason: "", nodes: {}, states: {}, modes: [], counts: {}, cut: [], out: [], released: [], wrong: [] }, socket: null, tries: 0, spent: { frames: 0, ms: 0 },
};
globalThis.cockpit = state; // to look into from the console, and for tests

// Looks.

const look = {};
function readLook() {
  const style = getComputedStyle(document.documentElement);
  const variable = (name) => style.getPropertyValue(name).trim();
  Object.assign(look, { faint: variable("--faint"), grid: variable("--line"), bad: variable("--bad"), warn: variable("--warn") });
  look.colours = [...Array(8).keys()].map((k) => variable(`--c${k}`));
  const [low, middle, high] = ["--low", "--middle", "--high"].map(variable);
  look.palette = [...Array(41).keys()].map((k) => `color-mix(in oklab, ${k < 20 ? low : high} ${Math.abs(k - 20) * 5}%, ${middle})`);
}

// Layout.

function build(layout) {
  const text = JSON.stringify(layout);
  if (layout.mode === "live") {
    for (const panel of state.panels) panel.events.length = 0, panel.log.replaceChildren(), forget(panel); // all comes again
  }
  if (text === state.text) return; // the same as before the connection was lost
  Object.assign(state, { layout, text, time: layout.mode === "replay" ? 0 : NaN });
  document.title = `${layout.title} – cockpit`;
  find("title").textContent = layout.title;
  document.body.dataset.mode = layout.mode;
  document.body.dataset.panels = layout.panels.length;
  state.panels = layout.panels.map((panel, i) => buildPanel(panel, layout.mode, !i));
  const charts = state.panels.flatMap((panel) => panel.charts);
  for (const chart of charts) chart.twins = charts.filter((one) => one !== chart && one.chart.title === chart.chart.title);
  find("panels").replaceChildren(...state.panels.map((panel) => panel.node));
  state.rows = makeControls(layout.controls, find("groups"), find("toolbar"), send, innerWidth > 700);
  find("controls").hidden = !layout.controls.some((one) => one.group !== "run");
  if (layout.mode === "replay") openReplay(layout);
}

function buildPanel(panel, mode, first) {
  const node = find("panel").content.cloneNode(true).firstElementChild;
  const part = (name) => node.querySelector(`[data-part=${name}]`);
  const view = { ...panel, events: [], rows: [], older: 0, apart: 0, bases: new Map(), node, log: part("log"), modes: part("modes"), scale: part("scale") };
  part("name").append(panel.name, html("a", { href: `report/${encodeURIComponent(panel.name)}`, target: "_blank" }, "report"));
  part("name").hidden = mode === "live";
  node.setAttribute("aria-label", panel.name);
  view.drawing = makeDiagram(view, part("diagram"), part("readout"));
  view.charts = panel.charts.map((chart) => makeChart(chart, view, part("charts"), look, redraw));
  part("tools").hidden = !first;
  part("window").value = String(settings.seconds);
  part("window").addEventListener("change", (event) => (settings.seconds = Number(event.target.value), redraw()));
  part("deviations").checked = settings.deviations;
  part("deviations").addEventListener("change", (event) => (settings.deviations = event.target.checked, redraw()));
  view.monitorBars = makeMonitors(view, part("monitors"));
  return view;
}

// Values.

/** Take the newest row of values, or all rows so far one after the other. */
function take(buffer) {
  const all = new Float32Array(buffer);
  const [panel] = state.panels;
  const width = panel ? panel.curves.length + 2 : NaN;
  if (all.length % width !== 0) return;
  for (let i = 0; i < all.length; i += width) put(panel, all.slice(i, i + width), all.length === width);
  redraw();
}

function put(panel, row, newest) {
  const { rows } = panel;
  const last = rows.at(-1);
  if (last && row[0] < last[0]) forget(panel); // another run
  else if (last && newest && row[0] > last[0] + GAP) rows.push(new Float32Array(row.length).fill(NaN).fill(last[0], 0, 1)); // a gap
  rows.push(row);
  if (rows.length - panel.older > FULL) keep(panel);
  [state.time, state.lag] = row;
}

/** Keep the oldest of the newest rows, unless it is too near to the row before; half of the older ones if they are many. */
function keep(panel) {
  const { rows, older: k } = panel;
  if (k && rows[k][0] - rows[k - 1][0] < panel.apart) rows.splice(k, 1);
  else panel.older += 1;
  if (panel.older < OLDER) return;
  panel.apart = (2 * (rows[OLDER - 1][0] - rows[0][0])) / OLDER;
  const kept = [];
  for (const row of rows.slice(0, OLDER)) if (!kept.length || row[0] - kept.at(-1)[0] >= panel.apart) kept.push(row);
  rows.splice(0, OLDER, ...kept);
  panel.older = kept.length;
}

function forget(panel) {
  panel.rows.length = panel.older = panel.apart = 0;
  panel.bases.clear();
}

function note(panel, event) {
  const time = html(state.layout?.mode === "replay" ? "button" : "span", { class: "time" }, clock(event.t));
  time.addEventListener("click", () => state.layout.mode === "replay" && go(event.t));
  const { log } = panel;
  const atEnd = log.scrollTop + log.clientHeight > log.scrollHeight - 30;
  if (event.replaces) log.lastChild?.remove(), panel.events.pop(); // while a slider is drawn
  panel.events.push(event);
  const level = event.level === "info" ? "" : html("strong", {}, `${event.level}: `);
  log.append(html("li", { class: event.level }, time, html("span", {}, level, event.text)));
  if (log.children.length > LONGEST) log.firstChild.remove(), panel.events.shift();
  if (atEnd) log.scrollTop = log.scrollHeight;
}

// Drawing: ten times a second at most, charts five times, nothing while the page is hidden.

let waiting = 0;
function redraw() {
  waiting ||= requestAnimationFrame((now) => {
    waiting = 0;
    if (!document.hidden && state.layout) draw(now);
  });
}

/** Names of what is out of service and released at the time shown, as the plant's own events have it. */
const shownState = (panel) =>
  (state.layout.mode === "replay" ? panel.events.findLast(({ t }) => t <= state.time) ?? { out: [], released: [] } : state.status);

function draw(now) {
  const start = performance.now();
  const still = state.layout.mode === "replay" && !state.playing;
  if (!still && now - state.drawn < DIAGRAM) return;
  state.drawn = now;
  const slow = still || now - state.charted >= (calm.matches ? 500 : CHARTS);
  const peak = Math.max(...state.panels.map((panel) => panel.drawing.peak)); // the same colours side by side
  for (const panel of state.panels) {
    panel.drawing.peak = peak;
    const row = panel.rows[Math.max(0, until(panel.rows, state.time) - 1)];
    if (!row) continue;
    drawDiagram(panel.drawing, row, shownState(panel), state.status, look.palette, (range, nominal) => {
      const size = `${shown(range * 1000)} mHz`.replace(".000", "");
      panel.scale.replaceChildren(html("span", {}, `−${size}`), html("i"), html("span", {}, `+${size}`));
      panel.scale.title = `Deviation of the frequency from ${nominal} Hz`;
    });
    if (!slow) continue;
    for (const chart of panel.charts) drawChart(chart, panel.rows, state.time, now, still);
    drawMonitors(panel.monitorBars, row);
  }
  if (slow) {
    state.charted = now;
    set(find("time"), { text: clock(state.time) });
    set(find("lag"), { text: Number.isFinite(state.lag) && state.layout.mode === "live" ? `lag ${(1000 * state.lag).toFixed(0)} ms` : "" });
  }
  state.spent.frames += 1;
  state.spent.ms += performance.now() - start;
}

function drawStatus() {
  const { run, reason, counts, modes, wrong } = state.status;
  const flaws = run && run !== "ended" ? wrong : [];
  set(find("run"), { text: [run, ...flaws].join(", "), class: `pill ${flaws.length ? "unwell" : run}` });
  set(find("over"), { text: run === "ended" ? `The run has ended: ${reason}.` : "" });
  enable();
  const lost = Object.entries(counts).filter(([name, n]) => n && name !== "clients");
  set(find("counts"), { text: lost.map(([name, n]) => `${name.replaceAll("_", " ")}: ${n}`).join(" · ") });
  if (state.rows) drawStates(state.rows, state.status);
  const text = modes.map((m) => `${m.label}: ${shown(m.frequency_hz)} Hz, damping ratio ${shown(100 * m.damping_ratio)} %`).join("; ");
  for (const panel of state.panels) set(panel.modes, { text });
  redraw();
}

// Socket.

/** What can be used: nothing without a connection; once the run has ended, its report, and where a program does it, another run. */
function enable() {
  const open = state.socket?.readyState === WebSocket.OPEN;
  const over = ["ended", "starting"].includes(state.status.run);
  find("groups").disabled = !open || over;
  find("toolbar").disabled = !open;
  for (const node of find("toolbar").querySelectorAll("[data-control]")) {
    const id = node.dataset.control;
    const usable = id === "run/report" || (id === "run/again" ? state.status.run === "ended" : !over);
    for (const part of [node, ...node.querySelectorAll("button, input")]) part.disabled = !usable;
  }
}

const say = (text, kind) => set(find("connection"), { text, class: `pill ${kind}` });

function connect() {
  const socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws").split(/[?#]/)[0]));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    state.tries = 0;
    say("connected", "good");
    enable();
  };
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : take(data));
  socket.onclose = () => {
    const wait = WAITS[Math.min(state.tries++, WAITS.length - 1)];
    const over = state.status.run === "ended";
    state.status.run = over ? "ended" : "";
    drawStatus();
    say(over ? "no longer served" : `connection lost, again in ${wait} s`, over ? "" : "bad");
    setTimeout(connect, 1000 * wait);
  };
  state.socket = socket;
}

function hear(message) {
  if (message.type === "layout") build(message);
  else if (message.type === "event") {
    const { out, released } = message;
    Object.assign(state.status, out && { out, released });
    note(state.panels[message.panel ?? 0], message);
  }
  else if (message.type === "answer") answer(message);
  else if (message.type === "status") {
    Object.assign(state.status, message);
    takeValues(message.values ?? {});
    forgetAnswers(message);
    drawStatus();
  }
}

/** Remove answers when the state of the run, on which they rest, is another. */
function forgetAnswers({ run, nodes, states, out, released }) {
  const now = JSON.stringify([run, nodes, states, out, released]);
  if (state.rested !== undefined && now !== state.rested) {
    for (const output of document.querySelectorAll("output.answer")) set(output, { text: "", class: "answer" });
  }
  state.rested = now;
}

function send(control, value, output) {
  if (state.socket?.readyState !== WebSocket.OPEN) return;
  const id = ++state.asked;
  state.answers.set(id, output);
  set(output, { text: "…", class: "answer" });
  state.socket.send(JSON.stringify({ id, control, value }));
}

function answer({ id, success, message }) {
  const output = state.answers.get(id);
  if (!output) return;
  state.answers.delete(id);
  const page = success && message.startsWith("/") ? html("a", { href: message, target: "_blank" }, "open the report") : null;
  set(output, { text: page ? "" : message || (success ? "done" : "refused"), class: `answer ${success ? "good" : "bad"}` });
  if (page) output.append(page);
}

// Replay.

async function openReplay(layout) {
  const slider = find("slider");
  find("replay").hidden = false;
  slider.max = layout.duration;
  await Promise.all(state.panels.map(async (panel) => {
    const name = encodeURIComponent(panel.name);
    const [data, events] = await Promise.all([fetch(`data/${name}`).then((r) => r.arrayBuffer()), fetch(`events/${name}`).then((r) => r.json())]);
    const all = new Float32Array(data);
    const width = panel.curves.length + 1; // no lag here
    for (let i = 0; i + width <= all.length; i += width) {
      const row = new Float32Array(width + 1).fill(NaN);
      row[0] = all[i];
      row.set(all.subarray(i + 1, i + width), 2);
      panel.rows.push(row);
    }
    for (const event of events) note(panel, event);
    panel.log.scrollTop = 0;
  }));
  go(0);
}

function go(time) {
  state.time = Math.min(Math.max(0, time), state.layout.duration);
  find("slider").value = state.time;
  set(find("slider"), { "aria-valuetext": `${state.time.toFixed(1)} s` });
  redraw();
}

function play(playing) {
  state.playing = playing && state.time < state.layout.duration;
  find("play").textContent = state.playing ? "Pause" : "Play";
  let last = performance.now();
  const forward = (now) => {
    if (!state.playing) return;
    go(state.time + (state.speed * (now - last)) / 1000);
    last = now;
    if (state.time >= state.layout.duration) play(false);
    else requestAnimationFrame(forward);
  };
  if (state.playing) requestAnimationFrame(forward);
}

find("play").addEventListener("click", () => {
  if (!state.playing && state.time >= state.layout.duration) go(0);
  play(!state.playing);
});
find("slider").addEventListener("input", (event) => go(Number(event.target.value)));
find("speed").addEventListener("change", (event) => (state.speed = Number(event.target.value)));
document.addEventListener("visibilitychange", redraw);
dark.addEventListener("change", () => (readLook(), redraw()));
readLook();
connect();
