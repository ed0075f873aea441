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

const SPOKEN = { jsw: "JSW", ap: "AP", bmi: "BMI", sdd: "SDD", sod: "SOD", kv: "kV", mas: "current-time product", insall: "Insall",
  salvati: "Salvati", lyon: "Lyon", schuss: "Schuss", rosenberg: "Rosenberg",
  gos: "GOS" };

/** A name as it is read, with abbreviations as radiographers write them. */
export const words = (name) => name.split("_").map((word) => (Object.hasOwn(SPOKEN, word) ? SPOKEN[word] : word)).join(" ");

/** A field's name as it is read: its unit stands beside it. */
export const fieldWords = (name) =>
  (name === "tube_kv" ? "tube voltage" : words(name.replace(/_(mm|deg|kev|mm_al|years|px|per_cm)$/, "")));

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
