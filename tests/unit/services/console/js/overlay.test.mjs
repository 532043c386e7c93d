import assert from "node:assert/strict";
import test from "node:test";
import {FACE_COLOURS, area2, edges, paint, place, strokes} from "../../../../../services/console/static/js/live/overlay.js";

const ALL = {K: true, B: true, W: true, C: true, D: true, E: true, P: true};
const NONE = {K: false, B: false, W: false, C: false, D: false, E: false, P: false};

/** A unit box seen by a pinhole from in front, to the right and above: (x right, y away, z up) → picture, y down. */
function corners(camera = [2, -5, 2]) {
  const forward = camera.map((n) => -n / Math.hypot(...camera));
  const right = [-forward[1], forward[0], 0].map((n) => -n / Math.hypot(forward[0], forward[1]));
  const up = [
    right[1] * forward[2] - right[2] * forward[1], right[2] * forward[0] - right[0] * forward[2], right[0] * forward[1] - right[1] * forward[0]];
  const dot = (a, b) => a.reduce((sum, n, i) => sum + n * b[i], 0);
  const all = [];
  for (const [face, y] of [["front", -0.5], ["back", 0.5]]) {
    for (const [row, x, z] of [["top_left", -0.5, 0.5], ["top_right", 0.5, 0.5], ["bottom_right", 0.5, -0.5], ["bottom_left", -0.5, -0.5]]) {
      const ray = [x, y, z].map((n, i) => n - camera[i]);
      const depth = dot(ray, forward);
      all.push({name: `${face}_${row}`, x: 320 + (500 * dot(ray, right)) / depth, y: 240 - (500 * dot(ray, up)) / depth, in_image: true});
    }
  }
  return all;
}

function object(changes = {}) {
  return {
    name: "box-1", type: "box", pose_source: "measured", distance_mm: 812.4, corners: corners(),
    window: {x_min: 10, y_min: 20, x_max: 110, y_max: 90}, window_unclipped: {x_min: 10, y_min: 20, x_max: 110, y_max: 90},
    sides: [{class: "front", face: "front", marker: 7, marker_corners: [[1, 2], [3, 2], [3, 4], [1, 4]], polygon: [[0, 0], [8, 0], [8, 8], [0, 8]]}],
    quality: {reprojection_error_px: 0.2, ambiguous: false, uncertainty: {distance_mm: 2.6, corners_px: [1, 1, 1, 1, 1, 1, 1, 1]}},
    ...changes,
  };
}

test("a box seen from the front, right and above has three hidden edges, all at its far corner", () => {
  const found = edges(corners());
  assert.equal(found.length, 12);
  const hidden = found.filter((edge) => edge.hidden);
  assert.equal(hidden.length, 3);
  const far = corners().find((corner) => corner.name === "back_bottom_left");
  for (const {from, to} of hidden) assert.ok([from, to].some(([x, y]) => x === far.x && y === far.y));
});

test("from behind, left and below the hidden corner is the opposite one", () => {
  const seen = corners([-2, 5, -2]);
  const far = seen.find((corner) => corner.name === "front_top_right");
  for (const {from, to} of edges(seen).filter((edge) => edge.hidden)) assert.ok([from, to].some(([x]) => x === far.x));
});

test("a box seen straight on hides everything but the front", () => {
  assert.equal(edges(corners([0, -5, 0])).filter((edge) => !edge.hidden).length, 4);
});

test("corners behind the camera take their edges with them", () => {
  const cut = corners().map((corner) => (corner.name === "front_top_left" ? {...corner, x: null, y: null} : corner));
  assert.equal(edges(cut).length, 9);
});

test("each switch draws its own part and nothing else", () => {
  const label = {objects: [object()], left_out: []};
  assert.deepEqual(strokes(label, NONE), []);
  const kinds = (letter) => strokes(label, {...NONE, [letter]: true}).map((stroke) => stroke.kind);
  assert.deepEqual(kinds("B"), Array(12).fill("line"));
  assert.deepEqual(kinds("W"), ["line"]);
  assert.deepEqual(kinds("K"), ["line", "dot", "chip"]);
  assert.deepEqual(kinds("P"), ["line", "chip"]);
  assert.deepEqual(kinds("C"), ["chip"]);
  assert.deepEqual(kinds("D"), ["chip"]);
  assert.deepEqual(kinds("E"), [...Array(8).fill("ring"), "chip"]);
});

test("a side has its colour and its letter, the marker a dot at its first corner", () => {
  const list = strokes({objects: [object()]}, ALL);
  const letter = list.find((stroke) => stroke.text === "F");
  assert.equal(letter.colour, FACE_COLOURS.front);
  assert.deepEqual(letter.at, [4, 4]);
  assert.deepEqual(list.find((stroke) => stroke.kind === "dot").at, [1, 2]);
  assert.ok(list.some((stroke) => stroke.text === "7"));
});

test("the chip says class, distance and uncertainty", () => {
  const text = (changes) => strokes({objects: [object(changes)]}, {...NONE, C: true, D: true, E: true}).at(-1).text;
  assert.match(text({}), /box-1 · box\s+812 mm ±3/);
  assert.match(text({quality: {ambiguous: true}}), /two poses fit/);
  assert.match(text({pose_source: "tracked"}), /tracked/);
});

test("two objects are told apart by weight, not by colour", () => {
  const label = {objects: [object(), object({name: "box-2"})]};
  const widths = new Set(strokes(label, {...NONE, P: true}, "box-2").filter((one) => one.kind === "line").map((one) => one.width));
  assert.deepEqual([...widths].sort(), [1.5, 3]);
});

test("no label, no strokes; a marker that was not used is drawn and named", () => {
  assert.deepEqual(strokes(null, ALL), []);
  const label = {objects: [], left_out: [{marker: 3, reason: "unknown_marker", corners: [[0, 0], [1, 0], [1, 1], [0, 1]]}, {marker: 4, reason: "not_detected"}]};
  assert.deepEqual(strokes(label, ALL).map((one) => one.text ?? one.kind), ["line", "3 not used"]);
});

test("pixels are counted at their centres", () => {
  assert.deepEqual(place([0, 0], 1), [0.5, 0.5]);
  assert.deepEqual(place([99.5, 9.5], 0.5), [50, 5]);
  assert.ok(area2([[0, 0], [1, 0], [1, 1], [0, 1]]) > 0);
});

test("painting gives every line a black halo under its colour and dashes only hidden edges", () => {
  const calls = [];
  const context = new Proxy({}, {
    get: (state, name) => (name in state ? state[name] : (...given) => {
      calls.push([name, ...given, state.strokeStyle]);
      return name === "measureText" ? {width: 10} : undefined;
    }),
    set: (state, name, value) => { state[name] = value; return true; },
  });
  paint(context, strokes({objects: [object()]}, {...NONE, B: true}), {width: 640, height: 480, scale: 1, ratio: 1});
  const strokesDrawn = calls.filter(([name]) => name === "stroke").map((call) => call.at(-1));
  assert.deepEqual(strokesDrawn.slice(0, 2), ["#000000", "#FFFFFF"]);
  const dashes = calls.filter(([name, dash]) => name === "setLineDash" && dash.length).length;
  assert.equal(dashes, 3);
});
