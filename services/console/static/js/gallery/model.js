// The gallery's list: filters as the command socket wants them, moving and choosing in a grid. Pure.
import {qualityWord} from "../format.js";

export const QUALITIES = {
  sharp: {words: "sharp: at most 0.5 px", filter: {max_reprojection_px: 0.5, ambiguous: false}},
  good: {words: "good: at most 1.5 px", filter: {max_reprojection_px: 1.5, ambiguous: false}},
  ambiguous: {words: "ambiguous", filter: {ambiguous: true}},
  incomplete: {words: "an object without pose", filter: {complete: false}},
  background: {words: "background", filter: {background: true}},
};

/** The `filter` field of the command `samples`, from the address's query. */
export function filterOf(query) {
  const filter = {...(QUALITIES[query.quality]?.filter ?? {})};
  for (const name of ["object", "side", "camera"]) if (query[name]) filter[name] = query[name];
  if (query.bin) filter.bin = true;
  return filter;
}

export const isFiltered = (query) => ["object", "side", "camera", "quality"].some((name) => query[name]);

/** Where the focus goes: `step` is left, right, up, down, first or last. */
export function move(at, step, columns, length) {
  const steps = {left: -1, right: 1, up: -columns, down: columns};
  if (step === "first") return 0;
  if (step === "last") return Math.max(0, length - 1);
  const next = at + steps[step];
  return next < 0 || next >= length ? at : next;
}

/** Everything from `anchor` to `at`, both included. */
export const between = (names, anchor, at) => names.slice(Math.min(anchor, at), Math.max(anchor, at) + 1);

/** The worst object's quality of a sample as a word and a number. */
export function quality(sample) {
  if (sample.background) return {word: "background", px: null};
  if (!sample.objects.length) return {word: "no object", px: null};
  const worst = sample.objects.reduce((a, b) => (b.ambiguous || b.reprojection_error_px > a.reprojection_error_px ? b : a));
  return {word: sample.complete ? qualityWord(worst) : "incomplete", px: worst.reprojection_error_px};
}
