// The page: what is changed on the left is asked of the server, shown in the middle and on the right.

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
  told(film.present ? "What is shown is of before." : "");
  find("#error").hidden = false;
  find("#error").textContent = error.message;
}
const asked = (side) => ({ knee: store.now.knee, protocol: store.now.protocol, seed: store.now.seed, look: store.now.look, side });
/** What the solids, the masks and the labels depend on. */
const shapeOf = ({ knee, protocol }) => JSON.stringify([knee, ["projection", "flexion_deg", "tibia_forward_deg", "rotation_deg",
  "tilt_deg", "beam_along", "beam_angle_deg", "sdd_mm", "sod_mm", "centre_x_mm", "centre_z_mm", "rows", "cols", "pixel_mm",
].map((name) => protocol[name])]);

/** One picture: "whole" or "coarse" as it was shown, "" where it was not. */
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
    told(`${whole ? "Whole" : "Coarse"} picture, ${rows} × ${cols}`);
    // For who waits for a picture: how many came, and of what kind the last one is.
    document.documentElement.dataset.picture = `${++pictures} ${whole ? "whole" : "coarse"}`;
    showCursorNow();
    return whole ? "whole" : "coarse";
  } catch (error) {
    failed(error);
    return "";
  }
}

/** While a slider is dragged: one coarse picture at a time, then that of where the slider is by then. */
async function drag() {
  if (busy) { again = true; return; }
  busy = true;
  do {
    again = false;
    await picture(COARSE_PX);
  } while (again);
  busy = false;
}

/** The hand is off: a coarse picture where none is there, and the whole one. */
async function rest() {
  again = false;
  told("Making the picture …");
  if (coarse !== JSON.stringify(asked(0))) {
    const shown = await picture(COARSE_PX);
    if (shown !== "coarse") {
      if (shown) settled();
      return;
    }
  }
  if (await picture(0)) settled();
}

/** Beside the picture, once it is whole: masks, solids, lines of Python. */
async function settled() {
  const state = asked(0), shape = shapeOf(state);
  try {
    await masksOf(state, shape);
    showLines(await server.file({ ...state, kind: "py" }));
    if (find("#solids-open").open && solidsAs !== shape) {
      const frame = find("#solids-frame"), page = await server.solids(state);
      let hash = "";
      try { hash = frame.contentWindow.location.hash; } catch { /* Not there yet. */ }
      frame.src = `${page}${hash}`;
      solidsAs = shape;
      document.documentElement.dataset.solids = page;
    }
  } catch (error) { failed(error); }
}

async function masksOf(state, shape) {
  const wanted = find("#show-masks").checked ? shape : "";
  if (wanted === maskedAs) return;
  if (wanted) told("Outlining bones and osteophytes …");
  const names = drawMasks(film, wanted ? await server.masks(state) : null);
  if (wanted) told("Bones and osteophytes are outlined.");
  tellColours(names);
  document.documentElement.dataset.masks = names.join(" ");
  maskedAs = wanted;
}

/** In what the present picture differs from the pinned one, and what the colours of the difference mean. */
function tellCompared() {
  if (!film.pinned) return;
  const names = differingFields(film.present.state, film.pinned.state).map(fieldWords);
  const more = names.length > MOST_NAMES ? ` and ${names.length - MOST_NAMES} more` : "";
  const what = names.length ? `B differs from A in ${names.slice(0, MOST_NAMES).join(", ")}${more}.` : "B is A.";
  find("#compared").textContent = film.differs ? `${what} Orange: B larger; blue: B smaller; dark: alike.` : what;
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
  // Another technique's signals lie elsewhere: a window that was kept would be black or white all over.
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
    find("#look").value = store.now.look;
    find("#undo").disabled = !store.before.length;
    find("#redo").disabled = !store.after.length;
  };
  const named = (names) => names.map((name) => [name, words(name)]);
  options(find("#preset"), [["", "choose …"], ...named(Object.keys(listing.presets))]);
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
  find("#look").onchange = ({ target }) => store.change({ look: target.value }, true);
  find("#undo").onclick = () => store.undo();
  find("#redo").onclick = () => store.redo();
  find("#reset").onclick = () => { film.anew = true; store.change(store.start(), true); };
  find("#link").onclick = async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      told("The link is copied; it holds the state, for this run of pssf explore.");
    } catch { told("The link is in the browser's address."); }
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
    else failed(new Error("the link holds no state"));
  };
  changed(true);
}

start().catch(failed);
