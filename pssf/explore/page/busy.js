// Busy indicator over the radiograph, which is visible while the image does not match the parameters.

import { find } from "./dom.js";

// Delay before the busy indicator appears, and its minimum display time, in ms. Both times prevent flicker.
const DELAY_MS = 150;
let timer = 0, wanted = "", since = 0;

/** Show a text over the image, or hide the busy indicator if the text is empty. `running`: simulation active. */
export function showBusy(text, running) {
  const sign = find("#busy"), visible = sign.textContent !== "";
  wanted = text;
  find("#viewport").setAttribute("aria-busy", String(running));
  const apply = () => {
    clearTimeout(timer);
    timer = 0;
    if (!sign.textContent) since = performance.now();
    if (wanted) sign.classList.toggle("running", running);
    sign.textContent = wanted;
  };
  if ((text !== "") === visible) apply();
  else timer ||= setTimeout(apply, visible ? Math.max(0, since + DELAY_MS - performance.now()) : DELAY_MS);
}
