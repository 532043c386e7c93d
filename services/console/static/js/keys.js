// One table of keys: it makes the handler, the dialog behind "?", the hints on buttons and aria-keyshortcuts. Pure.

/** key: event.key in lower case, "Space" and "Digit1" by code; scope: where it is active; shift/mod only where said. */
export const KEYS = [
  {key: "?", scope: "all", words: "show these keys", command: "keys"},
  {key: "Digit1", shown: "1", scope: "all", words: "Live", command: "view.live"},
  {key: "Digit2", shown: "2", scope: "all", words: "Coverage", command: "view.coverage"},
  {key: "Digit3", shown: "3", scope: "all", words: "Health", command: "view.health"},
  {key: "Digit4", shown: "4", scope: "all", words: "Set-up", command: "view.setup"},
  {key: "Digit5", shown: "5", scope: "all", words: "Gallery", command: "view.gallery"},
  {key: "/", scope: "all", words: "filter the gallery", command: "filter"},
  {key: "n", scope: "all", words: "notes", command: "notes"},
  {key: "escape", shown: "Esc", scope: "all", words: "close, go back, clear the selection", command: "back"},
  {key: "u", scope: "all", words: "undo the last sample", command: "undo"},
  {key: "z", mod: true, shown: "Ctrl Z", scope: "all", words: "undo the last sample", command: "undo"},
  {key: "x", scope: "all", words: "stop (it can only stop)", command: "stop"},
  {key: "Space", scope: "record", words: "take, start or stop: the big button", command: "take"},
  {key: "r", scope: "record", words: "the big button, wherever the focus is", command: "take"},
  {key: "m", scope: "record", words: "next way to record", command: "mode.next"},
  {key: "m", shift: true, shown: "Shift M", scope: "record", words: "the one before", command: "mode.previous"},
  {key: "+", scope: "record", words: "more samples a burst", command: "count.more"},
  {key: "-", scope: "record", words: "fewer samples a burst", command: "count.fewer"},
  {key: ".", scope: "record", words: "next camera", command: "camera.next"},
  {key: ",", scope: "record", words: "previous camera", command: "camera.previous"},
  {key: "Digit0", shown: "0", scope: "record", words: "all cameras", command: "camera.all"},
  {key: "Space", scope: "calibrate", words: "take a view now", command: "take"},
  {key: "r", scope: "calibrate", words: "take a view now, wherever the focus is", command: "take"},
  {key: "backspace", shown: "Backspace", scope: "calibrate", words: "drop the last view", command: "calibrate.drop"},
  {key: "enter", shown: "Enter", scope: "calibrate", words: "finish with the views that there are", command: "calibrate.finish"},
  {key: "h", scope: "live", words: "hold the picture still", command: "hold"},
  {key: "o", scope: "picture", words: "all overlays", command: "overlay.all"},
  {key: "k", scope: "picture", words: "markers", command: "overlay.K"},
  {key: "b", scope: "picture", words: "box", command: "overlay.B"},
  {key: "w", scope: "picture", words: "window", command: "overlay.W"},
  {key: "c", scope: "picture", words: "class", command: "overlay.C"},
  {key: "d", scope: "picture", words: "distance", command: "overlay.D"},
  {key: "e", scope: "picture", words: "uncertainty", command: "overlay.E"},
  {key: "p", scope: "picture", words: "sides", command: "overlay.P"},
  {key: "i", scope: "picture", words: "before | after", command: "split"},
  {key: "t", scope: "picture", words: "colour or depth", command: "depth"},
  {key: "f", scope: "picture", words: "full screen", command: "fullscreen"},
  {key: "arrowleft", shown: "←", scope: "grid", shift: null, words: "move (with Shift: extend)", command: "grid.left"},
  {key: "arrowright", shown: "→", scope: "grid", shift: null, words: "move", command: "grid.right"},
  {key: "arrowup", shown: "↑", scope: "grid", shift: null, words: "move", command: "grid.up"},
  {key: "arrowdown", shown: "↓", scope: "grid", shift: null, words: "move", command: "grid.down"},
  {key: "home", shown: "Home", scope: "grid", shift: null, words: "first", command: "grid.first"},
  {key: "end", shown: "End", scope: "grid", shift: null, words: "last", command: "grid.last"},
  {key: "enter", shown: "Enter", scope: "grid", words: "open", command: "grid.open"},
  {key: "Space", scope: "grid", words: "choose", command: "grid.choose"},
  {key: "a", mod: true, shown: "Ctrl A", scope: "grid", words: "choose all", command: "grid.all"},
  {key: "delete", shown: "Del", scope: "gallery", words: "to the bin", command: "gallery.delete"},
  {key: "v", scope: "gallery", words: "put back", command: "gallery.restore"},
  {key: "y", scope: "gallery", words: "copy the file name", command: "gallery.copy"},
  {key: "arrowleft", shown: "←", scope: "opened", words: "newer sample", command: "opened.previous"},
  {key: "arrowright", shown: "→", scope: "opened", words: "older sample", command: "opened.next"},
];

