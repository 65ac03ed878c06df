// Rolling charts and bars of monitors, drawn from the rows of values of a panel.

import uPlot from "./uplot/uPlot.esm.js";
import { html, set, shown } from "./dom.js";

const SHORTEST = 30; // s
export const settings = { seconds: SHORTEST, deviations: false }; // what charts show: the last seconds; values less those at the start
const DEVIATE = ["Hz", "deg", "MW"]; // units of values whose deviations say more than the values
const FLOORS = { Hz: 1e-3, mHz: 0.5, deg: 0.05, MW: 0.5, "p.u.": 1e-3, ms: 1, "%": 1 }; // half of the smallest range of an axis
const FLAT = 2e-4; // of a value: smallest range of its axis
const PERIOD = 90; // ms, by which each eight curves of a chart are drawn less often
const NAMED = 6; // curves that the caption of a chart names
const FONT = "11px system-ui, sans-serif";

/** Number of rows up to and at a time; rows are in order of time, which is their first value. */
export function until(rows, time) {
  let [low, high] = [0, rows.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[middle][0] <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Columns of times and curves from rows between two times; null: not available. `bases`: what each curve is reduced by. */
export function columns(rows, begin, time, curves, bases) {
  const shownRows = rows.slice(until(rows, begin), until(rows, time));
  const column = (k, base) => shownRows.map((row) => (Number.isFinite(row[k]) ? row[k] - base : null));
  return [shownRows.map((row) => row[0]), ...curves.map((curve, i) => column(curve + 2, bases[i]))];
}

/** The first value of a curve. */
function base({ rows, bases }, curve) {
  if (!bases.has(curve)) {
    const row = rows.find((one) => Number.isFinite(one[curve + 2]));
    if (!row) return 0;
    bases.set(curve, row[curve + 2]);
  }
  return bases.get(curve);
}

/** Labels of an axis, with as many digits as its steps need. */
function labels(splits, step) {
  const digits = [0, 1, 2, 3, 4, 5].find((d) => Math.abs(step * 10 ** d - Math.round(step * 10 ** d)) < 1e-6) ?? 6;
  return splits.map((value) => (Math.abs(value) < step / 1e3 ? 0 : value).toFixed(digits));
}

/** Build a chart in a box, with a caption that names its curves; `redraw` is called when it comes into sight. */
export function makeChart(chart, panel, box, look, redraw) {
  const short = (i) => panel.curves[i].label;
  const many = chart.curves.length > NAMED + 2;
  const named = many ? chart.curves.slice(0, NAMED) : chart.curves;
  const rest = chart.curves.slice(named.length);
  const values = named.map(() => html("b", {}, "–"));
  const items = named.map((i, k) => html("span", { class: "key", title: short(i) },
    html("i", { style: `--c: var(--c${k % 8})` }), `${short(i)} `, values[k]));
  if (rest.length) items.unshift(html("span", { class: "key", title: rest.map(short).join(", ") }, `${chart.curves.length} curves, of them`));
  const limit = chart.limit === null ? [] : [html("span", { class: "key limit" }, html("i", { class: "dashed" }), `limit ${chart.limit}`)];
  const unit = html("small", {}, chart.unit);
  const area = html("div", { class: "area", role: "img", "aria-label": chart.title });
  box.append(html("figure", { class: "chart" },
    html("figcaption", {}, html("strong", {}, `${chart.title} `, unit), ...items, ...limit), area));
  const view = { chart, panel, values, unit, begin: 0, time: 0, due: 0, seen: true, twins: [], extent: [Infinity, -Infinity] };
  const axis = { stroke: () => look.faint, font: FONT, grid: { stroke: () => look.grid, width: 1 }, ticks: { show: false } };
  const range = (_, lowest, highest) => {
    view.extent = [lowest ?? Infinity, highest ?? -Infinity];
    const all = [view, ...view.twins].map((one) => one.extent); // side by side: the same scale
    const [low, high] = [Math.min(...all.map(([l]) => l)), Math.max(...all.map(([, h]) => h))];
    if (low > high) return [0, 1];
    const half = Math.max(0.55 * (high - low), FLAT * Math.abs(high + low), FLOORS[chart.unit] ?? 1e-4);
    return [(low + high) / 2 - half, (low + high) / 2 + half];
  };
  view.plot = new uPlot({
    width: 300, height: 100, legend: { show: false }, padding: [6, 8, 0, 0],
    cursor: { y: false, drag: { x: false, y: false }, points: { show: false }, sync: { key: panel.name } },
    scales: { x: { time: false, range: () => [view.begin, Math.max(view.time, view.begin + SHORTEST)] }, y: { range } },
    axes: [{ ...axis, size: 20, gap: 2, space: 60 }, { ...axis, size: 50, gap: 4, space: 18, values: (_, splits, axisIndex, space, step) => labels(splits, step) }],
    series: [{}, ...chart.curves.map((_, k) => ({
      stroke: () => look.colours[k % 8], width: many ? 1 : 1.5, points: { show: false },
    }))],
    hooks: { drawAxes: [(plot) => mark(plot, view, look)] },
  }, [[], ...chart.curves.map(() => [])], area);
  new ResizeObserver(([{ contentRect: { width, height } }]) => {
    if (width > 60 && height > 30) view.plot.setSize({ width: Math.floor(width), height: Math.floor(height) });
  }).observe(area);
  new IntersectionObserver(([entry]) => {
    Object.assign(view, { seen: entry.isIntersecting, due: 0 });
    redraw();
  }, { rootMargin: "100px" }).observe(area);
  return view;
}

/** Draw the limit, and a line at each event that is no mere information. */
function mark(plot, view, look) {
  const { ctx, bbox: { left, top, width, height } } = plot;
  const line = (colour, x0, y0, x1, y1) => {
    ctx.strokeStyle = colour;
    ctx.beginPath();
    ctx.moveTo(x0, y0);
    ctx.lineTo(x1, y1);
    ctx.stroke();
  };
  ctx.save();
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([4 * devicePixelRatio, 4 * devicePixelRatio]);
  for (const event of view.panel.events) {
    if (event.level === "info" || event.t > view.time || event.t < view.begin) continue;
    const x = plot.valToPos(event.t, "x", true);
    line(event.level === "error" ? look.bad : look.warn, x, top, x, top + height);
  }
  const y = view.chart.limit === null ? NaN : plot.valToPos(view.chart.limit, "y", true);
  if (y >= top && y <= top + height) line(look.bad, left, y, left + width, y);
  ctx.restore();
}

/** Draw the values up to a time, if it is due; the caption has the values under the pointer, else the last. */
export function drawChart(view, rows, time, now, always) {
  if (!view.seen || (now < view.due && !always)) return;
  view.due = now + PERIOD * Math.floor(view.chart.curves.length / 8);
  const begin = Number.isFinite(settings.seconds) ? Math.max(0, time - settings.seconds) : rows[0]?.[0] ?? 0;
  const deviates = settings.deviations && DEVIATE.includes(view.chart.unit);
  set(view.unit, { text: deviates ? `${view.chart.unit}, from the start` : view.chart.unit });
  const bases = view.chart.curves.map((curve) => (deviates ? base(view.panel, curve) : 0));
  const data = columns(rows, begin, time, view.chart.curves, bases);
  [view.begin, view.time] = [begin, time];
  view.plot.setData(data);
  const place = view.plot.cursor.idx ?? data[0].length - 1;
  const unit = view.chart.unit === "Hz" ? "Hz" : "";
  view.values.forEach((node, k) => set(node, { text: shown(data[k + 1][place] ?? NaN, unit).replace(" Hz", "") }));
}

/** Build the bars of the supervisor's monitors. */
export function makeMonitors(panel, box) {
  const several = new Set(panel.monitors.map((one) => one.controller)).size > 1;
  const views = panel.monitors.map((one) => {
    const bar = html("span", { class: "bar" });
    const value = html("span", { class: "value" });
    const name = several ? `${one.controller}: ${one.name}` : one.name;
    const role = { role: "meter", "aria-label": name, "aria-valuemin": "0", "aria-valuemax": String(one.limit) };
    const meter = html("span", { class: "meter", ...role }, bar);
    const item = html("li", { title: one.description }, html("span", { class: "name" }, name), value, meter);
    box.append(item);
    return { one, item, bar, value, meter };
  });
  box.parentNode.hidden = !views.length;
  return views;
}

/** Draw the bars: the mark at four fifths is the limit; those over it come first. */
export function drawMonitors(views, row) {
  for (const { one, item, bar, value, meter } of views) {
    const now = row[one.curve + 2];
    const share = Math.max(0, now) / one.limit || 0;
    const length = Math.min(1, 0.8 * share).toFixed(3);
    set(bar, { style: `transform: scaleX(${length})`, class: `bar${share > 1 ? " over" : share > 0.8 ? " near" : ""}` });
    set(item, { class: share > 1 ? "over" : "" });
    set(value, { text: `${shown(now)} / ${shown(one.limit, one.unit)}` });
    set(meter, { "aria-valuenow": String(Number.isFinite(now) ? +now.toPrecision(3) : 0) });
  }
}
