// Export: files of the current image and knee, and Python code that reproduces the image.

import { find, make } from "./dom.js";

const KINDS = [["tif", "TIFF, 16 bit"], ["dcm", "DICOM, for processing"], ["presentation.dcm", "DICOM, for presentation"],
  ["png", "PNG"], ["json", "Parameters, JSON"], ["stl", "STL"], ["ply", "PLY"], ["glb", "GLB"], ["3mf", "3MF"],
  ["knee.toml", "Knee, TOML"], ["protocol.toml", "Protocol, TOML"], ["py", "Python"]];

const sized = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

function handed(name, blob) {
  const link = make(document.body, "a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function listFiles(asked, film, told, failed) {
  for (const [kind, text] of KINDS) {
    const button = make(find("#files"), "button", { type: "button", "data-kind": kind }, text);
    button.onclick = async () => {
      button.disabled = true;
      told(`Writing ${text} …`);
      try {
        const { name, blob } = await asked(kind);
        handed(name, blob);
        told(`${name} saved, ${sized(blob.size)}.`);
      } catch (error) { failed(error); } finally { button.disabled = false; }
    };
  }
  const view = make(find("#files"), "button", { type: "button", "data-kind": "view" }, "Current view, PNG");
  view.onclick = () => film.canvas.toBlob((blob) => {
    handed("view.png", blob);
    told(`view.png saved, ${sized(blob.size)}.`);
  });
  find("#copy-lines").onclick = async () => {
    await navigator.clipboard.writeText(find("#lines").textContent);
    told("Code copied.");
  };
}

export async function showLines({ blob }) {
  find("#lines").textContent = await blob.text();
}