/** Which scopes are active together in a view. */
export const SCOPES = {
  live: ["all", "record", "live", "picture"],
  coverage: ["all", "record"],
  health: ["all"],
  setup: ["all"],
  calibrate: ["all", "calibrate"],
  gallery: ["all", "grid", "gallery"],
  opened: ["all", "gallery", "picture", "opened"],
};

export const SCOPE_TITLES = {
  all: "Everywhere", record: "Live and Coverage", live: "Live", calibrate: "Calibration", picture: "Picture", grid: "Gallery",
  gallery: "Chosen samples", opened: "Opened sample",
};

/** Signs of the table that some keyboards have on a digit's key: what is typed wins. */
const SIGNS = new Set(["?", "/", "+", "-", ".", ","]);
const TYPING = new Set(["input", "textarea", "select"]);
/** Inputs in which no letter is typed: radio and check boxes leave the letters to the page. */
const NOT_TYPING = new Set(["radio", "checkbox", "range", "button"]);

/** What is shown on a button: "Space", "K". */
export function hint(command) {
  const entry = KEYS.find((one) => one.command === command);
  return entry ? shown(entry) : "";
}

export const shown = (entry) => entry.shown ?? (entry.key.length === 1 ? entry.key.toUpperCase() : entry.key);

/** For aria-keyshortcuts: every key of a command. */
export const shortcuts = (command) =>
  [...new Set(KEYS.filter((one) => one.command === command).map((one) => shown(one).replace(" ", "+").replace("Ctrl", "Control")))].join(" ");

/** Latin letter by what is typed; on a Greek or Cyrillic keyboard, and for digits, by where the key is. */
export function nameOf(event) {
  const isDigit = /^Digit\d$/.test(event.code ?? "") && (!event.shiftKey || /^\d$/.test(event.key));
  if (isDigit && !SIGNS.has(event.key)) return event.code;
  if (event.code === "Space" || event.key === " ") return "Space";
  const key = event.key.toLowerCase();
  if (key.length === 1 && !/[\u0020-\u007e]/.test(key)) {
    const letter = /^Key([A-Z])$/.exec(event.code ?? "");
    return letter ? letter[1].toLowerCase() : key;
  }
  return key;
}

/**
 * The table's entry that an event means, or null. `event` has key, code, shiftKey, ctrlKey, altKey, metaKey, repeat,
 * isComposing and `target`: {tag, type, editable, focusVisible}.
 */
export function match(event, scopes, {singleKeys = true, dialogOpen = false} = {}) {
  if (event.isComposing || event.altKey || dialogOpen) return null;
  const target = event.target ?? {};
  const typing = target.editable || (TYPING.has(target.tag) && !NOT_TYPING.has(target.type));
  const mod = Boolean(event.ctrlKey || event.metaKey);
  const name = nameOf(event);
  if (typing && name !== "escape") return null;
  const found = KEYS.find((one) => one.key === name && scopes.includes(one.scope) && Boolean(one.mod) === mod && shiftFits(one, event));
  if (!found) return null;
  if (event.repeat && !found.command.startsWith("grid.")) return null;
  if (!singleKeys && !mod && name.length === 1) return null;
  if (isControlsOwn(name, target, found)) return null;
  return found;
}

/** Shift is part of "?" and "+" themselves; letters want it as the table says (null: either). */
function shiftFits(entry, event) {
  if (entry.shift === null || !/^[a-z]$/.test(entry.key)) return true;
  return Boolean(entry.shift) === Boolean(event.shiftKey);
}

/** Space, Enter and arrows belong to a control that was reached with Tab; arrows always to radios and sliders. */
function isControlsOwn(name, target, entry) {
  if (name.startsWith("arrow") && (target.type === "radio" || target.type === "range")) return true;
  if (name !== "Space" && name !== "enter") return false;
  if (entry.scope === "grid" && target.role === "gridcell") return false;
  return Boolean(target.focusVisible) && ["button", "a", "input", "summary"].includes(target.tag);
}
