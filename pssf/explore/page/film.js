// Display of the radiograph: window and level, zoom and pan, cursor, distance. Positions are fractions of its width and
// height.

import { find } from "./dom.js";
import { automatic, differences, greys, histogram, painted, reduced, subtract } from "./pixels.js";

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

export class Film {
  constructor() {
    this.canvas = find("#film");
    this.viewport = find("#viewport");
    this.present = this.pinned = null;
    this.width = this.level = null;
    // Whether the next images get an automatic window, until the first one at full resolution.
    this.anew = false;
    this.zoom = 1;
    this.middle = [0.5, 0.5];
    this.cursor = null;
    this.measured = [];
    this.moved = () => {};
    this.pointed = () => {};
    this.listen();
    new ResizeObserver(() => this.place()).observe(this.viewport);
  }

  /** Image that is displayed: the pinned one if it is selected, else the current one. */
  get shown() {
    const which = find("#compare").value;
    if (which === "a" && this.pinned) return this.pinned;
    return this.present;
  }

  get differs() { return find("#compare").value === "difference" && this.pinned !== null; }

  show(picture) {
    const turned = this.present && this.present.header.processing !== picture.header.processing;
    this.present = picture;
    const first = this.width === null;
    if (turned || first) this.auto(true);
    else if (this.anew) this.auto();
    else this.paint();
    if (picture.header.whole) this.anew = false;
  }

  pin() { this.pinned = this.present; }

  auto(turned = false) {
    const picture = this.shown;
    if (!picture) return;
    // The linear signal is low behind bone. Display processing already makes bone bright.
    if (turned) find("#invert").checked = picture.header.processing === "linear";
    const { width, level } = picture.header.processing === "linear" ? automatic(picture.pixels) : { width: 65535, level: 32768 };
    this.window(width, level);
  }

  window(width, level) {
    this.width = Math.round(clamp(width, 1, 65535));
    this.level = Math.round(clamp(level, 0, 65535));
    [find("#window").value, find("#level").value] = [this.width, this.level];
    this.paint();
  }

  paint() {
    const picture = this.shown;
    if (!picture) return;
    const { rows, cols } = picture.header;
    const table = this.differs ? differences(this.width) : greys(this.width, this.level, find("#invert").checked);
    const pixels = this.differs ? subtract(picture.pixels, reduced(this.pinned, rows, cols)) : picture.pixels;
    if (this.canvas.width !== cols || this.canvas.height !== rows) [this.canvas.width, this.canvas.height] = [cols, rows];
    const context = this.canvas.getContext("2d");
    if (this.image?.width !== cols || this.image?.height !== rows) this.image = context.createImageData(cols, rows);
    context.putImageData(painted(pixels, table, this.image), 0, 0);
    this.place();
    this.drawHistogram(picture.pixels);
  }

  /** Size and upper left corner of the image on the page, in CSS pixels. */
  get box() {
    const { rows, cols } = this.shown.header, { clientWidth: wide, clientHeight: high } = this.viewport;
    const scale = Math.min(wide / cols, high / rows) * this.zoom, size = [scale * cols, scale * rows];
    return { scale, size, left: wide / 2 - this.middle[0] * size[0], top: high / 2 - this.middle[1] * size[1] };
  }

  place() {
    if (!this.shown) return;
    const { scale, left, top } = this.box;
    for (const canvas of this.viewport.querySelectorAll("canvas")) {
      const own = (scale * this.shown.header.cols) / canvas.width;
      canvas.style.transform = `translate(${left}px, ${top}px) scale(${own})`;
      canvas.style.imageRendering = own >= 2 ? "pixelated" : "auto";
    }
    this.moved();
  }

  /** Convert fractions of width and height to a position in the viewport, in CSS pixels. */
  at([x, y]) {
    const { size, left, top } = this.box;
    return [left + x * size[0], top + y * size[1]];
  }

  from(event) {
    const own = this.viewport.getBoundingClientRect(), { size, left, top } = this.box;
    return [(event.clientX - own.left - left) / size[0], (event.clientY - own.top - top) / size[1]];
  }

  /** Row and column of the pixel at a position; null outside the image. */
  pixelAt([x, y]) {
    const { rows, cols } = this.shown.header, row = Math.floor(y * rows), col = Math.floor(x * cols);
    return row >= 0 && row < rows && col >= 0 && col < cols ? [row, col] : null;
  }

  /** Value of the pinned image at a position. */
  pinnedAt([x, y]) {
    const { rows, cols } = this.pinned.header;
    return this.pinned.pixels[Math.floor(y * rows) * cols + Math.floor(x * cols)];
  }

