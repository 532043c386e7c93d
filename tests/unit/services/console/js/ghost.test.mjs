import assert from "node:assert/strict";
import test from "node:test";
import {FIELDS, boardWords, covered, described, ghostStrokes, projective, tilts, verdictWords} from "../../../../../services/console/static/js/setup/ghost.js";

const near = (a, b) => a.forEach((n, i) => assert.ok(Math.abs(n - b[i]) < 1e-9, `${a} is not ${b}`));
const QUAD = [[100, 50], [400, 90], [380, 300], [120, 260]];

test("the unit square's corners come to lie on the quadrilateral's, its diagonals meet where they cross", () => {
  const to = projective(QUAD);
  [[0, 0], [1, 0], [1, 1], [0, 1]].forEach((corner, i) => near(to(corner), QUAD[i]));
  const [x, y] = to([0.5, 0.5]);
  const on = ([ax, ay], [bx, by]) => (bx - ax) * (y - ay) - (by - ay) * (x - ax);
  assert.ok(Math.abs(on(QUAD[0], QUAD[2])) < 1e-6 && Math.abs(on(QUAD[1], QUAD[3])) < 1e-6);
});

test("a rectangle is divided evenly", () => near(projective([[0, 0], [8, 0], [8, 4], [0, 4]])([0.25, 0.5]), [2, 2]));

test("covered cells fill the picture from its first pixel's edge to its last one's", () => {
  const [first, last] = covered([[3, 0], [0, 1]], [640, 480]);
  assert.deepEqual(first.points[0], [-0.5, -0.5]);
  assert.deepEqual(last.points[2], [639.5, 479.5]);
  assert.equal(covered([[0, 0]], [640, 480]).length, 0);
});

test("ghost and board are drawn where the guide has them, and nothing without it", () => {
  assert.deepEqual(ghostStrokes(null), []);
  const told = {size: [640, 480], cells: [], phase: "holding", ghost: QUAD, outline: [[1, 1], [2, 1], [2, 2], [1, 2]]};
  const lines = ghostStrokes(told).filter((one) => one.kind === "line" && one.closed);
  assert.deepEqual(lines.map((one) => one.points), [told.outline, QUAD]);
  assert.ok(lines[1].dash.length, "the ghost is dashed, so that it differs by more than its colour");
  assert.deepEqual(ghostStrokes({...told, ghost: null, outline: null}), []);
});

test("the verdict says what is lacking as long as anything is", () => {
  assert.equal(verdictWords({lacks: ["a", "b"], verdict: "good"}), "not yet, because a; b");
  assert.equal(verdictWords({lacks: [], verdict: "usable, because c"}), "usable, because c");
  assert.match(verdictWords({lacks: [], verdict: null, code: "judging"}), /Working out/);
});

test("tilts are told with what is wanted", () => {
  assert.deepEqual(tilts({tilts: {right: 1, straight: 2}, tilts_wanted: 2}), [{words: "right", have: 1, wanted: 2}, {words: "at you", have: 2, wanted: 2}]);
});

test("a form becomes a description with the keys of its kind; a decimal comma is understood, nonsense stays for the answer", () => {
  const form = {columns: "8", rows: "6", square_mm: "30,5", marker_mm: "22", gap_mm: "7", family: "5x5_250", legacy: true};
  assert.deepEqual(described("charuco", form), {kind: "charuco", columns: 8, rows: 6, square_mm: 30.5, marker_mm: 22, family: "5x5_250", legacy: true});
  assert.deepEqual(described("chessboard", form), {kind: "chessboard", columns: 8, rows: 6, square_mm: 30.5});
  assert.deepEqual(described("aprilgrid", {...form, rows: "x"}), {kind: "aprilgrid", columns: 8, rows: "x", marker_mm: 22, gap_mm: 7, family: "5x5_250"});
  for (const [, words] of FIELDS) assert.ok(Object.keys(words).length);
  assert.equal(boardWords({kind: "chessboard", columns: 9, rows: 6, square_mm: 25}), "chessboard 9×6, squares 25 mm");
});
