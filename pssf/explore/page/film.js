// Display of the radiograph: window and level, zoom and pan, cursor, distance. Positions are fractions of image width
// and height.

import { find } from "./dom.js";
import { boneWindow, differenceTable, greyTable, histogram, applyTable, subsample, subtract } from "./pixels.js";

const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

export class Film {
  constructor() {
    this.canvas = find("#film");
    this.viewport = find("#viewport");
    this.present = this.pinned = null;
    this.width = this.level = null;
    // Whether the window of a new image is set automatically; false after the first image at full resolution.
    this.needsAutoWindow = false;
    this.zoom = 1;
    this.middle = [0.5, 0.5];
    this.cursor = null;
    this.measured = [];
    this.onLayout = () => {};
    this.onCursor = () => {};
    this.listen();
    new ResizeObserver(() => this.updateLayout()).observe(this.viewport);
    // After a change of the colour scheme, the histogram is redrawn in the new colours of the page.
    this.darkMode = matchMedia("(prefers-color-scheme: dark)");
    this.darkMode.onchange = () => { if (this.shown) this.drawHistogram(this.shown.pixels); };
  }

  /** Displayed image: the pinned image if selected, otherwise the current image. */
  get shown() {
    const which = find("#compare").value;
    if (which === "a" && this.pinned) return this.pinned;
    return this.present;
  }

  get differs() { return find("#compare").value === "difference" && this.pinned !== null; }

  show(picture) {
    const processingChanged = this.present && this.present.header.processing !== picture.header.processing;
    this.present = picture;
    const first = this.width === null;
    if (processingChanged || first || this.needsAutoWindow) this.auto();
    else this.paint();
    if (picture.header.whole) this.needsAutoWindow = false;
  }

  pin() { this.pinned = this.present; }

  auto() {
    const picture = this.shown;
    if (!picture) return;
    const isLinear = picture.header.processing === "linear";
    const { width, level } = isLinear ? boneWindow(picture.pixels) : { width: 65535, level: 32768 };
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
    // A linear image is inverted to show bright bone. In an image with display processing, bone is already bright.
    const invert = find("#bone-bright").checked === (picture.header.processing === "linear");
    const table = this.differs ? differenceTable(this.width) : greyTable(this.width, this.level, invert);
    const pixels = this.differs ? subtract(picture.pixels, subsample(this.pinned, rows, cols)) : picture.pixels;
    if (this.canvas.width !== cols || this.canvas.height !== rows) [this.canvas.width, this.canvas.height] = [cols, rows];
    const context = this.canvas.getContext("2d");
    if (this.image?.width !== cols || this.image?.height !== rows) this.image = context.createImageData(cols, rows);
    context.putImageData(applyTable(pixels, table, this.image), 0, 0);
    this.updateLayout();
    this.drawHistogram(picture.pixels);
  }

  /** Size and upper left corner of the image on the page, in CSS pixels. */
  get box() {
    const { rows, cols } = this.shown.header, { clientWidth: wide, clientHeight: high } = this.viewport;
    const scale = Math.min(wide / cols, high / rows) * this.zoom, size = [scale * cols, scale * rows];
    return { scale, size, left: wide / 2 - this.middle[0] * size[0], top: high / 2 - this.middle[1] * size[1] };
  }

  updateLayout() {
    if (!this.shown) return;
    const { scale, left, top } = this.box;
    for (const canvas of this.viewport.querySelectorAll("canvas")) {
      const own = (scale * this.shown.header.cols) / canvas.width;
      canvas.style.transform = `translate(${left}px, ${top}px) scale(${own})`;
      canvas.style.imageRendering = own >= 2 ? "pixelated" : "auto";
    }
    this.onLayout();
  }

  /** Convert fractions of width and height to a position in the viewport, in CSS pixels. */
  toViewport([x, y]) {
    const { size, left, top } = this.box;
    return [left + x * size[0], top + y * size[1]];
  }

  toImage(event) {
    const own = this.viewport.getBoundingClientRect(), { size, left, top } = this.box;
    return [(event.clientX - own.left - left) / size[0], (event.clientY - own.top - top) / size[1]];
  }

  /** Return row and column of the pixel at a position, or null outside the image. */
  pixelAt([x, y]) {
    const { rows, cols } = this.shown.header, row = Math.floor(y * rows), col = Math.floor(x * cols);
    return row >= 0 && row < rows && col >= 0 && col < cols ? [row, col] : null;
  }

  /** Return the pixel value of the pinned image at a position. */
  pinnedAt([x, y]) {
    const { rows, cols } = this.pinned.header;
    return this.pinned.pixels[Math.floor(y * rows) * cols + Math.floor(x * cols)];
  }

  point(position) {
    this.cursor = position;
    this.onCursor();
    this.onLayout();
  }

  zoomBy(factor, about = this.middle) {
    const zoom = clamp(this.zoom * factor, 0.5, 40), share = 1 - this.zoom / zoom;
    this.middle = this.middle.map((value, k) => value + (about[k] - value) * share);
    this.zoom = zoom;
    this.updateLayout();
  }

  fit() {
    [this.zoom, this.middle] = [1, [0.5, 0.5]];
    this.updateLayout();
  }

  measure(position) {
    this.measured = this.measured.length === 1 ? [this.measured[0], position] : [position];
    this.point(position);
  }

  /** Measured distance in the joint plane, in mm; null if no distance is measured. */
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
    for (const edge of [low, high]) context.fillRect(Math.min(width - 2, Math.max(0, edge - 1)), 0, 2, height);
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
      if (tool === "measure") this.measured = [this.toImage(event)];
    };
    viewport.onpointermove = (event) => {
      if (!this.shown) return;
      if (!before) return this.point(this.toImage(event));
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      before = [event.clientX, event.clientY];
      const { size } = this.box;
      if (tool === "pan") {
        this.middle = [this.middle[0] - dx / size[0], this.middle[1] - dy / size[1]];
        this.updateLayout();
      } else if (tool === "window") {
        const step = Math.max(1, this.width / 300);
        this.window(this.width + dx * step, this.level + dy * step);
      } else {
        this.measured = [this.measured[0], this.toImage(event)];
        this.onLayout();
      }
    };
    viewport.onpointerup = viewport.onpointercancel = (event) => {
      if (before && tool === "measure" && this.shown) this.point(this.toImage(event));
      before = null;
    };
    viewport.onpointerleave = () => { if (!before) this.point(null); };
    viewport.addEventListener("wheel", (event) => {
      if (!this.shown) return;
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), this.toImage(event));
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
