// A label as a list of strokes in the picture's own pixels (integer = pixel centre), and how to paint them. Pure but paint.

export const FACE_COLOURS = {
  front: "#4FC3F7", back: "#F29F05", left: "#FFF176", right: "#D98CC0", top: "#1FA97C", bottom: "#E4572E",
};
export const FACE_LETTERS = {front: "F", back: "B", left: "L", right: "R", top: "T", bottom: "U"};
export const WHITE = "#FFFFFF";
export const HALO = "#000000";
const INK = "#14181F";

/** Each face's corners in the order in which they run clockwise in the picture when the face is turned to the camera. */
const FACES = {
  front: ["front_top_left", "front_top_right", "front_bottom_right", "front_bottom_left"],
  back: ["back_top_right", "back_top_left", "back_bottom_left", "back_bottom_right"],
  left: ["back_top_left", "front_top_left", "front_bottom_left", "back_bottom_left"],
  right: ["front_top_right", "back_top_right", "back_bottom_right", "front_bottom_right"],
  top: ["back_top_left", "back_top_right", "front_top_right", "front_top_left"],
  bottom: ["front_bottom_left", "front_bottom_right", "back_bottom_right", "back_bottom_left"],
};

/** Twice the signed area; positive: clockwise on a screen (y down). */
export function area2(points) {
  return points.reduce((sum, [x, y], i) => {
    const [nx, ny] = points[(i + 1) % points.length];
    return sum + x * ny - nx * y;
  }, 0);
}

/** The box's twelve edges: {from, to, hidden}; hidden = both its faces look away. Edges behind the camera are left out. */
export function edges(corners) {
  const at = Object.fromEntries(corners.filter((c) => c.x !== null && c.y !== null).map((c) => [c.name, [c.x, c.y]]));
  const found = new Map();
  for (const names of Object.values(FACES)) {
    const points = names.map((name) => at[name]);
    const facing = points.every(Boolean) && area2(points) > 0;
    names.forEach((name, i) => {
      const pair = [name, names[(i + 1) % 4]].sort();
      if (!at[pair[0]] || !at[pair[1]]) return;
      const key = pair.join(" ");
      const known = found.get(key) ?? {from: at[pair[0]], to: at[pair[1]], hidden: true};
      found.set(key, {...known, hidden: known.hidden && !facing});
    });
  }
  return [...found.values()];
}

/** Everything to draw for a label; `show` has the switches K B W C D E P. `chosen`: the object drawn with weight. */
export function strokes(label, show, chosen = null) {
  if (!label) return [];
  const objects = label.objects ?? [];
  return [
    ...objects.flatMap((object) => ofObject(object, show, chosen === null || chosen === object.name)),
    ...(show.K ? (label.left_out ?? []).flatMap(leftOut) : []),
  ];
}

function ofObject(object, show, strong) {
  const width = strong ? 3 : 1.5;
  return [
    ...(show.P ? sides(object, width) : []),
    ...(show.B ? box(object, width) : []),
    ...(show.W && object.window ? [rectangle(object.window)] : []),
    ...(show.K ? object.sides.flatMap(marker) : []),
    ...(show.E ? rings(object) : []),
    ...chips(object, show),
  ];
}

function sides(object, width) {
  const seen = new Map(object.sides.map((side) => [side.class, side]));
  return [...seen.values()].filter((side) => side.polygon?.length > 2).flatMap((side) => {
    const colour = FACE_COLOURS[side.face] ?? WHITE;
    return [
      {kind: "line", points: side.polygon, closed: true, colour, width, fill: true},
      {kind: "chip", at: middle(side.polygon), text: FACE_LETTERS[side.face] ?? side.class, colour, centred: true, small: true},
    ];
  });
}

const box = (object, width) => edges(object.corners).map(({from, to, hidden}) => (
  {kind: "line", points: [from, to], colour: WHITE, width: hidden ? 1.5 : width * 0.75, dash: hidden ? [6, 6] : []}));

function rectangle({x_min, y_min, x_max, y_max}) {
  const points = [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]];
  return {kind: "line", points, closed: true, colour: WHITE, width: 1.5, dash: [10, 4, 2, 4]};
}

function marker(side) {
  const corners = side.marker_corners;
  return [
    {kind: "line", points: corners, closed: true, colour: WHITE, width: 1.5},
    {kind: "dot", at: corners[0], radius: 3.5, colour: WHITE},
    {kind: "chip", at: corners[2], text: String(side.marker), colour: WHITE, small: true},
  ];
}

function leftOut(left) {
  if (!left.corners) return [];
  return [
    {kind: "line", points: left.corners, closed: true, colour: "#F5B945", width: 1.5, dash: [3, 3]},
    {kind: "chip", at: left.corners[2], text: `${left.marker} not used`, colour: "#F5B945", small: true},
  ];
}

/** 1 σ of each corner, as large as it is; under two pixels of the screen it is drawn as two. */
function rings(object) {
  const sigma = object.quality?.uncertainty?.corners_px ?? [];
  return object.corners.flatMap((corner, i) =>
    corner.x === null || sigma[i] == null || !corner.in_image
      ? [] : [{kind: "ring", at: [corner.x, corner.y], radius: sigma[i], colour: WHITE}]);
}

