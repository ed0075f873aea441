// Overlay on the radiograph: landmarks, JSW, masks, cursor and measured distance.

import { find, make, words } from "./dom.js";

// Mask colours that are safe for colour-blind users (Okabe and Ito).
const COLOURS = { femur: [230, 159, 0], tibia: [86, 180, 233], fibula: [0, 158, 115], patella: [240, 228, 66],
  fabella: [204, 121, 167], osteophyte: [213, 94, 0], cyst: [0, 114, 178] };
const EDGE_PX = 2;

export function drawOverlay(film, truth) {
  const svg = find("#overlay");
  svg.textContent = "";
  if (!film.shown) return;
  // Landmark positions are in pixels of the image at full resolution.
  const at = ([row, col]) => film.toViewport([(col + 0.5) / truth.cols, (row + 0.5) / truth.rows]);
  const spots = truth?.landmarks_px ?? {};
  if (find("#show-landmarks").checked) for (const [name, place] of Object.entries(spots)) {
    const [x, y] = at(place), mark = make(svg, "circle", { class: "mark", cx: x, cy: y, r: 4, "data-landmark": name });
    make(mark, "title", {}, words(name));
    if (film.zoom >= 2) make(svg, "text", { x: x + 6, y: y - 4 }, words(name));
  }
  if (find("#show-spaces").checked) for (const side of ["medial", "lateral"]) {
    const mm = truth?.[`jsw_${side}_mm`];
    if (mm === null || mm === undefined) continue;
    // The line connects the contours of femur and tibia at the minimum joint space width.
    const femur = spots[`${side}_jsw_femur`], col = femur[1];
    const [[x, top], [foot, bottom]] = [at(femur), at(spots[`${side}_jsw_tibia`])];
    make(svg, "path", { class: "space", d: `M${x - 8} ${top}h16M${x} ${top}L${foot} ${bottom}M${foot - 8} ${bottom}h16`,
      "data-space": side });
    // The value is written on the side of the compartment, medial or lateral to the joint.
    const left = col < spots.joint_centre[1];
    make(svg, "text", { x: left ? x - 11 : x + 11, y: (top + bottom) / 2 + 4, "text-anchor": left ? "end" : "start" },
      `${side} ${mm.toFixed(1)} mm`);
  }
  drawCursorAndDistance(film, svg);
}

function drawCursorAndDistance(film, svg) {
  if (film.measured.length === 2) {
    const [[x1, y1], [x2, y2]] = film.measured.map((place) => film.toViewport(place));
    make(svg, "path", { class: "measure", d: `M${x1} ${y1}L${x2} ${y2}` });
    make(svg, "text", { x: (x1 + x2) / 2 + 8, y: (y1 + y2) / 2, id: "measured" }, `${film.measuredMm.toFixed(2)} mm`);
  } else if (film.measured.length === 1) {
    const [x, y] = film.toViewport(film.measured[0]);
    make(svg, "circle", { class: "measure", cx: x, cy: y, r: 4 });
  }
  if (film.cursor && document.activeElement === film.viewport) {
    const [x, y] = film.toViewport(film.cursor);
    make(svg, "path", { class: "cross", d: `M${x - 9} ${y}h18M${x} ${y - 9}v18` });
  }
}

/** Show the legend of the mask colours; hide the legend if there are no masks. */
export function showLegend(names) {
  const legend = find("#legend");
  legend.hidden = !names.length;
  legend.textContent = "";
  // The content security policy forbids style attributes, so the script sets a style property.
  for (const name of names)
    make(legend, "span", {}, words(name)).style.setProperty("--colour", `rgb(${colourOf(name).join(" ")})`);
}

const colourOf = (name) => COLOURS[name] ?? COLOURS[name.split("_").at(-1)] ?? [255, 255, 255];

/** Draw mask outlines on a canvas over the image, from masks with one bit per pixel. Return the mask names. */
export function drawMasks(film, masks) {
  find("#masks")?.remove();
  if (!masks) return film.updateLayout(), [];
  const canvas = make(film.viewport, "canvas", { id: "masks", width: masks.cols, height: masks.rows });
  find("#overlay").before(canvas);
  Object.assign(canvas.style, { position: "absolute", left: 0, top: 0, transformOrigin: "0 0", pointerEvents: "none" });
  const { rows, cols } = masks, context = canvas.getContext("2d"), image = context.createImageData(cols, rows);
  const out = new Uint32Array(image.data.buffer), each = Math.ceil((rows * cols) / 8);
  const reach = Math.max(1, Math.round((EDGE_PX * cols) / 1024));
  masks.names.forEach((name, place) => {
    const bits = masks.bits.subarray(place * each, (place + 1) * each), [red, green, blue] = colourOf(name);
    const on = (k) => (bits[k >> 3] >> (7 - (k & 7))) & 1, colour = (0xff << 24) | (blue << 16) | (green << 8) | red;
    for (let row = reach; row < rows - reach; row++) for (let col = reach, k = row * cols + reach; col < cols - reach; col++, k++)
      if (on(k) && !(on(k - reach) && on(k + reach) && on(k - reach * cols) && on(k + reach * cols))) out[k] = colour;
  });
  context.putImageData(image, 0, 0);
  film.updateLayout();
  return masks.names;
}
