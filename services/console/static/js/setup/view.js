// Set-up: done once and forgotten, so it is a checklist: cameras, calibration, objects, markers seen.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {span, timeOfDay} from "../format.js";
import {FACE_COLOURS, FACE_LETTERS} from "../live/overlay.js";
import {Stage} from "../live/stage.js";
import {route} from "../route.js";
import {Calibrate} from "./calibrate.js";

const FROM = {
  calibration: ["check", "calibrated", true], factory: ["check", "the factory's calibration", true], truth: ["check", "rendered, so it is exact", true],
  guess: ["triangle-alert", "not calibrated: distances are guesses", false],
};

const UNKNOWN = ["circle-alert", "not known yet", false];

function camerasNow() {
  const known = state.topics.status.value?.cameras ?? {};
  return state.cameras.value.map((name) => ({name, rig: state.rig.value?.cameras.find((one) => one.name === name), now: known[name]}));
}

function markersOf(object) {
  return object.sides.flatMap((side) => side.markers.map((marker) => ({...marker, side})));
}

/** A camera that is still being opened knows nothing of its intrinsics. */
const isGuess = (now) => Boolean(now) && now.phase !== "opening" && !FROM[now.calibration]?.[2];

const seenAt = (id) => state.topics.status.value?.markers_seen?.[id] ?? null;

function Check({n, title, ok, text}) {
  return html`<li class="panel check" data-ok=${String(ok)}><span class="step number" aria-hidden="true">${n}</span><div><h2>${title}</h2>
    <p class=${ok ? "good" : "warn"}><${Icon} name=${ok ? "check" : "triangle-alert"} /> ${text}</p></div></li>`;
}

function Checklist({cameras, markers}) {
  const away = cameras.filter((one) => !one.now?.present);
  const guessed = cameras.filter((one) => isGuess(one.now));
  const objects = state.rig.value?.objects ?? [];
  const seen = markers.filter((one) => seenAt(one.id));
  return html`<ol class="checks">
    <${Check} n="1" title="Cameras" ok=${!away.length && cameras.length > 0} text=${away.length ? `${away.map((one) => one.name).join(", ")} away` : `${cameras.length} here`} />
    <${Check} n="2" title="Calibration" ok=${!guessed.length} text=${guessed.length ? `missing for ${guessed.map((one) => one.name).join(", ")}` : "all calibrated"} />
    <${Check} n="3" title="Objects" ok=${objects.length > 0} text=${objects.length ? objects.map((one) => one.name).join(", ") : "none in the rig file"} />
    <${Check} n="4" title="Markers seen" ok=${seen.length === markers.length && markers.length > 0} text=${`${seen.length} of ${markers.length}`} /></ol>`;
}

function Camera({name, rig, now}) {
  const [icon, words, ok] = (now?.phase !== "opening" && FROM[now?.calibration]) || UNKNOWN;
  const {file, verdict, reasons, focal_percent: percent} = rig?.calibration ?? {};
  return html`<li class="panel camera"><${Stage} id=${`setup-${name}`} camera=${name} />
    <div class="stack"><h3>${name}</h3>
    <p>${now?.present ? html`<span class="good"><${Icon} name="check" /> ${now.phase}</span>` : html`<span class="warn"><${Icon} name="triangle-alert" /> ${now?.last_error ?? "no word from it yet"}</span>`}</p>
    <dl class="facts-list small"><dt>Driver</dt><dd>${now?.driver ?? rig?.driver}</dd>
      <dt>Picture</dt><dd class="number">${now ? `${now.width}×${now.height} at ${now.fps}/s${now.depth ? ", with depth" : ""}` : "–"}</dd>
      ${now?.serial && html`<dt>Serial</dt><dd><code>${now.serial}</code></dd>`}
      <dt>Calibration</dt><dd><span class=${ok ? "good" : "warn"}><${Icon} name=${icon} /> ${words}</span>${file && html`<br /><code>${file}</code>`}</dd>
      ${verdict && html`<dt>Verdict</dt><dd class=${verdict === "good" ? "good" : "warn"}>${verdict}${percent ? `, distances sure to ${percent.toFixed(2)} %` : ""}
        ${reasons.map((one) => html`<br /><span class="muted">${one}</span>`)}</dd>`}</dl>
    <p><a class="button" href=${`/setup?calibrate=${encodeURIComponent(name)}`}>${isGuess(now) ? "Calibrate it, about 3 minutes" : "Calibrate"}<span class="visually-hidden"> ${name}</span></a></p></div></li>`;
}

function ObjectCard({object}) {
  const {width, height, depth} = object.size_mm;
  const markers = markersOf(object);
  const seen = markers.filter((one) => seenAt(one.id)).length;
  return html`<section class="panel stack"><div class="row spread"><h3>${object.name}</h3>
      <span class="muted number">${object.type} · ${width}×${height}×${depth} mm · ${seen} of ${markers.length} seen</span></div>
    <div class="scroll" tabindex="0" role="region" aria-label=${`Markers of ${object.name}`}><table class="markers"><thead><tr><th scope="col">Marker</th><th scope="col">Side</th><th scope="col">Size</th><th scope="col">Seen</th></tr></thead>
    <tbody>${markers.map(({id, size_mm, side}) => html`<tr><th scope="row" class="number">${id}</th>
      <td><b class="face" style=${{background: FACE_COLOURS[side.face]}}>${FACE_LETTERS[side.face]}</b> ${side.class}</td><td class="number">${size_mm} mm</td>
      <td>${seenAt(id) ? html`<span class="good"><${Icon} name="check" /> ${ago(seenAt(id))}</span>`
        : html`<span class="warn"><${Icon} name="circle-alert" /> not yet. Is it printed and not glossy?</span>`}</td></tr>`)}</tbody></table></div></section>`;
}

function ago(iso) {
  const seconds = (state.now.value - Date.parse(iso)) / 1000;
  return seconds < 3 ? "now" : seconds < 3600 ? `${span(seconds)} ago` : timeOfDay(iso);
}

export function Setup() {
  const {calibrate} = route.value.query;
  if (calibrate) return html`<${Calibrate} key=${calibrate} camera=${calibrate} />`;
  const cameras = camerasNow();
  const objects = state.rig.value?.objects ?? [];
  const markers = objects.flatMap(markersOf);
  return html`<h1 class="visually-hidden">Set-up</h1><div class="stack">
    <${Checklist} cameras=${cameras} markers=${markers} />
    <section class="stack" aria-labelledby="cameras-title"><h2 id="cameras-title">Cameras</h2>
      <ul class="cards">${cameras.map((one) => html`<${Camera} key=${one.name} ...${one} />`)}</ul></section>
    <section class="stack" aria-labelledby="objects-title"><h2 id="objects-title">Objects and their markers${" "}
      ${state.rig.value && html`<span class="muted small">${state.rig.value.markers?.family}</span>`}</h2>
      <div class="objects">${objects.map((object) => html`<${ObjectCard} key=${object.name} object=${object} />`)}</div></section>
  </div>`;
}
