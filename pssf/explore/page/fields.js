// Controls for parameter fields: slider with number box, list, or text box. Each has a unit, range and description.

import { make, words } from "./dom.js";

let count = 0;

const stepOf = ([low, high], whole) => {
  const step = 10 ** Math.floor(Math.log10((high - low) / 50));
  return whole ? Math.max(1, step) : step;
};

function addLabel(parent, field) {
  const id = `f${++count}`, label = make(parent, "label", { for: id });
  // The tooltip shows the Python name of the field.
  label.title = field.name;
  label.append(field.label);
  if (field.unit) label.append(" "), make(label, "span", { class: "unit" }, field.unit);
  return id;
}

function addHint(parent, field, id) {
  const round = (value) => value.toLocaleString("en", { maximumFractionDigits: 6 });
  // JavaScript rounds large integers, so the hint of a text field shows the number of digits instead of the range.
  const range = field.low === null ? ""
    : field.text ? "whole number, up to 19 digits" : `${round(field.low)} to ${round(field.high)}`;
  const text = [field.what, range && `(${range})`].filter(Boolean).join(" ");
  make(parent, "p", { class: "hint", id: `${id}h` }, text).title = field.source ?? "";
}

function makeNumberControl(parent, field, id, report) {
  const step = stepOf(field.slider, field.whole), described = { "aria-describedby": `${id}h` };
  const [low, high] = field.slider;
  const slider = make(parent, "input", { type: "range", min: low, max: high, step,
    "aria-label": `${field.label}, slider`, ...described });
  const box = make(parent, "input", { type: "number", id, min: field.low, max: field.high, step: field.whole ? 1 : "any",
    ...described });
  let open = null;
  if (field.optional) {
    const label = make(parent, "label", { class: "open" });
    open = make(label, "input", { type: "checkbox", "aria-label": `specify ${field.label}` });
    label.append("specify");
    open.onchange = () => report(open.checked ? +slider.value : null, true);
  }
  slider.oninput = () => { box.value = slider.value; report(+slider.value, false); };
  slider.onchange = () => report(+slider.value, true);
  box.onchange = () => {
    if (box.value !== "" && box.validity.valid) report(+box.value, true);
    else box.reportValidity();
  };
  return (value) => {
    const given = value !== null;
    if (open) open.checked = given;
    slider.disabled = box.disabled = !given;
    if (given) slider.value = value;
    box.value = given ? value : "";
  };
}

function makeChoiceControl(parent, field, id, report) {
  const select = make(parent, "select", { id, "aria-describedby": `${id}h` });
  const pairs = field.choices.map((value) => [JSON.stringify(value), words(String(value))]);
  for (const [value, text] of field.optional ? [["null", "none"], ...pairs] : pairs) make(select, "option", { value }, text);
  select.onchange = () => report(JSON.parse(select.value), true);
  return (value) => { select.value = JSON.stringify(value); };
}

function makeTextControl(parent, field, id, report) {
  const pattern = field.named ? "[\\w\\-]{1,64}" : "[0-9]{1,19}";
  const box = make(parent, "input", { type: "text", id, pattern, "aria-describedby": `${id}h`, required: true });
  box.onchange = () => { if (box.validity.valid) report(box.value, true); else box.reportValidity(); };
  return (value) => { box.value = value; };
}

/** Create a control that calls `report(value, final)` after a change. `final` is false while a slider is dragged.
 *  Return a function that sets the displayed value. */
export function control(parent, field, report) {
  const box = make(parent, "div", { class: "field", "data-field": field.name }), id = addLabel(box, field);
  const kind = field.choices ? makeChoiceControl : field.named || field.text ? makeTextControl : makeNumberControl;
  const show = kind(box, field, id, report);
  addHint(box, field, id);
  return show;
}

/** Create groups of controls for the fields of "knee" or "protocol". Return a function that sets all values. */
export function groups(parent, listed, kind, store) {
  const shows = [];
  listed.forEach(({ title, fields }, index) => {
    const box = make(parent, "details", { class: "group", open: index === 0, "data-group": `${kind} ${title}` });
    make(box, "summary", {}, title);
    for (const field of fields) {
      const show = control(box, field, (value, final) => store.setField(kind, field.name, value, final));
      shows.push((values) => show(values[field.name]));
    }
  });
  return (values) => shows.forEach((show) => show(values));
}

/** Create controls for the mode scores of the bone shape model. Return a function that sets the displayed scores. */
export function shapes(parent, modes, store) {
  const box = make(parent, "details", { class: "group", "data-group": "knee Shape" });
  make(box, "summary", {}, "Bone shape scores");
  const shows = modes.map((mode, index) => {
    const field = { name: mode.name, label: mode.name, what: mode.also && `correlates with: ${mode.also}`, unit: "SD",
      low: mode.low, high: mode.high, slider: [mode.low, mode.high], whole: false, choices: null };
    return control(box, field, (value, final) => {
      const scores = modes.map((_, k) => store.now.knee.shape[k] ?? 0);
      scores[index] = value;
      store.setField("knee", "shape", scores, final);
    });
  });
  return (scores) => shows.forEach((show, index) => show(scores[index] ?? 0));
}

/** Create a list of osteophytes or cysts with controls for their fields. Return a function that sets the items. */
export function items(parent, name, fields, most, store) {
  const box = make(parent, "details", { class: "group", "data-group": `knee ${name}` });
  const title = make(box, "summary"), list = make(box, "div");
  const add = make(box, "button", { type: "button" }, `Add to ${name}`);
  const change = (given, final) => store.setField("knee", name, given, final);
  add.onclick = () => {
    const given = store.now.knee[name], start = Object.fromEntries(fields.map((field) => [field.name, field.start]));
    const free = fields[0].choices.find((site) => !given.some((one) => one.site === site));
    change([...given, { ...start, site: free ?? start.site }], true);
  };
  let shown = null, shows = [];
  return (given) => {
    title.textContent = `${name[0].toUpperCase()}${name.slice(1)} (${given.length})`;
    add.disabled = given.length >= most;
    // Controls are recreated only if the number of items has changed; otherwise, a dragged slider would disappear.
    if (shown !== given.length) {
      list.textContent = "";
      shows = given.map((_, index) => {
        const one = make(list, "div", { class: "item", role: "group", "aria-label": `${name} ${index + 1}` });
        const parts = fields.map((field) => control(one, field, (value, final) =>
          change(store.now.knee[name].map((old, k) => (k === index ? { ...old, [field.name]: value } : old)), final)));
        const remove = make(one, "button", { type: "button" }, "Remove");
        remove.onclick = () => change(store.now.knee[name].filter((_, k) => k !== index), true);
        return (values) => parts.forEach((part, k) => part(values[fields[k].name]));
      });
      shown = given.length;
    }
    shows.forEach((show, index) => show(given[index]));
  };
}
