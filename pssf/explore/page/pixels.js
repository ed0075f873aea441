// Functions for pixel arrays: window and level, histogram, and difference images.

/** Return a lookup table from 16-bit values to grey levels (RGBA as Uint32): black below the window, white above. */
export function greyTable(width, level, invert) {
  const table = new Uint32Array(65536), low = level - width / 2;
  for (let value = 0; value < 65536; value++) {
    const share = Math.min(1, Math.max(0, (value - low) / width));
    const grey = Math.round(255 * (invert ? 1 - share : share));
    table[value] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
  }
  return table;
}

/** Return a lookup table from differences to colours, blue if negative, orange if positive; index 32768 + difference. */
export function differenceTable(width) {
  const table = new Uint32Array(65536);
  for (let k = 0; k < 65536; k++) {
    const share = Math.max(-1, Math.min(1, (k - 32768) / (width / 2))), far = Math.abs(share);
    const end = share < 0 ? [86, 180, 233] : [230, 159, 0];
    const [red, green, blue] = end.map((part) => Math.round(32 + (part - 32) * far));
    table[k] = 0xff000000 | (blue << 16) | (green << 8) | red;
  }
  return table;
}

/** Return the difference of two images, 32768 + b - a, clipped to 16 bits. */
export function subtract(b, a) {
  const out = new Uint16Array(b.length);
  for (let k = 0; k < out.length; k++) out[k] = Math.min(65535, Math.max(0, 32768 + b[k] - a[k]));
  return out;
}

/** Subsample an image to a number of rows and columns. */
export function subsample({ header, pixels }, rows, cols) {
  if (header.rows === rows && header.cols === cols) return pixels;
  const out = new Uint16Array(rows * cols), down = header.rows / rows, across = header.cols / cols;
  for (let row = 0, k = 0; row < rows; row++) {
    const start = Math.floor((row + 0.5) * down) * header.cols;
    for (let col = 0; col < cols; col++, k++) out[k] = pixels[start + Math.floor((col + 0.5) * across)];
  }
  return out;
}

export function histogram(pixels, bins) {
  const counts = new Uint32Array(bins), step = Math.max(1, Math.floor(pixels.length / 500000));
  for (let k = 0; k < pixels.length; k += step) counts[Math.floor((pixels[k] * bins) / 65536)]++;
  return counts;
}

/** Return a quantile of the pixel values below `most`, computed from a histogram with 65536 bins. */
function quantile(counts, share, most = 65536) {
  const wanted = share * counts.subarray(0, most).reduce((sum, value) => sum + value, 0);
  let sum = 0;
  for (let value = 0; value < most; value++) if ((sum += counts[value]) >= wanted) return value;
  return 65535;
}

/** Return width and level of a bone window for a linear image. The window covers only values below half of the
 *  open-beam signal, because bone would be uniformly white in a window that includes soft tissue. */
export function boneWindow(pixels) {
  const counts = histogram(pixels, 65536), open = Math.max(2, Math.round(quantile(counts, 0.999) / 2));
  const low = quantile(counts, 0.005, open), high = quantile(counts, 0.6, open);
  return { width: Math.max(1, high - low), level: Math.round((low + high) / 2) };
}

/** Convert pixels to RGBA with a lookup table, and write the result to `image`. */
export function applyTable(pixels, table, image) {
  const out = new Uint32Array(image.data.buffer);
  for (let k = 0; k < out.length; k++) out[k] = table[pixels[k]];
  return image;
}
