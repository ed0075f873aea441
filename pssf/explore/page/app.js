// Entry point of the page: send every change of a parameter to the server, then update image, figures and 3D view.

import { fieldWords, find, options, words } from "./dom.js";
import { groups, items, shapes } from "./fields.js";
import { Film } from "./film.js";
import { listFiles, showLines } from "./files.js";
import { drawMasks, drawOverlay, tellColours } from "./overlay.js";
import { showCursor, showFigures } from "./readout.js";
import * as server from "./server.js";
import { differingFields, Store } from "./state.js";

const COARSE_PX = 512, MOST_NAMES = 4;
export const film = new Film();
export let store;
let show, truth = null, path = null, busy = false, again = false, coarse = "", pictures = 0;
let maskedAs = "", solidsAs = "", windowedAs = "", probing = 0;

const told = (text) => { find("#status").textContent = text; };
function failed(error) {
  if (error instanceof server.Superseded) return;
  told(film.present ? "The image shown is out of date." : "");
  find("#error").hidden = false;
  find("#error").textContent = error.message;
}
const asked = (side) => ({ knee: store.now.knee, protocol: store.now.protocol, seed: store.now.seed, processing: store.now.processing, side });
/** Key of the parameters that affect the 3D view, the masks and the labels. */
const shapeOf = ({ knee, protocol }) => JSON.stringify([knee, ["projection", "flexion_deg", "tibia_forward_deg", "rotation_deg",
  "tilt_deg", "beam_along", "beam_angle_deg", "sdd_mm", "sod_mm", "centre_x_mm", "centre_z_mm", "rows", "cols", "pixel_mm",
].map((name) => protocol[name])]);

/** Request and show one image. Return "whole" at full resolution, "coarse" for a preview, "" after an error. */
async function picture(side) {
  const began = performance.now(), state = asked(side), key = JSON.stringify({ ...state, side: 0 });
  try {
    const made = await server.radiograph(state);
    find("#error").hidden = true;
    made.state = state;
    path = null;
    truth = made.header.truth ? { ...made.header.truth, ...made.header, shape: shapeOf(state) } : truth;
    if (truth?.shape !== shapeOf(state)) truth = null;
    film.show(made);
    tellCompared();
    showFigures(made, (performance.now() - began) / 1000);
    coarse = key;
    const { rows, cols, whole } = made.header;
    told(`${whole ? "Full resolution" : "Preview"}, ${rows} × ${cols}`);
    // Tests wait for this attribute: number of images so far, and kind of the last one.
    document.documentElement.dataset.picture = `${++pictures} ${whole ? "whole" : "coarse"}`;
    showCursorNow();
    return whole ? "whole" : "coarse";
  } catch (error) {
    failed(error);
    return "";
  }
}

/** While a slider is dragged: show one preview at a time, then a preview of the latest position. */
async function drag() {
  if (busy) { again = true; return; }
  busy = true;
  do {
    again = false;
    await picture(COARSE_PX);
  } while (again);
  busy = false;
}

/** When a slider is released: show a preview unless it is shown already, then full resolution. */
async function rest() {
  again = false;
  told("Simulating …");
  if (coarse !== JSON.stringify(asked(0))) {
    const shown = await picture(COARSE_PX);
    if (shown !== "coarse") {
      if (shown) settled();
      return;
    }
  }
  if (await picture(0)) settled();
}

/** After an image at full resolution: update masks, Python code and 3D view. */
async function settled() {
  const state = asked(0), shape = shapeOf(state);
  try {
    await masksOf(state, shape);
    showLines(await server.file({ ...state, kind: "py" }));
    if (find("#solids-open").open && solidsAs !== shape) {
      const frame = find("#solids-frame"), page = await server.solids(state);
      let hash = "";
      try { hash = frame.contentWindow.location.hash; } catch { /* The frame is not loaded yet. */ }
      frame.src = `${page}${hash}`;
      solidsAs = shape;
      document.documentElement.dataset.solids = page;
    }
  } catch (error) { failed(error); }
}

async function masksOf(state, shape) {
  const wanted = find("#show-masks").checked ? shape : "";
  if (wanted === maskedAs) return;
  if (wanted) told("Rendering masks …");
  const names = drawMasks(film, wanted ? await server.masks(state) : null);
  if (wanted) told("Masks are shown.");
  tellColours(names);
  document.documentElement.dataset.masks = names.join(" ");
  maskedAs = wanted;
}

/** Describe how current and pinned image differ, and what the colours of the difference mean. */
function tellCompared() {
  if (!film.pinned) return;
  const names = differingFields(film.present.state, film.pinned.state).map(fieldWords);
  const more = names.length > MOST_NAMES ? ` and ${names.length - MOST_NAMES} more` : "";
  const what = names.length ? `The current image differs from the pinned one in ${names.slice(0, MOST_NAMES).join(", ")}${more}.`
    : "Both images have the same parameters.";
  find("#compared").textContent = film.differs ? `${what} Orange: current larger; blue: current smaller; dark: equal.` : what;
}

