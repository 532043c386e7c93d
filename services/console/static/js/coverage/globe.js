// The same map on a sphere round the object: drag it or use the arrow keys. It explains the table beside it.
import {useEffect, useRef} from "preact/hooks";
import {useSignal} from "@preact/signals";
import {html} from "../html.js";
import {level, project} from "./map.js";

const STEP_DEG = 10;
const TURN_DEG_PER_PX = 0.6;
const SIDES = [["F", 0], ["R", 90], ["B", 180], ["L", -90]];

export function Globe({coverage, now}) {
  const canvas = useRef();
  const view = useSignal({azimuth: 20, elevation: 22});
  const turn = (azimuth, elevation) => {
    const old = view.value;
    view.value = {azimuth: old.azimuth + azimuth, elevation: Math.max(-85, Math.min(85, old.elevation + elevation))};
  };
  const keys = {ArrowLeft: [-STEP_DEG, 0], ArrowRight: [STEP_DEG, 0], ArrowUp: [0, STEP_DEG], ArrowDown: [0, -STEP_DEG]};
  useEffect(() => { if (canvas.current) draw(canvas.current, coverage, now, view.value); });
  return html`<canvas class="globe" ref=${canvas} width="440" height="440" tabindex="0" role="img"
    aria-label="Sphere of the recorded views; the table beside it says the same. Arrow keys turn it."
    onKeyDown=${(event) => { if (keys[event.key]) { event.preventDefault(); turn(...keys[event.key]); } }}
    onPointerDown=${(event) => event.currentTarget.setPointerCapture(event.pointerId)}
    onPointerMove=${(event) => { if (event.buttons) turn(-event.movementX * TURN_DEG_PER_PX, event.movementY * TURN_DEG_PER_PX); }} />`;
}

const colour = (style, name) => style.getPropertyValue(name).trim();

function draw(canvas, {bins, counts, wanted}, now, view) {
  const context = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  const radius = canvas.width / 2 - 24;
  const at = (azimuth, elevation) => {
    const [x, y, z] = project(azimuth, elevation, view);
    return [canvas.width / 2 + radius * x, canvas.height / 2 - radius * y, z];
  };
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.beginPath();
  context.arc(canvas.width / 2, canvas.height / 2, radius, 0, 2 * Math.PI);
  context.fillStyle = colour(style, "--sunken");
  context.fill();
  counts.forEach((line, row) => line.forEach((count, column) => {
    const outline = patch(bins, row, column).map(([a, e]) => at(a, e));
    if (outline.every(([, , z]) => z < 0)) return;
    context.beginPath();
    outline.filter(([, , z]) => z > -0.15).forEach(([x, y], i) => context[i ? "lineTo" : "moveTo"](x, y));
    context.closePath();
    const open = wanted?.[row]?.[column] ?? true;
    context.fillStyle = colour(style, open ? `--cover-${level(count)}` : "--sunken");
    context.fill();
    context.strokeStyle = colour(style, open ? "--line" : "--hair");
    context.lineWidth = 1;
    context.stroke();
  }));
  letters(context, at, colour(style, "--text"), colour(style, "--surface"));
  if (now) here(context, at(now.azimuth, now.elevation), colour(style, "--text"), colour(style, "--surface"));
}

/** A cell's outline in steps, so that its edges bend. */
function patch({azimuth, elevation}, row, column) {
  const [a0, a1, e0, e1] = [azimuth[column], azimuth[column + 1], elevation[row], elevation[row + 1]];
  const steps = [0, 1, 2, 3, 4].map((i) => i / 4);
  return [
    ...steps.map((t) => [a0 + (a1 - a0) * t, e0]), ...steps.map((t) => [a1, e0 + (e1 - e0) * t]),
    ...steps.map((t) => [a1 + (a0 - a1) * t, e1]), ...steps.map((t) => [a0, e1 + (e0 - e1) * t]),
  ];
}

function letters(context, at, ink, ground) {
  context.font = "700 20px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const [letter, azimuth] of SIDES) {
    const [x, y, z] = at(azimuth, 0);
    if (z < 0.1) continue;
    context.fillStyle = ground;
    context.beginPath();
    context.arc(x, y, 15, 0, 2 * Math.PI);
    context.fill();
    context.fillStyle = ink;
    context.fillText(letter, x, y + 1);
  }
}

function here(context, [x, y, z], ink, ground) {
  context.setLineDash(z < 0 ? [4, 4] : []);
  for (const [radius, width, style] of [[15, 8, ground], [15, 4, ink], [4, 8, ground], [4, 5, ink]]) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.strokeStyle = style;
    context.lineWidth = width;
    context.stroke();
  }
  context.setLineDash([]);
}
