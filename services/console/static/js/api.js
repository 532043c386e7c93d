// REST: every command of the socket has its address here, and each call its answer.

const QUICK_MS = 10000;

async function ask(path, options = {}, timeout_ms = QUICK_MS) {
  try {
    const response = await fetch(path, {...options, signal: AbortSignal.timeout(timeout_ms)});
    const body = await response.json().catch(() => null);
    return {ok: response.ok, status: response.status, body};
  } catch {
    return {ok: false, status: 0, body: null};
  }
}

export const getJson = (path) => ask(path);

/** One command; the answer as the command socket gave it, or a refusal in the same form. */
export const command = (name, fields = {}, timeout_ms = QUICK_MS) => post(`/api/commands/${name}`, fields, timeout_ms);

/** JSON to an address of the console; its answer, or a refusal in the same form. */
export async function post(path, fields = {}, timeout_ms = QUICK_MS) {
  const {body} = await ask(path, {
    method: "POST",
    headers: {"content-type": "application/json"},
    body: JSON.stringify(fields),
  }, timeout_ms);
  if (body && typeof body.ok === "boolean") return body;
  const message = body?.error?.message ?? "No answer from tagmill. Is it running?";
  return {ok: false, error: {code: body?.error?.code ?? "no_answer", message}};
}

/** A picture of a sample, as an address. */
export const sampleUrl = (name, kind, bin = false) =>
  `/api/samples/${encodeURIComponent(name)}/${kind}${bin ? "?bin=1" : ""}`;
