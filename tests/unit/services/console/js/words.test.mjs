import assert from "node:assert/strict";
import test from "node:test";
import {bars, level, nameOf, project, rows, sides} from "../../../../../services/console/static/js/coverage/map.js";
import {clock, count, qualityWord, span} from "../../../../../services/console/static/js/format.js";
import {between, filterOf, move, quality} from "../../../../../services/console/static/js/gallery/model.js";
import {MODES, STATE_WORDS, button, canSay, modeWords, startFields} from "../../../../../services/console/static/js/live/modes.js";

test("the big button says what it does in each state, and can be pressed only where that means something", () => {
  assert.deepEqual(["ready", "recording"].map((phase) => button(phase, "one", {}).act), ["take", "stop"]);
  assert.equal(button("ready", "every", {}).act, "start");
  for (const phase of ["asked", "finishing", "cannot", "unknown"]) {
    assert.ok(button(phase, "one", {why: {title: "The disk is full."}}).disabled);
    assert.equal(button(phase, "one", {}).act, null);
  }
  assert.equal(button("asked", "one", {}, true).act, "cancel", "what has not been ordered yet can be given up");
  assert.equal(button("cannot", "one", {why: {title: "The disk is full."}}).text, "The disk is full.");
  assert.deepEqual(Object.keys(STATE_WORDS).sort(), ["asked", "cannot", "finishing", "ready", "recording", "unknown"]);
});

test("each mode is one command's fields", () => {
  const settings = {count: 5, every_s: 0.01};
  assert.deepEqual(startFields({...settings, mode: "burst"}, "cam0"), {camera: "cam0", until_count: 5});
  assert.deepEqual(startFields({...settings, mode: "every"}, "cam0"), {camera: "cam0", every_s: 0.1});
  assert.deepEqual(startFields({...settings, mode: "auto"}, "all"), {camera: "all", mode: "auto"});
  assert.deepEqual(startFields({...settings, mode: "continuous"}, "cam0"), {camera: "cam0"});
  assert.equal(MODES.length, 5);
  assert.equal(modeWords({recording: "r", until: 50, count: 17}), "17 of 50");
  assert.equal(modeWords({recording: "r", mode: "auto"}), "auto");
  assert.equal(modeWords({recording: "r", mode: "all", every_s: 2}), "every 2 s");
});

test("what would stop a recording is said before the button is pressed", () => {
  const record = {can: {cam0: {ok: true, title: "box-1 in view"}, cam1: {ok: false, code: "no_object", title: "No object in view."}}};
  assert.deepEqual(canSay(record, ["cam0"]), {ok: true, text: "box-1 in view", todo: ""});
  const words = {no_object: {title: "", what_to_do: "Turn it."}};
  assert.deepEqual(canSay(record, ["cam0", "cam1"], words), {ok: false, text: "No object in view.", todo: "Turn it."});
  assert.equal(canSay(null, ["cam0"]).ok, false);
});

test("numbers and times read well", () => {
  assert.equal(count(38000), "38\u202f000");
  assert.equal(count(null), "–");
  assert.equal(clock(252.9), "00:04:12");
  assert.equal(span(4.2), "4 s");
  assert.equal(span(21 * 3600), "21 h");
  assert.equal(qualityWord({reprojection_error_px: 0.2, ambiguous: false}), "sharp");
  assert.equal(qualityWord({reprojection_error_px: 0.2, ambiguous: true}), "ambiguous");
  assert.equal(qualityWord({reprojection_error_px: 4, ambiguous: false}), "rough");
});

test("the map's rows run from the top down and mark the cell of now", () => {
  const coverage = {bins: {azimuth: [-180, 0, 180], elevation: [-90, 0, 90]}, counts: [[0, 1], [5, 9]], wanted: [[false, true], [true, true]]};
  const made = rows(coverage, [1, 0]);
  assert.deepEqual(made.map((row) => [row.from, row.to]), [[0, 90], [-90, 0]]);
  assert.deepEqual(made[0].cells.map((cell) => [cell.count, cell.level, cell.now]), [[5, 3, true], [9, 4, false]]);
  assert.deepEqual(made[1].cells.map((cell) => cell.wanted), [false, true]);
  assert.deepEqual([0, 1, 2, 3, 4, 7, 8].map(level), [0, 1, 2, 2, 3, 3, 4]);
});

test("columns are named by the side that is seen", () => {
  const edges = Array.from({length: 13}, (_, i) => -180 + 30 * i);
  const named = sides(edges);
  assert.equal(named.reduce((sum, one) => sum + one.span, 0), 12);
  assert.deepEqual(named.map((one) => one.name), ["back", "back left", "left", "front left", "front", "front right", "right", "back right", "back"]);
  assert.equal(nameOf(90), "right");
});

test("the histogram begins and ends where there is something", () => {
  const made = bars({edges_mm: [0, 100, 200, 300, 400, 500], counts: [0, 2, 0, 4, 0]}, 350);
  assert.deepEqual(made.map((bar) => [bar.from, bar.count, bar.now]), [[100, 2, false], [200, 0, false], [300, 4, true]]);
  assert.equal(made[2].share, 1);
});

test("the sphere turns the viewed direction to the front", () => {
  const [x, y, z] = project(40, 20, {azimuth: 40, elevation: 20});
  assert.ok(Math.abs(x) < 1e-9 && Math.abs(y) < 1e-9 && Math.abs(z - 1) < 1e-9);
  assert.ok(project(90, 0, {azimuth: 0, elevation: 0})[0] > 0.99, "the right side is on the right");
  assert.ok(project(0, 90, {azimuth: 0, elevation: 0})[1] > 0.99, "above is up");
});

test("the address's query becomes the command's filter", () => {
  assert.deepEqual(filterOf({object: "box-1", quality: "ambiguous", bin: "1", other: "x"}), {object: "box-1", ambiguous: true, bin: true});
  assert.deepEqual(filterOf({}), {});
});

test("moving in the grid stays inside it", () => {
  assert.equal(move(0, "left", 4, 10), 0);
  assert.equal(move(1, "down", 4, 10), 5);
  assert.equal(move(7, "down", 4, 10), 7);
  assert.equal(move(7, "last", 4, 10), 9);
  assert.deepEqual(between(["a", "b", "c", "d"], 3, 1), ["b", "c", "d"]);
});

test("a sample's quality is that of its worst object", () => {
  const object = (px, more) => ({reprojection_error_px: px, ambiguous: false, pose_source: "measured", ...more});
  assert.deepEqual(quality({complete: true, objects: [object(0.1), object(1.2)]}), {word: "good", px: 1.2});
  assert.equal(quality({complete: true, background: true, objects: []}).word, "background");
  assert.equal(quality({complete: false, objects: [object(0.1)]}).word, "incomplete");
});
