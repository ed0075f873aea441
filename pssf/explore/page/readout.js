// Numbers: under the cursor, and of the exposure.

import { find, table, words } from "./dom.js";

const number = (value, digits) => (value === null || value === undefined ? "not known" : value.toFixed(digits));

/** What is under the cursor; paths in mm by material where they are known. */
export function showCursor(film, path) {
  const box = find("#cursor");
  const place = film.cursor && film.shown ? film.pixelAt(film.cursor) : null;
  if (!place) { box.textContent = ""; return null; }
  const { cols, look } = film.shown.header, [row, col] = place, value = film.shown.pixels[row * cols + col];
  const parts = [`Row ${row}, column ${col}: ${value}${look === "linear" ? "" : ` (${look})`}`];
  if (film.differs) parts[0] += `, A ${film.pinnedAt(film.cursor)}`;
  if (film.measuredMm !== null) parts.push(`measure ${film.measuredMm.toFixed(2)} mm`);
  const along = Object.entries(path ?? {}).map(([name, mm]) => `${words(name)} ${mm.toFixed(2)} mm`);
  if (path) parts.push(along.join(", ") || "air alone");
  box.textContent = parts.join("; ");
  return place;
}

export function showFigures({ header }, roundTripS) {
  const box = find("#figures"), { audit, seconds, truth } = header;
  box.textContent = "";
  table(box, "Exposure", [
    ["exposure index", number(header.exposure_index, 0)],
    ["entrance air kerma, µGy", number(header.entrance_kerma_ugy, 1)],
    ["scatter over primary, limb", number(header.spr_limb, 3)],
    ["scatter over primary, joint", number(header.spr_joint, 3)],
    ["mm a pixel at the joint", number(header.joint_mm_per_px, 4)],
    ["beam angle, deg", number(header.beam_angle_deg, 2)],
  ]);
  table(box, "Rays", [
    ["traced for this picture", header.rays_traced.toLocaleString("en")],
    ...Object.entries(audit).map(([name, count]) => [name, count.toLocaleString("en")]),
  ]);
  table(box, "Seconds", [
    ...Object.entries(seconds).map(([name, value]) => [name, value.toFixed(3)]),
    ["processor, all threads", header.cpu_s.toFixed(3)],
    ["from request to picture", roundTripS.toFixed(3)],
  ]);
  if (truth) table(box, "Truth", [
    ["minimum medial joint space, mm", number(truth.jsw_medial_mm, 2)],
    ["minimum lateral joint space, mm", number(truth.jsw_lateral_mm, 2)],
    ["grade", truth.grade === null ? "none" : String(truth.grade)],
    ...Object.entries(truth.attrition_mm).map(([side, mm]) => [`attrition ${side}, mm`, number(mm, 2)]),
  ]);
}
