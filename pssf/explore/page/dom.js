// Helper functions that create and find HTML elements.

export const find = (selector) => document.querySelector(selector);

export function make(parent, name, attributes = {}, text = "") {
  const svg = parent instanceof SVGElement;
  const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "boolean") node.toggleAttribute(key, value);
    else node.setAttribute(key, value);
  }
  if (text !== "") node.textContent = text;
  return parent.appendChild(node);
}

const SPOKEN = { jsw: "JSW", ap: "AP", pa: "PA", kv: "kV", mas: "mAs", lyon: "Lyon", schuss: "Schuss", rosenberg: "Rosenberg",
  gos: "GOS", csi: "CsI", mtf: "MTF", monte: "Monte", carlo: "Carlo" };

/** Convert an identifier to words, with standard spelling of abbreviations and names. */
export const words = (name) => name.split("_").map((word) => (Object.hasOwn(SPOKEN, word) ? SPOKEN[word] : word)).join(" ");

/** Fill a select element with options from pairs of value and text. */
export function options(select, pairs) {
  select.textContent = "";
  for (const [value, text] of pairs) make(select, "option", { value }, text);
}

/** Append a two-column table to an element. */
export function table(parent, caption, rows) {
  const made = make(parent, "table");
  make(made, "caption", {}, caption);
  for (const [name, value] of rows) {
    const row = make(made, "tr");
    make(row, "th", { scope: "row" }, name);
    make(row, "td", {}, value);
  }
}