function showCursorNow() {
  const place = showCursor(film, path);
  drawOverlay(film, truth);
  clearTimeout(probing);
  if (!place || path) return;
  probing = setTimeout(async () => {
    const side = film.shown.state.side;
    try {
      const found = await server.probe({ ...film.shown.state, side, row: place[0], col: place[1] });
      const now = film.cursor && film.pixelAt(film.cursor);
      if (!found.path_mm || !now || now[0] !== place[0] || now[1] !== place[1]) return;
      path = found.path_mm;
      showCursor(film, path);
    } catch (error) { failed(error); }
  }, 60);
}

function changed(whole) {
  show();
  // Another protocol has another signal range. Keeping the window could make the image all black or all white.
  if (store.now.from !== windowedAs) film.anew = true;
  windowedAs = store.now.from;
  if (!whole) { drag(); return; }
  history.replaceState(null, "", store.link());
  rest();
}

function wire(listing) {
  const { knee } = listing, parts = [];
  const left = find("#knee");
  parts.push([groups(left, knee, "knee", store), (now) => now.knee]);
  for (const name of ["osteophytes", "cysts"])
    parts.push([items(left, name, listing.items[name], listing.most[name], store), (now) => now.knee[name]]);
  parts.push([shapes(left, listing.shape, store), (now) => now.knee.shape]);
  parts.push([groups(find("#exposure"), listing.protocol, "protocol", store), (now) => now.protocol]);
  show = () => {
    parts.forEach(([part, of]) => part(of(store.now)));
    find("#protocol-name").value = store.now.from;
    find("#seed").value = store.now.seed;
    find("#processing").value = store.now.processing;
    find("#undo").disabled = !store.before.length;
    find("#redo").disabled = !store.after.length;
  };
  const named = (names) => names.map((name) => [name, words(name)]);
  options(find("#preset"), [["", "select …"], ...named(Object.keys(listing.presets))]);
  options(find("#protocol-name"), named(Object.keys(listing.protocols)));
  options(find("#draw-table"), named(Object.keys(listing.tables)));
  const grades = () => options(find("#draw-grade"), listing.tables[find("#draw-table").value].map((grade) => [grade, grade]));
  find("#draw-table").onchange = grades;
  grades();
  find("#preset").onchange = ({ target }) => {
    const preset = listing.presets[target.value];
    if (preset) store.change({ knee: structuredClone(preset.knee), protocol: structuredClone(listing.protocols[preset.protocol]),
      from: preset.protocol }, true);
    target.value = "";
  };
  find("#protocol-name").onchange = ({ target }) =>
    store.change({ protocol: structuredClone(listing.protocols[target.value]), from: target.value }, true);
  find("#seed").max = listing.largest_seed;
  find("#seed").onchange = ({ target }) => {
    if (target.value !== "" && target.validity.valid) store.change({ seed: +target.value }, true);
    else target.reportValidity();
  };
  find("#another").onclick = () => store.change({ seed: store.now.seed + 1 }, true);
  find("#processing").onchange = ({ target }) => store.change({ processing: target.value }, true);
  find("#undo").onclick = () => store.undo();
  find("#redo").onclick = () => store.redo();
  find("#reset").onclick = () => { film.anew = true; store.change(store.start(), true); };
  find("#link").onclick = async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      told("Link copied. It holds all parameters and works while this server runs.");
    } catch { told("Copy the link from the address bar."); }
  };
  find("#draw").onclick = async () => {
    const seed = Math.floor(Math.random() * 2 ** 32);
    try {
      const wanted = { grade_table: find("#draw-table").value, grade: +find("#draw-grade").value, seed };
      const knee = await server.draw(wanted);
      film.anew = true;
      store.change({ knee }, true);
    } catch (error) { failed(error); }
  };
  find("#parameters").onsubmit = (event) => event.preventDefault();
}

function wireFilm() {
  film.moved = () => drawOverlay(film, truth);
  film.pointed = () => { path = null; showCursorNow(); };
  find("#window").onchange = find("#level").onchange = () => film.window(+find("#window").value, +find("#level").value);
  find("#auto").onclick = () => film.auto();
  find("#invert").onchange = () => film.paint();
  find("#fit").onclick = () => film.fit();
  find("#zoom-in").onclick = () => film.zoomBy(1.25);
  find("#zoom-out").onclick = () => film.zoomBy(0.8);
  find("#show-landmarks").onchange = find("#show-spaces").onchange = () => drawOverlay(film, truth);
  find("#show-masks").onchange = () => masksOf(asked(0), shapeOf(asked(0))).catch(failed);
  find("#pin").onclick = () => {
    film.pin();
    find("#compare").disabled = false;
    tellCompared();
  };
  find("#compare").onchange = () => { film.paint(); tellCompared(); };
  find("#skip").onclick = () => film.viewport.focus();
  find("#solids-open").ontoggle = () => { if (film.present?.header.whole) settled(); };
}

async function start() {
  const listing = await server.fields();
  store = new Store(listing);
  store.now = store.read(location.hash) ?? store.now;
  wire(listing);
  wireFilm();
  listFiles((kind) => server.file({ ...asked(0), kind }), film, told, failed);
  store.listeners.push(changed);
  window.onhashchange = () => {
    const read = store.read(location.hash);
    if (read) store.change(read, true);
    else failed(new Error("The link must hold parameters of this page, got something else"));
  };
  changed(true);
}

start().catch(failed);
