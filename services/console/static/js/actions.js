// What keys and buttons do: one table of commands, so that both mean the same.
import * as state from "./state.js";
import {command} from "./api.js";
import {clock, plural, timeOfDay} from "./format.js";
import {MODES, DEAF_MS, button, startFields} from "./live/modes.js";
import {sound} from "./sound.js";
import {go} from "./route.js";

const RECORD_S = 5;
const STOP_MS = 60000;

let changed = 0;
let before = "";
/** Told by the app at each change of phase: from then on presses are ignored for a moment. */
export function phaseIs(phase) {
  if (phase !== before && before && ["recording", "finishing"].some((one) => one === phase || one === before)) changed = Date.now();
  before = phase;
}

/** The picture that the big button means: set by the Live view while it is on the page. */
export const bigPicture = {painter: null};

/** The big button, Space and R. */
export async function take() {
  if (Date.now() - changed < DEAF_MS) return;
  const {act} = button(state.phase.value, state.settings.value.mode, state.topics.record.value, state.asked.value === "waiting");
  if (act === "stop") await stop();
  else if (act === "cancel") cancel();
  else if (act === "start") await start();
  else if (act === "take") await one();
}

const WAIT_MS = 100;
let cancelled = false;

/** Give up waiting: no order has been given yet, so there is nothing to take back. */
export function cancel() {
  cancelled = true;
}

/** Until a frame of every wished camera would be taken; false where that didn't come in time, or was cancelled. */
async function fits(cameras, until) {
  const can = () => cameras.map((name) => state.topics.record.value?.can?.[name]).find((one) => !one?.ok);
  cancelled = false;
  if (!can()) return true;
  state.asked.value = "waiting";
  while (can() && !cancelled && Date.now() < until) await new Promise((done) => { setTimeout(done, WAIT_MS); });
  const reason = can();
  if (!reason) return true;
  if (!cancelled) refused({error: {code: reason.code, message: reason.title ?? "No picture yet."}});
  return false;
}

const wished = () => (state.allCameras.value ? "all" : state.bigCamera.value);

async function one() {
  if (state.asked.value) return;
  const camera = wished();
  const until = Date.now() + RECORD_S * 1000;
  state.askedUntil.value = until;
  const fitting = await fits(camera === "all" ? state.cameras.value : [camera], until);
  state.asked.value = fitting ? "record" : null;
  if (!fitting) return;
  const frame = camera === "all" ? null : bigPicture.painter?.fresh(300) ?? null;
  const fields = {camera, timeout_s: RECORD_S};
  let answer = await command("record", frame === null ? fields : {...fields, frame}, (RECORD_S + 10) * 1000);
  if (frame !== null && ["frame_gone", "frame_lost", "no_frame", "not_due"].includes(answer.error?.code)) {
    answer = await command("record", fields, (RECORD_S + 10) * 1000);
  }
  state.asked.value = null;
  if (!answer.ok) refused(answer);
}

async function start() {
  if (state.asked.value) return;
  state.asked.value = "start";
  const answer = await command("start", startFields(state.settings.value, wished()));
  state.asked.value = null;
  if (!answer.ok) refused(answer);
  else if (answer.missing?.length) state.tell(`Recording without ${answer.missing.join(", ")}: no picture from there.`);
}

/** Can only stop. */
export async function stop() {
  if (state.asked.value === "waiting") return cancel();
  const recording = state.topics.record.value?.recording;
  if (!recording) return undefined;
  const answer = await command("stop", {recording}, STOP_MS);
  if (!answer.ok && answer.error.code !== "no_recording") refused(answer);
  return undefined;
}

function refused(answer) {
  const known = state.words.value[answer.error.code];
  state.tell(known ? `${known.title} ${known.what_to_do}` : answer.error.message);
  sound("refused");
}

export async function undo() {
  const {last} = state.topics.record.value ?? {};
  const answer = await command("undo", last ? {camera: last.camera} : {});
  if (!answer.ok) return refused(answer);
  const [sample] = answer.samples;
  state.tell(last?.sample === sample ? `${timeOfDay(last.time)} ${last.camera} is in the bin.` : "The last sample is in the bin.",
    {text: "Put back", run: () => restore([sample])});
  return undefined;
}

export async function restore(samples) {
  const answer = await command("restore", {samples}, STOP_MS);
  if (!answer.ok) return refused(answer);
  state.tell(`${plural(samples.length, "sample")} put back.`);
  return true;
}

export async function remove(samples) {
  const answer = await command("delete", {samples}, STOP_MS);
  if (!answer.ok) return refused(answer);
  state.tell(`${samples.length} moved to the bin.`, {text: "Put back", run: () => restore(samples)});
  return true;
}

export function set(changes) {
  state.settings.value = {...state.settings.value, ...changes};
}

function stepMode(step) {
  const at = MODES.findIndex((mode) => mode.id === state.settings.value.mode);
  const next = MODES[(at + step + MODES.length) % MODES.length];
  set({mode: next.id});
  state.say(`Mode ${next.title}: ${next.words}`);
}

export const NEXT_COUNT = [1, 2, 3, 5, 10, 20, 50, 100, 200, 500, 1000];
function stepCount(step) {
  const {count} = state.settings.value;
  const next = step > 0 ? NEXT_COUNT.find((n) => n > count) : NEXT_COUNT.filter((n) => n < count).at(-1);
  if (next) set({count: next});
}

function stepCamera(step) {
  const all = state.cameras.value;
  if (!all.length) return;
  const at = all.indexOf(state.bigCamera.value);
  state.camera.value = all[(at + step + all.length) % all.length];
}

export function toggleOverlay(letter) {
  const shown = state.overlays.value;
  state.overlays.value = letter ? {...shown, on: true, [letter]: shown.on ? !shown[letter] : true} : {...shown, on: !shown.on};
}

export function toggleSplit() {
  state.split.value = !state.split.value;
  if (state.split.value) state.kind.value = "rgb";
}

export function toggleDepth() {
  state.kind.value = state.kind.value === "depth" ? "rgb" : "depth";
  if (state.kind.value === "depth") state.split.value = false;
}

function fullscreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.querySelector(".bigpicture")?.requestFullscreen?.();
}

/** Views add what only they can do (grid.*, opened.*) while they are on the page. */
export const local = {};

const COMMANDS = {
  take, stop, undo, fullscreen,
  "view.live": () => go("/live"), "view.coverage": () => go("/coverage"), "view.health": () => go("/health"),
  "view.setup": () => go("/setup"), "view.gallery": () => go("/gallery"),
  "mode.next": () => stepMode(1), "mode.previous": () => stepMode(-1),
  "count.more": () => stepCount(1), "count.fewer": () => stepCount(-1),
  "camera.next": () => stepCamera(1), "camera.previous": () => stepCamera(-1),
  "camera.all": () => { state.camera.value = "all"; },
  hold: () => { state.heldStill.value = !state.heldStill.value; },
  "overlay.all": () => toggleOverlay(null),
  split: toggleSplit, depth: toggleDepth,
};

export function run(name, event) {
  const found = local[name] ?? COMMANDS[name];
  if (found) return found(event);
  if (name.startsWith("overlay.")) return toggleOverlay(name.slice(-1));
  return undefined;
}

/** How long a recording runs, as the top bar shows it. */
export const runsFor = (record, now) => (record?.since ? clock((now - Date.parse(record.since)) / 1000) : "");
