// The stream of messages: one fetch without end, repeated whenever it ends.

const AGAIN_MS = 1000;

/** Split the received bytes into whole messages, each {head, body}, and the rest. */
export function cut(bytes) {
  const found = [];
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  while (at + 8 <= bytes.length) {
    const rest = view.getUint32(at, true), size = view.getUint32(at + 4, true), end = at + 4 + rest;
    if (end > bytes.length) break;
    const head = JSON.parse(new TextDecoder().decode(bytes.subarray(at + 8, at + 8 + size)));
    found.push({ head, body: bytes.slice(at + 8 + size, end) });
    at = end;
  }
  return { found, rest: bytes.slice(at) };
}

/** Follow the stream for as long as the page is open. */
export async function follow(token, onMessage, onGone) {
  for (;;) {
    try {
      await once(token, onMessage);
      onGone("");
    } catch (error) {
      onGone(error instanceof Refused ? error.message : "");
    }
    await new Promise((done) => setTimeout(done, AGAIN_MS));
  }
}

class Refused extends Error {}

async function once(token, onMessage) {
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  const answer = await fetch("stream", { headers, cache: "no-store" });
  if (!answer.ok) throw new Refused((await answer.text()).trim());
  const reader = answer.body.getReader();
  let waiting = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const all = new Uint8Array(waiting.length + value.length);
    all.set(waiting);
    all.set(value, waiting.length);
    const { found, rest } = cut(all);
    waiting = rest;
    for (const { head, body } of found) onMessage(head, body);
  }
}
