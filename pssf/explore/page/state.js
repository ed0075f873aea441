// The state: fields of a knee and of a protocol, seed, look; undo and redo; and the link that holds it.

const DEPTH = 200;

/** What differs from a state of the same shape, by name. */
function differing(values, from) {
  return Object.fromEntries(Object.entries(values).filter(([name, value]) =>
    JSON.stringify(value) !== JSON.stringify(from[name])));
}

/** Names of the fields in which two pictures' states differ. */
export function differingFields(one, other) {
  const parts = ["knee", "protocol"].flatMap((part) => Object.keys(differing(one[part], other[part])));
  return [...parts, ...["seed", "look"].filter((name) => one[name] !== other[name])];
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
      seed: 0, look: "linear" };
  }

  /** A change; `whole` says that the hand is off the slider, and what was before can be had back. */
  change(changes, whole) {
    const next = { ...this.now, ...changes };
    if (whole) {
      const was = this.held ?? this.now;
      this.held = null;
      if (JSON.stringify(was) !== JSON.stringify(next)) {
        this.before = [...this.before, was].slice(-DEPTH);
        this.after = [];
      }
    } else this.held ??= this.now;
    this.now = next;
    this.listeners.forEach((listener) => listener(whole));
  }

  part(kind, name, value, whole) {
    this.change({ [kind]: { ...this.now[kind], [name]: value } }, whole);
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

  /** As a fragment of an address: what differs from the start, and from the protocol that is named. */
  link() {
    const { knee, protocol, from, seed, look } = this.now, first = this.start();
    const content = { from, knee: differing(knee, first.knee), protocol: differing(protocol, this.listing.protocols[from]),
      seed, look };
    return `#${encodeURIComponent(JSON.stringify(content))}`;
  }

  /** The state of a fragment; null where it is none. Values are the server's to check. */
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
      look: ["linear", "processed", "film"].includes(content.look) ? content.look : "linear" };
  }
}
