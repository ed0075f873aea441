// Page state: knee, protocol, noise seed and display processing, with undo, redo and a link that contains the state.

import { words } from "./dom.js";

const DEPTH = 200;

/** Return the entries of `values` that differ from those in `from`. */
function differing(values, from) {
  return Object.fromEntries(Object.entries(values).filter(([name, value]) =>
    JSON.stringify(value) !== JSON.stringify(from[name])));
}

/** Return the labels of the fields in which two states differ. */
export function differingLabels(one, other, listing) {
  const parts = ["knee", "protocol"].flatMap((part) => Object.keys(differing(one[part], other[part])).map((name) =>
    listing[part].flatMap((group) => group.fields).find((field) => field.name === name)?.label ?? words(name)));
  const others = { seed: "noise seed", processing: "display processing" };
  return [...parts, ...Object.keys(others).filter((name) => one[name] !== other[name]).map((name) => others[name])];
}

export class Store {
  constructor(listing) {
    this.listing = listing;
    this.before = [];
    this.after = [];
    this.listeners = [];
    this.now = this.start();
  }

  start() {
    const { default: first, protocols } = this.listing;
    return { knee: structuredClone(first.knee), protocol: structuredClone(protocols[first.protocol]), from: first.protocol,
      seed: 0, processing: first.processing };
  }

  /** Apply a change. `final` is false while a slider is dragged. A final change is added to the undo history. */
  change(changes, final) {
    const next = { ...this.now, ...changes };
    if (final) {
      const previous = this.beforeDrag ?? this.now;
      this.beforeDrag = null;
      if (JSON.stringify(previous) !== JSON.stringify(next)) {
        this.before = [...this.before, previous].slice(-DEPTH);
        this.after = [];
      }
    } else this.beforeDrag ??= this.now;
    this.now = next;
    this.listeners.forEach((listener) => listener(final));
  }

  setField(kind, name, value, final) {
    this.change({ [kind]: { ...this.now[kind], [name]: value } }, final);
  }

  undo() { this.step("before", "after"); }
  redo() { this.step("after", "before"); }

  step(from, to) {
    if (!this[from].length) return;
    this[to] = [...this[to], this.now];
    this.now = this[from].at(-1);
    this[from] = this[from].slice(0, -1);
    this.listeners.forEach((listener) => listener(true));
  }

  /** Return the state as a URL fragment, with the values that differ from the default knee and the named protocol. */
  link() {
    const { knee, protocol, from, seed, processing } = this.now, first = this.start();
    const content = { from, knee: differing(knee, first.knee), protocol: differing(protocol, this.listing.protocols[from]),
      seed, processing };
    return `#${encodeURIComponent(JSON.stringify(content))}`;
  }

  /** Read a state from a URL fragment; return null if the fragment is invalid. The server validates the values. */
  read(fragment) {
    let content;
    try { content = JSON.parse(decodeURIComponent(fragment.replace(/^#/, ""))); } catch { return null; }
    const first = this.start(), isTable = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
    if (!isTable(content) || !Object.hasOwn(this.listing.protocols, content.from ?? "")) return null;
    if (!isTable(content.knee) || !isTable(content.protocol)) return null;
    const known = (values, from) => Object.fromEntries(Object.entries(values).filter(([name]) => Object.hasOwn(from, name)));
    const protocol = this.listing.protocols[content.from];
    return { from: content.from, knee: { ...first.knee, ...known(content.knee, first.knee) },
      protocol: { ...protocol, ...known(content.protocol, protocol) },
      seed: Number.isSafeInteger(content.seed) && content.seed >= 0 ? content.seed : 0,
      processing: Object.hasOwn(this.listing.processing, content.processing ?? "") ? content.processing : first.processing };
  }
}