  point(place) {
    this.cursor = place;
    this.pointed();
    this.moved();
  }

  zoomBy(factor, about = this.middle) {
    const zoom = clamp(this.zoom * factor, 0.5, 40), share = 1 - this.zoom / zoom;
    this.middle = this.middle.map((value, k) => value + (about[k] - value) * share);
    this.zoom = zoom;
    this.place();
  }

  fit() {
    [this.zoom, this.middle] = [1, [0.5, 0.5]];
    this.place();
  }

  measure(place) {
    this.measured = this.measured.length === 1 ? [this.measured[0], place] : [place];
    this.point(place);
  }

  /** Measured distance in the joint plane, in mm; null if there is none. */
  get measuredMm() {
    if (this.measured.length < 2 || !this.shown) return null;
    const { rows, cols, joint_mm_per_px: mm } = this.shown.header, [[x1, y1], [x2, y2]] = this.measured;
    return mm * Math.hypot((x2 - x1) * cols, (y2 - y1) * rows);
  }

  drawHistogram(pixels) {
    const canvas = find("#histogram"), context = canvas.getContext("2d"), { width, height } = canvas;
    const counts = histogram(pixels, 256), most = Math.log1p(Math.max(...counts)), style = getComputedStyle(document.body);
    context.clearRect(0, 0, width, height);
    const [low, high] = [this.level - this.width / 2, this.level + this.width / 2].map((value) => (value * width) / 65536);
    context.globalAlpha = 0.25;
    context.fillStyle = style.getPropertyValue("--accent");
    context.fillRect(low, 0, high - low, height);
    context.globalAlpha = 1;
    context.fillStyle = style.color;
    counts.forEach((value, k) => {
      const tall = (height * Math.log1p(value)) / most;
      context.fillRect((k * width) / 256, height - tall, width / 256, tall);
    });
    canvas.setAttribute("aria-label",
      `Histogram of the pixel values from 0 to 65535; window ${this.width}, level ${this.level}`);
  }

  listen() {
    const { viewport } = this;
    let before = null, tool = "";
    viewport.onpointerdown = (event) => {
      if (!this.shown) return;
      viewport.setPointerCapture(event.pointerId);
      before = [event.clientX, event.clientY];
      tool = event.shiftKey || event.button === 1 ? "pan" : find("#tool").value;
      if (tool === "measure") this.measured = [this.from(event)];
    };
    viewport.onpointermove = (event) => {
      if (!this.shown) return;
      if (!before) return this.point(this.from(event));
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      before = [event.clientX, event.clientY];
      const { size } = this.box;
      if (tool === "pan") {
        this.middle = [this.middle[0] - dx / size[0], this.middle[1] - dy / size[1]];
        this.place();
      } else if (tool === "window") {
        const step = Math.max(1, this.width / 300);
        this.window(this.width + dx * step, this.level + dy * step);
      } else {
        this.measured = [this.measured[0], this.from(event)];
        this.moved();
      }
    };
    viewport.onpointerup = viewport.onpointercancel = (event) => {
      if (before && tool === "measure" && this.shown) this.point(this.from(event));
      before = null;
    };
    viewport.onpointerleave = () => { if (!before) this.point(null); };
    viewport.addEventListener("wheel", (event) => {
      if (!this.shown) return;
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), this.from(event));
    }, { passive: false });
    viewport.onkeydown = (event) => this.key(event);
  }

  key(event) {
    if (!this.shown || event.ctrlKey || event.metaKey || event.altKey) return;
    const { rows, cols } = this.shown.header, by = event.shiftKey ? 10 : 1, step = Math.max(1, this.width / 40);
    const [x, y] = this.cursor ?? [0.5, 0.5];
    const move = (dx, dy) => this.point([clamp(x + (by * dx) / cols, 0, 1 - 1e-9), clamp(y + (by * dy) / rows, 0, 1 - 1e-9)]);
    const keys = {
      ArrowLeft: () => move(-1, 0), ArrowRight: () => move(1, 0), ArrowUp: () => move(0, -1), ArrowDown: () => move(0, 1),
      "+": () => this.zoomBy(1.25, [x, y]), "=": () => this.zoomBy(1.25, [x, y]), "-": () => this.zoomBy(0.8, [x, y]),
      0: () => this.fit(), "[": () => this.window(this.width, this.level - step),
      "]": () => this.window(this.width, this.level + step), "{": () => this.window(this.width - step, this.level),
      "}": () => this.window(this.width + step, this.level), m: () => this.measure([x, y]),
    };
    if (!keys[event.key]) return;
    keys[event.key]();
    event.preventDefault();
  }
}
