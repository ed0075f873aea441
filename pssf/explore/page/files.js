// Export: download files of the current image and knee, and show Python code that reproduces the image.

import { find, make } from "./dom.js";

const KINDS = [["tif", "TIFF, 16 bit"], ["dcm", "DICOM, for processing"], ["presentation.dcm", "DICOM, for presentation"],
  ["png", "PNG"], ["json", "Parameters, JSON"], ["stl", "STL"], ["ply", "PLY"], ["glb", "GLB"], ["3mf", "3MF"],
  ["knee.toml", "Knee, TOML"], ["protocol.toml", "Protocol, TOML"], ["py", "Python"]];

const formatSize = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

function download(name, blob) {
  const link = make(document.body, "a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function listFiles(requestFile, film, showStatus, showError) {
  for (const [kind, text] of KINDS) {
    const button = make(find("#files"), "button", { type: "button", "data-kind": kind }, text);
    button.onclick = async () => {
      button.disabled = true;
      showStatus(`Writing ${text} …`);
      try {
        const { name, blob } = await requestFile(kind);
        download(name, blob);
        showStatus(`${name} saved, ${formatSize(blob.size)}.`);
      } catch (error) { showError(error); } finally { button.disabled = false; }
    };
  }
  const view = make(find("#files"), "button", { type: "button", "data-kind": "view" }, "Current view, PNG");
  view.onclick = () => film.canvas.toBlob((blob) => {
    download("view.png", blob);
    showStatus(`view.png saved, ${formatSize(blob.size)}.`);
  });
  find("#copy-lines").onclick = async () => {
    await navigator.clipboard.writeText(find("#lines").textContent);
    showStatus("Code copied.");
  };
}

export async function showLines({ blob }) {
  find("#lines").textContent = await blob.text();
}
