// Nodes of the page: made once, and touched again only where something has changed.

function made(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name in node && typeof value !== "string") node[name] = value;
    else if (value !== undefined) node.setAttribute(name, value);
  }
  node.append(...children);
  return node;
}

export const html = (tag, attributes = {}, ...children) => made(document.createElement(tag), attributes, children);
export const svg = (tag, attributes = {}, ...children) =>
  made(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);

/** Set attributes whose values differ from those set last. */
export function set(node, attributes) {
  const last = (node.cockpit ??= {});
  for (const name in attributes) {
    const value = attributes[name];
    if (last[name] === value) continue;
    last[name] = value;
    if (name === "text") node.textContent = value;
    else node.setAttribute(name, value);
  }
}

/** A value with about three significant digits; a dash where there is none. */
export function shown(value, unit = "") {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const digits = unit === "Hz" ? 3 : size >= 100 || !size ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  const text = value.toFixed(digits).replace(/^-(?=.*[1-9])/, "−").replace("-", "");
  return unit && unit !== "-" ? `${text} ${unit}` : text;
}

/** The next of 1, 2, 5, 10, 20, ... that is not below a value. */
export function ceiling(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return decade * [1, 2, 5, 10].find((step) => step * decade >= value * 0.999999);
}

/** Minutes and seconds. */
export function clock(time) {
  if (!Number.isFinite(time)) return "–:––.–";
  const tenths = Math.floor(time * 10 + 1e-3); // Float32 rounds times down
  return `${Math.floor(tenths / 600)}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
}
