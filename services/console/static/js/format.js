// Numbers and times as an operator reads them. Pure.

const DIGITS = new Intl.NumberFormat("en");

/** 38000 → "38 000": thin spaces, so that no locale's comma is read as a point. */
export const count = (n) => (n === null || n === undefined ? "–" : DIGITS.format(Math.round(n)).replaceAll(",", "\u202f"));

/** Seconds as a running clock: 00:04:12. */
export function clock(seconds) {
  const s = Math.max(0, Math.floor(seconds));
  return [s / 3600, (s / 60) % 60, s % 60].map((part) => String(Math.floor(part)).padStart(2, "0")).join(":");
}

/** How long, in one unit: "4 s", "3 min", "2 h". */
export function span(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return seconds < 172800 ? `${Math.round(seconds / 3600)} h` : `${Math.round(seconds / 86400)} days`;
}

/** The time of day of an ISO string, of seconds or of milliseconds since 1970. */
export function timeOfDay(when) {
  const date = typeof when === "number" ? new Date(when < 1e11 ? when * 1000 : when) : new Date(when);
  return Number.isNaN(date.getTime()) ? "–" : date.toLocaleTimeString("en-GB");
}

export const bytes = (n) =>
  n === null || n === undefined ? "–" : n >= 1e9 ? `${(n / 1e9).toFixed(1)} GB` : `${Math.round(n / 1e6)} MB`;

export const rate = (n) => (n === null || n === undefined ? "–" : n >= 100 ? String(Math.round(n)) : n.toFixed(1));

export const plural = (n, one, many = `${one}s`) => `${count(n)} ${n === 1 ? one : many}`;

/** The quality of an object's pose as one word: from its error in pixels and its ambiguity. */
export function qualityWord(object) {
  if (object.ambiguous) return "ambiguous";
  if (object.pose_source === "interpolated") return "interpolated";
  return object.reprojection_error_px <= 0.5 ? "sharp" : object.reprojection_error_px <= 1.5 ? "good" : "rough";
}
