// Small helpers to make and find elements.

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

export const words = (name) => name.replace(/_(mm|deg|mas|kv|kev|mm_al|years|px)$/, "").replaceAll("_", " ");

/** Options of a select; values and words as pairs. */
export function options(select, pairs) {
  select.textContent = "";
  for (const [value, text] of pairs) make(select, "option", { value }, text);
}

/** A table of two columns. */
export function table(parent, caption, rows) {
  const made = make(parent, "table");
  make(made, "caption", {}, caption);
  for (const [name, value] of rows) {
    const row = make(made, "tr");
    make(row, "th", { scope: "row" }, name);
    make(row, "td", {}, value);
  }
}
