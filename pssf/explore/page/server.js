// Requests to the explore server. The URLs are relative to the page, so they contain the secret token.

const tab = Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");
const running = new Map();

/** Error raised when a newer request supersedes a request; it is not reported as a failure. */
export class Superseded extends Error {}

async function send(address, body, signal) {
  let answer;
  try {
    answer = await fetch(address, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), signal,
    });
  } catch {
    throw new Error("pssf explore does not respond: check that it is still running");
  }
  if (answer.ok) return answer;
  if (answer.status === 409) throw new Superseded();
  const reply = await answer.json().catch(() => ({ error: `status ${answer.status}` }));
  throw new Error(reply.error);
}

/** Send a request, and abort the previous request of the same type, even if its answer has partly arrived. */
async function latest(kind, address, body, read) {
  running.get(kind)?.abort();
  const control = new AbortController(), { signal } = control;
  running.set(kind, control);
  try {
    const result = await read(await send(address, { tab, ...body }, signal));
    signal.throwIfAborted();
    return result;
  } catch (error) {
    throw signal.aborted ? new Superseded() : error;
  } finally {
    if (running.get(kind) === control) running.delete(kind);
  }
}

async function unpack(answer) {
  const bytes = await answer.arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  return { header, content: bytes.slice(4 + length) };
}

/** Request the radiograph for a page state. Return header and pixels (Uint16Array in row-major order). */
export async function radiograph(state) {
  const { header, content } = await latest("radiograph", "answer/radiograph", state, unpack);
  // The pixels are little-endian, which is the native byte order on all platforms with current browsers.
  return { header, pixels: new Uint16Array(content) };
}

export async function masks(state) {
  const { header, content } = await latest("masks", "answer/masks", state, unpack);
  return { ...header, bits: new Uint8Array(content) };
}

export async function probe(state) {
  return (await latest("probe", "answer/probe", state, unpack)).header;
}

export async function solids(state) {
  return (await latest("solids", "solids", state, (answer) => answer.json())).page;
}

export async function sampleKnee(request) {
  return (await send("draw", request)).json();
}

export async function file(state) {
  const answer = await send("file", { tab, ...state });
  const named = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "");
  return { name: named?.[1] ?? "pssf", blob: await answer.blob() };
}

export async function fields() {
  const answer = await fetch("fields");
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer.json();
}
