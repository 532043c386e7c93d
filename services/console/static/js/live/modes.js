// What the big button is and does, from what label and store report. Pure.

export const MODES = [
  {id: "one", title: "One", words: "one sample a press"},
  {id: "burst", title: "Burst", words: "so many, as fast as they fit"},
  {id: "every", title: "Every", words: "one sample every so often"},
  {id: "continuous", title: "Continuous", words: "each fitting frame until you stop"},
  {id: "auto", title: "Auto", words: "each new view, by itself"},
];

export const STATE_WORDS = {
  ready: "READY", asked: "WAITING", recording: "RECORDING", finishing: "SAVING", cannot: "CANNOT RECORD", unknown: "NO CONNECTION",
};

/** After a change of state presses are ignored for so long: a double click would start and stop. */
export const DEAF_MS = 700;

/** {text, shape, disabled, act, why}: act is take, start, stop, cancel or null; `waiting`: nothing was ordered yet. */
export function button(phase, mode, record, waiting = false) {
  switch (phase) {
    case "ready":
      return mode === "one" ? {text: "Take sample", shape: "circle", act: "take"} : {text: "Start", shape: "circle", act: "start"};
    case "asked":
      if (waiting) return {text: "Cancel", shape: "square", act: "cancel"};
      return {text: "Waiting for a picture that fits", shape: "circle", disabled: true, act: null};
    case "recording":
      return {text: "Stop", shape: "square", act: "stop"};
    case "finishing":
      return {text: `Saving ${record?.finishing || "the last"} more`, shape: "circle", disabled: true, act: null};
    case "cannot":
      return {text: record?.why?.title ?? "Recording is not possible now", shape: "triangle-alert", disabled: true, act: null};
    default:
      return {text: "No connection", shape: "unplug", disabled: true, act: null};
  }
}

/** The command that begins a recording of this mode: [name, fields]. */
export function startFields(settings, camera) {
  switch (settings.mode) {
    case "burst": return {camera, until_count: Math.max(1, Math.round(settings.count))};
    case "every": return {camera, every_s: Math.max(0.1, settings.every_s)};
    case "auto": return {camera, mode: "auto"};
    default: return {camera};
  }
}

/** The mode of a running recording, in words: "AUTO", "EVERY 1 S", "17 OF 50". */
export function modeWords(record) {
  if (!record?.recording) return "";
  if (record.until) return `${record.count} of ${record.until}`;
  if (record.mode === "auto") return "auto";
  return record.every_s > 0 ? `every ${record.every_s} s` : "continuous";
}

/** What stands under the button before it is pressed: {ok, text, todo}. */
export function canSay(record, cameras, words = {}) {
  const all = cameras.map((name) => record?.can?.[name]).filter(Boolean);
  const bad = all.find((one) => !one.ok);
  if (bad) return {ok: false, text: bad.title, todo: words[bad.code]?.what_to_do ?? bad.what_to_do ?? ""};
  return all.length ? {ok: true, text: all.map((one) => one.title).join("; "), todo: ""} : {ok: false, text: "No picture yet.", todo: ""};
}
