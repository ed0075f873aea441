// Readout: values under the cursor, and tables of exposure, ray casting, computing time and labels.

import { find, table, words } from "./dom.js";

const number = (value, digits) => (value === null || value === undefined ? "not available" : value.toFixed(digits));

/** Show the values under the cursor, with the path length in each material in mm if available. */
export function showCursor(film, pathLengths) {
  const box = find("#cursor");
  const pixel = film.cursor && film.shown ? film.pixelAt(film.cursor) : null;
  if (!pixel) { box.textContent = ""; return null; }
  const { cols, processing } = film.shown.header, [row, col] = pixel, value = film.shown.pixels[row * cols + col];
  const parts = [`Row ${row}, column ${col}: ${value}${processing === "linear" ? "" : ` (${processing})`}`];
  if (film.differs) parts[0] += `, pinned ${film.pinnedAt(film.cursor)}`;
  if (film.measuredMm !== null) parts.push(`distance ${film.measuredMm.toFixed(2)} mm`);
  const along = Object.entries(pathLengths ?? {}).map(([name, mm]) => `${words(name)} ${mm.toFixed(2)} mm`);
  if (pathLengths) parts.push(along.join(", ") || "air only");
  box.textContent = parts.join("; ");
  return pixel;
}

export function showFigures({ header }, roundTripS) {
  const box = find("#figures"), { audit, seconds, truth } = header;
  box.textContent = "";
  table(box, "Exposure", [
    ["exposure index", number(header.exposure_index, 0)],
    ["entrance air kerma, µGy", number(header.entrance_kerma_ugy, 1)],
    ["scatter-to-primary ratio, limb", number(header.spr_limb, 3)],
    ["scatter-to-primary ratio, joint", number(header.spr_joint, 3)],
    ["mm per pixel in the joint plane", number(header.joint_mm_per_px, 4)],
    ["beam angle, deg", number(header.beam_angle_deg, 2)],
  ]);
  table(box, "Ray casting", [
    ["rays cast for this image", header.rays_traced.toLocaleString("en")],
    ...Object.entries(audit).map(([name, count]) => [name, count.toLocaleString("en")]),
  ]);
  table(box, "Computing time, s", [
    ...Object.entries(seconds).map(([name, value]) => [name, value.toFixed(3)]),
    ["CPU time, all threads", header.cpu_s.toFixed(3)],
    ["from request to image", roundTripS.toFixed(3)],
  ]);
  if (truth) table(box, "Labels", [
    ["minimum medial JSW, mm", number(truth.jsw_medial_mm, 2)],
    ["minimum lateral JSW, mm", number(truth.jsw_lateral_mm, 2)],
    ["KL grade", truth.grade === null ? "none" : String(truth.grade)],
    ...Object.entries(truth.attrition_mm).map(([side, mm]) => [`attrition ${side}, mm`, number(mm, 2)]),
  ]);
}
