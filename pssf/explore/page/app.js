// Entry point of the explore page: send each parameter change to the server, and update image, exposure and 3D view.

import { showBusy } from "./busy.js";
import { find, options, words } from "./dom.js";
import { groups, items, shapes } from "./fields.js";
import { Film } from "./film.js";
import { listFiles, showLines } from "./files.js";
import { drawMasks, drawOverlay, showLegend } from "./overlay.js";
import { showCursor, showFigures } from "./readout.js";
import * as server from "./server.js";
import { differingLabels, Store } from "./state.js";

const COARSE_PX = 512, MOST_NAMES = 4;
const SIMULATING = "Simulating …", REFINING = "Preview: simulating full resolution …";
export const film = new Film();
export let store;
let showValues, truth = null, pathLengths = null, dragging = false, previewPending = false, imageCount = 0;
// Parameter keys of the displayed image and of the latest image at full resolution, and whether the last request
// failed.
let shownKey = "", fullResolutionKey = "", requestFailed = false;
let masksKey = "", solidsKey = "", windowedProtocol = "", probeTimer = 0;

const showStatus = (text) => { find("#status").textContent = text; };
function showError(error) {
  if (error instanceof server.Superseded) return;
  showStatus("");
  find("#error").hidden = false;
  find("#error").textContent = error.message;
}
const stateKey = (state) => JSON.stringify({ ...state, side: 0 });
/** Show `text` over the image while the image does not match the parameters. */
function updateBusy(text) {
  const same = fullResolutionKey === stateKey(requestState(0));
  if (same) showBusy("", false);
  else if (requestFailed) showBusy("This image is out of date", false);
  else showBusy(text, text !== "");
}
/** Return the state of the page for a request. `side` is the size of a preview in pixels, or 0 for full size. */
function requestState(side) {
  const { knee, protocol, seed, processing } = store.now;
  return { knee, protocol, seed, processing, side };
}
/** Return a key that identifies the parameters of the 3D view, the masks and the labels. */
const geometryKey = ({ knee, protocol }) => JSON.stringify([knee, ["projection", "flexion_deg", "tibia_forward_deg",
  "rotation_deg", "tilt_deg", "beam_along", "beam_angle_deg", "sdd_mm", "sod_mm", "centre_x_mm", "centre_z_mm", "rows",
  "cols", "pixel_mm",
].map((name) => protocol[name])]);

/** Request and show one image. Show the text `next` over a preview. Return "whole" for an image at full resolution,
 *  "coarse" for a preview, and "" after an error. */
async function showImage(side, next) {
  const began = performance.now(), state = requestState(side), key = stateKey(state);
  try {
    const made = await server.radiograph(state);
    find("#error").hidden = true;
    made.state = state;
    pathLengths = null;
    truth = made.header.truth ? { ...made.header.truth, ...made.header, geometry: geometryKey(state) } : truth;
    if (truth?.geometry !== geometryKey(state)) truth = null;
    film.show(made);
    if (masksKey !== geometryKey(state)) showMasks(null, "");
    describeComparison();
    showFigures(made, (performance.now() - began) / 1000);
    const { rows, cols, whole } = made.header;
    [shownKey, fullResolutionKey, requestFailed] = [key, whole ? key : "", false];
    updateBusy(key === stateKey(requestState(0)) ? next : SIMULATING);
    showStatus(`${whole ? "Full resolution" : "Preview"}, ${rows} × ${cols} pixels`);
    // Tests wait for this attribute, which contains the number of images and the resolution of the latest image.
    document.documentElement.dataset.picture = `${++imageCount} ${whole ? "whole" : "coarse"}`;
    updateCursor();
    return whole ? "whole" : "coarse";
  } catch (error) {
    if (!(error instanceof server.Superseded)) requestFailed = true;
    showError(error);
    updateBusy(SIMULATING);
    return "";
  }
}

/** Request previews while a slider is dragged: one preview at a time, and always one with the latest value. */
async function showPreviews() {
  if (dragging) { previewPending = true; return; }
  dragging = true;
  do {
    previewPending = false;
    await showImage(COARSE_PX, "");
  } while (previewPending);
  dragging = false;
}

/** Request an image after a slider is released: a preview if none is displayed, then an image at full resolution. */
async function refresh() {
  previewPending = false;
  if (shownKey !== stateKey(requestState(0))) {
    const shown = await showImage(COARSE_PX, REFINING);
    if (shown !== "coarse") {
      if (shown) updateDependents();
      return;
    }
  }
  updateBusy(REFINING);
  if (await showImage(0, "")) updateDependents();
}

/** Update masks, Python code and 3D view after an image at full resolution. */
async function updateDependents() {
  const state = requestState(0), geometry = geometryKey(state);
  try {
    await updateMasks(state, geometry);
    showLines(await server.file({ ...state, kind: "py" }));
    if (find("#solids-open").open && solidsKey !== geometry) {
      const frame = find("#solids-frame"), page = await server.solids(state);
      let hash = "";
      try { hash = frame.contentWindow.location.hash; } catch { /* The frame is not loaded yet. */ }
      frame.src = `${page}${hash}`;
      solidsKey = geometry;
      document.documentElement.dataset.solids = page;
    }
  } catch (error) { showError(error); }
}

async function updateMasks(state, geometry) {
  const wanted = find("#show-masks").checked ? geometry : "";
  if (wanted === masksKey) return;
  if (wanted) showBusy("Rendering masks …", true);
  let masks = null;
  try {
    if (wanted) masks = await server.masks(state);
  } finally { updateBusy(SIMULATING); }
  showMasks(masks, wanted);
}

