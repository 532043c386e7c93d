// What the page knows: signals fed by the socket, and the few settings a browser keeps.
import {batch, computed, effect, signal} from "@preact/signals";

/** connecting · open · lost · refused (why in connectionWhy). */
export const connection = signal("connecting");
export const connectionWhy = signal("");
export const topics = {
  status: signal(null), record: signal(null), labels: signal({}), coverage: signal({}),
  disk: signal(null), session: signal(null), auto: signal(null),
  calibration: signal(null),
};
export const rig = signal(null);
export const words = signal({});
export const notes = signal([]);
export const unread = signal(0);
/** The last news of any recording, for the polite region: {text, urgent}. */
export const spoken = signal({text: "", urgent: false});
export const toast = signal(null);
export const lastEvent = signal(0);
/** Bumped when samples came, went or returned: whoever shows a list asks again. */
export const samplesVersion = signal(0);
export const now = signal(Date.now());
/** What was asked for and has no answer yet: "waiting" for a picture that fits, then "record" or "start". */
export const asked = signal(null);
export const askedUntil = signal(0);
export const heldStill = signal(false);
/** Pictures as drawn, by view id: {camera, frame, boot, drawn_ms, label, fps, age_ms, reduced}. */
export const drawn = signal({});

function kept(name, initial) {
  let value = initial;
  try {
    const stored = JSON.parse(localStorage.getItem(`tagmill.${name}`));
    if (stored !== null) value = typeof initial === "object" ? {...initial, ...stored} : stored;
  } catch {
    // A browser that keeps nothing (or kept nonsense) gets the defaults.
  }
  const made = signal(value);
  effect(() => {
    const text = JSON.stringify(made.value);
    try { localStorage.setItem(`tagmill.${name}`, text); } catch { /* private window: kept for this page only */ }
  });
  return made;
}

export const theme = kept("theme", "auto");
export const overlays = kept("overlays", {on: true, K: true, B: true, W: false, C: true, D: true, E: true, P: true});
export const settings = kept("settings", {mode: "one", count: 5, every_s: 1, sound: true, singleKeys: true, tile: 200});
export const camera = kept("camera", "");
/** The board as it was described last. */
export const board = kept("board", {kind: "charuco"});
/** The camera for which another calibration shall begin although one has just ended. */
export const calibrateAnew = signal(null);
export const kind = signal("rgb");
export const split = signal(false);
export const divider = signal(50);

export const cameras = computed(() => {
  const known = Object.keys(topics.status.value?.cameras ?? {});
  const rigs = (rig.value?.cameras ?? []).map((one) => one.name);
  return [...new Set([...rigs, ...known])];
});

/** The camera in the big picture: the chosen one, or the first while "all" is chosen. */
export const bigCamera = computed(() =>
  cameras.value.includes(camera.value) ? camera.value : (cameras.value[0] ?? null));
export const allCameras = computed(() => camera.value === "all" && cameras.value.length > 1);

export const phase = computed(() => {
  if (connection.value !== "open" || !topics.record.value) return "unknown";
  if (["waiting", "record"].includes(asked.value) && topics.record.value.phase === "ready") return "asked";
  return topics.record.value.phase;
});

/** Durable samples of the open session. */
export const stored = computed(() => {
  const record = topics.record.value;
  const idle = record && !record.recording && record.count ? record.count : null;
  return topics.session.value?.stored ?? idle ?? topics.status.value?.services?.store?.numbers?.samples ?? null;
});

export function takeState(topic, data) {
  if (topic in topics) topics[topic].value = data;
}

/** A numbered event: into the notes, to the ear and to the screen reader. */
export function takeEvent(event) {
  batch(() => {
    lastEvent.value = Math.max(lastEvent.value, event.n ?? 0);
    notes.value = merged(notes.value, event);
    if (["saved", "deleted", "restored"].includes(event.kind)) samplesVersion.value += 1;
    else unread.value += 1;
    if (event.kind !== "saved") say(event.title, ["ended", "service_lost"].includes(event.kind));
  });
}

/** The same refusal again is one line with a count; saved samples are counted, not listed. */
function merged(list, event) {
  const first = list[0];
  if (first && first.kind === event.kind && first.title === event.title && event.kind !== "ended") {
    return [{...event, times: (first.times ?? 1) + 1}, ...list.slice(1)];
  }
  return [{...event, times: 1}, ...list].slice(0, 500);
}

export function say(text, urgent = false) {
  spoken.value = {text, urgent};
}

let toastTimer = 0;
/** A short line at the bottom; it is also kept in the notes where it matters. */
export function tell(text, action = null) {
  toast.value = {text, action};
  say(text);
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => { toast.value = null; }, 10000);
}

setInterval(() => { now.value = Date.now(); }, 500);
