// Where the parts of a diagram stand, in px.

import { set } from "./dom.js";

const MARGIN = 44; // around the grid
const STRETCH = 2.2; // largest ratio of the two scales

/** Positions in px: turned so that a long grid lies along the longer side, stretched, and pushed apart where too near. */
export function positions(buses, width, height, near) {
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
  for (let pass = 0; pass < 30; pass++) {
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

/** The path of a branch; those between the same buses run side by side. */
export function route(one, all, where, apart) {
  const [from, to] = [one.from, one.to].sort();
  const beside = all.filter((b) => b.from && [b.from, b.to].sort().join() === `${from},${to}`);
  const [[x0, y0], [x1, y1]] = [where(from), where(to)];
  const shift = ((beside.indexOf(one) - (beside.length - 1) / 2) * apart) / (Math.hypot(x1 - x0, y1 - y0) || 1);
  const via = (share) => [x0 + share * (x1 - x0) - shift * (y1 - y0), y0 + share * (y1 - y0) + shift * (x1 - x0)];
  return `M${x0},${y0}L${via(0.15)}L${via(0.85)}L${x1},${y1}`;
}

/** A place beside a bus: away from its branches, other buses, the edge, and what stands there already. */
export function beside([x, y], length, busy, places, width) {
  const apart = (a) => Math.min(1.6, ...busy.map((b) => Math.abs(Math.atan2(Math.sin(a - b), Math.cos(a - b)))));
  const end = (a) => [x + length * Math.cos(a), y + length * Math.sin(a)];
  const clear = ([s, t]) => Math.min(30, s - 10, t - 10, width - s - 10, ...places.map(([u, v]) => Math.hypot(s - u, t - v)));
  const score = (a) => 20 * apart(a) + clear(end(a));
  const angles = [...Array(16).keys()].map((k) => (k * Math.PI) / 8);
  const best = angles.reduce((a, b) => (score(b) > score(a) ? b : a));
  busy.push(best);
  return end(best);
}

/** Put each label where it covers nothing; hide those for which there is no such place. */
export function arrange(labels, taken, width, height) {
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