function showMasks(masks, geometry) {
  const names = drawMasks(film, masks);
  showLegend(names);
  document.documentElement.dataset.masks = names.join(" ");
  masksKey = geometry;
}

/** Describe how the current image differs from the pinned image, and explain the colours of the difference image. */
function describeComparison() {
  if (!film.pinned) return;
  const names = differingLabels(film.present.state, film.pinned.state, store.listing);
  const more = names.length > MOST_NAMES ? ` and ${names.length - MOST_NAMES} more` : "";
  const what = names.length ? `The current image differs from the pinned image in ${names.slice(0, MOST_NAMES).join(", ")}${more}.`
    : "Both images have the same parameters.";
  const legend = "The current pixel value is larger (orange), smaller (blue) or equal (dark).";
  find("#compared").textContent = film.differs ? `${what} ${legend}` : what;
}

function updateCursor() {
  const pixel = showCursor(film, pathLengths);
  drawOverlay(film, truth);
  clearTimeout(probeTimer);
  if (!pixel || pathLengths) return;
  probeTimer = setTimeout(async () => {
    const side = film.shown.state.side;
    try {
      const probed = await server.probe({ ...film.shown.state, side, row: pixel[0], col: pixel[1] });
      const now = film.cursor && film.pixelAt(film.cursor);
      if (!probed.path_mm || !now || now[0] !== pixel[0] || now[1] !== pixel[1]) return;
      pathLengths = probed.path_mm;
      showCursor(film, pathLengths);
    } catch (error) { showError(error); }
  }, 60);
}

function handleChange(final) {
  showValues();
  requestFailed = false;
  updateBusy(SIMULATING);
  // The window is reset for a new protocol, because the signal range differs and the image could become black or white.
  if (store.now.from !== windowedProtocol) film.needsAutoWindow = true;
  windowedProtocol = store.now.from;
  if (!final) { showPreviews(); return; }
  history.replaceState(null, "", store.link());
  refresh();
}

function buildControls(listing) {
  const { knee } = listing, parts = [];
  const left = find("#knee");
  parts.push([groups(left, knee, "knee", store), (now) => now.knee]);
  for (const name of ["osteophytes", "cysts"])
    parts.push([items(left, name, listing.items[name], listing.most[name], store), (now) => now.knee[name]]);
  parts.push([shapes(left, listing.shape, store), (now) => now.knee.shape]);
  parts.push([groups(find("#exposure"), listing.protocol, "protocol", store), (now) => now.protocol]);
  showValues = () => {
    parts.forEach(([part, of]) => part(of(store.now)));
    find("#protocol-name").value = store.now.from;
    find("#seed").value = store.now.seed;
    find("#processing").value = store.now.processing;
    find("#undo").disabled = !store.before.length;
    find("#redo").disabled = !store.after.length;
  };
  options(find("#processing"), Object.entries(listing.processing));
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
  find("#reset").onclick = () => { film.needsAutoWindow = true; store.change(store.start(), true); };
  find("#link").onclick = async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      showStatus("Link copied. The link contains all parameters and works while this server runs.");
    } catch { showStatus("Copy the link from the address bar."); }
  };
  find("#draw").onclick = async () => {
    const seed = Math.floor(Math.random() * 2 ** 32);
    try {
      const wanted = { grade_table: find("#draw-table").value, grade: +find("#draw-grade").value, seed };
      const knee = await server.sampleKnee(wanted);
      film.needsAutoWindow = true;
      store.change({ knee }, true);
    } catch (error) { showError(error); }
  };
  find("#parameters").onsubmit = (event) => event.preventDefault();
}

function connectFilm() {
  film.onLayout = () => drawOverlay(film, truth);
  film.onCursor = () => { pathLengths = null; updateCursor(); };
  find("#window").onchange = find("#level").onchange = () => film.window(+find("#window").value, +find("#level").value);
  find("#auto").onclick = () => film.auto();
  find("#bone-bright").onchange = () => film.paint();
  find("#fit").onclick = () => film.fit();
  find("#zoom-in").onclick = () => film.zoomBy(1.25);
  find("#zoom-out").onclick = () => film.zoomBy(0.8);
  find("#show-landmarks").onchange = find("#show-spaces").onchange = () => drawOverlay(film, truth);
  find("#show-masks").onchange = () => updateMasks(requestState(0), geometryKey(requestState(0))).catch(showError);
  find("#pin").onclick = () => {
    film.pin();
    find("#compare").disabled = false;
    describeComparison();
  };
  find("#compare").onchange = () => { film.paint(); describeComparison(); };
  find("#skip").onclick = () => film.viewport.focus();
  find("#solids-open").ontoggle = () => { if (film.present?.header.whole) updateDependents(); };
}

async function start() {
  const listing = await server.fields();
  store = new Store(listing);
  store.now = store.read(location.hash) ?? store.now;
  buildControls(listing);
  connectFilm();
  listFiles((kind) => server.file({ ...requestState(0), kind }), film, showStatus, showError);
  store.listeners.push(handleChange);
  window.onhashchange = () => {
    const read = store.read(location.hash);
    if (read) store.change(read, true);
    else showError(new Error("The link does not contain parameters of this page"));
  };
  handleChange(true);
}

start().catch((error) => {
  showBusy("", false);
  showError(error);
});