function chips(object, show) {
  const lines = [];
  if (show.C) lines.push(object.name === object.type ? object.name : `${object.name} · ${object.type}`);
  const measure = [];
  if (show.D) measure.push(`${Math.round(object.distance_mm)} mm`);
  const sigma = object.quality?.uncertainty?.distance_mm;
  if (show.E && sigma != null) measure.push(`±${sigma < 0.05 ? "<0.1" : sigma < 1 ? sigma.toFixed(1) : Math.round(sigma)}${show.D ? "" : " mm"}`);
  if (measure.length) lines.push(measure.join(" "));
  if (show.C && object.quality?.ambiguous) lines.push("two poses fit");
  if (show.C && object.pose_source !== "measured") lines.push(object.pose_source);
  const window = object.window ?? object.window_unclipped;
  return lines.length ? [{kind: "chip", at: [window.x_min, window.y_min], text: lines.join("   "), colour: WHITE, above: true}] : [];
}

export function middle(points) {
  const n = points.length;
  return [points.reduce((sum, [x]) => sum + x, 0) / n, points.reduce((sum, [, y]) => sum + y, 0) / n];
}

/** A source pixel's centre on a canvas: without the half everything sits half a source pixel off. */
export const place = ([x, y], scale) => [(x + 0.5) * scale, (y + 0.5) * scale];

/** Paint on a context of `width` x `height` device pixels; `scale`: canvas px a source px; `ratio`: device px a CSS px. */
export function paint(context, list, {width, height, scale, ratio}) {
  context.clearRect(0, 0, width, height);
  context.lineJoin = context.lineCap = "round";
  const order = {area: 0, line: 1, ring: 2, dot: 3, chip: 4};
  for (const stroke of [...list].sort((a, b) => order[a.kind] - order[b.kind])) {
    if (stroke.kind === "area") area(context, stroke, scale);
    else if (stroke.kind === "line") line(context, stroke, scale, ratio);
    else if (stroke.kind === "chip") chip(context, stroke, {width, height, scale, ratio});
    else circle(context, stroke, scale, ratio);
  }
}

function line(context, {points, closed, colour, width, dash = [], fill}, scale, ratio) {
  context.beginPath();
  points.forEach((point, i) => context[i ? "lineTo" : "moveTo"](...place(point, scale)));
  if (closed) context.closePath();
  if (fill) {
    context.globalAlpha = 0.08;
    context.fillStyle = colour;
    context.fill();
    context.globalAlpha = 1;
  }
  context.setLineDash(dash.map((part) => part * ratio));
  stroke(context, width, colour, ratio);
  context.setLineDash([]);
}

function area(context, {points, colour}, scale) {
  context.beginPath();
  points.forEach((point, i) => context[i ? "lineTo" : "moveTo"](...place(point, scale)));
  context.globalAlpha = 0.22;
  context.fillStyle = colour;
  context.fill();
  context.globalAlpha = 1;
}

function circle(context, {kind, at, radius, colour}, scale, ratio) {
  const [x, y] = place(at, scale);
  context.beginPath();
  context.arc(x, y, kind === "ring" ? Math.max(radius * scale, 2 * ratio) : radius * ratio, 0, 2 * Math.PI);
  if (kind === "ring") return stroke(context, 1.5, colour, ratio);
  stroke(context, 1, HALO, ratio);
  context.fillStyle = colour;
  return context.fill();
}

function stroke(context, width, colour, ratio) {
  context.strokeStyle = HALO;
  context.lineWidth = (width + 3) * ratio;
  context.globalAlpha = 0.65;
  context.stroke();
  context.globalAlpha = 1;
  context.strokeStyle = colour;
  context.lineWidth = width * ratio;
  context.stroke();
}

function chip(context, {at, text, colour, centred, above, small}, {width, height, scale, ratio}) {
  const narrow = Math.min(1, Math.max(0.7, width / ratio / 640));
  const size = (small ? 12 : 15) * ratio * narrow;
  context.font = `600 ${size}px system-ui, sans-serif`;
  const [w, h] = [context.measureText(text).width + size * 0.8, size * 1.45];
  let [x, y] = place(at, scale);
  if (centred) [x, y] = [x - w / 2, y - h / 2];
  else if (above) y -= h + 6 * ratio;
  x = Math.min(Math.max(x, 2), Math.max(2, width - w - 2));
  y = Math.min(Math.max(y, 2), Math.max(2, height - h - 2));
  context.fillStyle = colour;
  context.beginPath();
  context.roundRect(x, y, w, h, 3 * ratio);
  context.strokeStyle = HALO;
  context.lineWidth = 1.5 * ratio;
  context.stroke();
  context.fill();
  context.fillStyle = INK;
  context.textBaseline = "middle";
  context.fillText(text, x + size * 0.4, y + h / 2 + size * 0.05);
}
