// The next pose to hold as a drawn ghost, the board as it is seen, the covered cells: strokes for the overlay. Pure.

export const GHOST = "#4FC3F7";
const SEEN = {taken: "#5DD39E", holding: "#FFF176", refused: "#F5B945"};
const COVERED = "#1FA97C";
const LINES = 4;

/** Maps the unit square to a quadrilateral TL TR BR BL as a camera would (Heckbert 1989, projective mapping). */
export function projective([[x0, y0], [x1, y1], [x2, y2], [x3, y3]]) {
  const [dx1, dx2, dx3] = [x1 - x2, x3 - x2, x0 - x1 + x2 - x3];
  const [dy1, dy2, dy3] = [y1 - y2, y3 - y2, y0 - y1 + y2 - y3];
  const area = dx1 * dy2 - dx2 * dy1;
  const g = area ? (dx3 * dy2 - dx2 * dy3) / area : 0;
  const h = area ? (dx1 * dy3 - dx3 * dy1) / area : 0;
  return ([u, v]) => {
    const w = g * u + h * v + 1;
    return [((x1 - x0 + g * x1) * u + (x3 - x0 + h * x3) * v + x0) / w, ((y1 - y0 + g * y1) * u + (y3 - y0 + h * y3) * v + y0) / w];
  };
}

/** The lines of a board's grid, so that the ghost looks as tilted as it is. */
function lattice(corners) {
  const to = projective(corners);
  return Array.from({length: LINES - 1}, (_, i) => (i + 1) / LINES).flatMap((at) => [
    {kind: "line", points: [to([at, 0]), to([at, 1])], colour: GHOST, width: 1},
    {kind: "line", points: [to([0, at]), to([1, at])], colour: GHOST, width: 1},
  ]);
}

/** Cells of the picture in which corners were seen. `cells`: rows of counts. */
export function covered(cells, [width, height]) {
  return cells.flatMap((row, j) => row.flatMap((count, i) => {
    if (!count) return [];
    const [x, y] = [(i * width) / row.length - 0.5, (j * height) / cells.length - 0.5];
    const [right, down] = [x + width / row.length, y + height / cells.length];
    return [{kind: "area", points: [[x, y], [right, y], [right, down], [x, down]], colour: COVERED}];
  }));
}

/** Everything that a guided calibration draws over the live picture. */
export function ghostStrokes(told) {
  if (!told) return [];
  const list = covered(told.cells ?? [], told.size);
  if (told.outline) list.push({kind: "line", points: told.outline, closed: true, colour: SEEN[told.phase] ?? "#FFFFFF", width: 2.5});
  if (!told.ghost) return list;
  const [top] = [...told.ghost].sort((a, b) => a[1] - b[1]);
  return [
    ...list, ...lattice(told.ghost),
    {kind: "line", points: told.ghost, closed: true, colour: GHOST, width: 3, dash: [10, 7], fill: true},
    {kind: "chip", at: top, text: "hold the board here", colour: GHOST, small: true, above: true},
  ];
}

const TILT_WORDS = {right: "right", left: "left", top: "up", bottom: "down", straight: "at you"};

/** What is there and what is wanted, as rows: {words, have, wanted}. */
export const tilts = (told) =>
  Object.entries(told?.tilts ?? {}).map(([way, have]) => ({words: TILT_WORDS[way] ?? way, have, wanted: told.tilts_wanted}));

/** The verdict in one sentence: of the newest fit, else what the views still lack. */
export function verdictWords(told) {
  if (!told) return "";
  if (told.code === "judging") return "Working out how good the calibration is…";
  if (told.lacks?.length) return `not yet, because ${told.lacks.join("; ")}`;
  return told.verdict ?? "the views are complete: the verdict follows";
}

/** Parts of a board's description: [name, words, kinds that have it, kind of input]. */
export const FIELDS = [
  ["columns", {chessboard: "Inner corners across", charuco: "Squares across", aprilgrid: "Tags across", "aruco-grid": "Tags across"}],
  ["rows", {chessboard: "Inner corners down", charuco: "Squares down", aprilgrid: "Tags down", "aruco-grid": "Tags down"}],
  ["square_mm", {chessboard: "Square, mm", charuco: "Square, mm"}],
  ["marker_mm", {charuco: "Marker, mm", aprilgrid: "Tag, mm", "aruco-grid": "Tag, mm"}],
  ["gap_mm", {aprilgrid: "Gap, mm", "aruco-grid": "Gap, mm"}],
  ["family", {charuco: "Family", aprilgrid: "Family", "aruco-grid": "Family"}],
];
const WHOLE = new Set(["columns", "rows"]);

/** The description that a filled form makes; what is empty is left out, so that the answer names it. */
export function described(kind, form) {
  const board = {kind};
  for (const [name, words] of FIELDS) {
    const text = String(form[name] ?? "").trim();
    if (!words[kind] || !text) continue;
    const number = Number(text.replace(",", "."));
    board[name] = name === "family" || Number.isNaN(number) ? text : WHOLE.has(name) ? Math.round(number) : number;
  }
  if (form.legacy && kind === "charuco") board.legacy = true;
  return board;
}

/** A board in a few words. */
export function boardWords(board) {
  const sizes = [["square_mm", "squares"], ["marker_mm", "markers"]].filter(([name]) => board[name]);
  return `${board.kind} ${board.columns}×${board.rows}${sizes.map(([name, words]) => `, ${words} ${board[name]} mm`).join("")}`;
}
