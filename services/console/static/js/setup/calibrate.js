// Set-up's guided calibration: the live picture with the ghost of the next pose, what is there, the verdict.
import {useEffect, useRef} from "preact/hooks";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {local} from "../actions.js";
import {getJson, post} from "../api.js";
import {hint, shortcuts} from "../keys.js";
import {Stage} from "../live/stage.js";
import {keepFocus} from "../live/record.js";
import {go} from "../route.js";
import {sound} from "../sound.js";
import {BoardForm} from "./board.js";
import {ghostStrokes, tilts, verdictWords} from "./ghost.js";

const LOOK_MS = 15000;
const LEAST = 10;
const BUSY = ["starting", "guiding", "finishing", "stopping"];

const told = () => state.topics.calibration.value;
const capital = (text) => text.slice(0, 1).toUpperCase() + text.slice(1).replaceAll(/(iew-\d+)\.png/g, "$1");

const sentence = (text) => capital(text).replace(/([^.…!?])$/, "$1.");

async function send(what, fields) {
  const answer = await post(`/api/calibration/${what}`, fields);
  return answer.ok ? null : answer.error.message;
}

async function order(what) {
  const problem = await send(what);
  if (problem) state.tell(capital(problem));
}

/** Keys, the lease, and what is heard: while this view is on the page. */
function useCalibration(camera) {
  useEffect(() => {
    const look = () => document.visibilityState === "visible" && BUSY.includes(told()?.phase) && send("look");
    const timer = setInterval(look, LOOK_MS);
    Object.assign(local, {take: () => order("take"), "calibrate.drop": () => order("drop"), "calibrate.finish": () => order("finish"), back: () => go("/setup")});
    return () => {
      clearInterval(timer);
      for (const name of ["take", "calibrate.drop", "calibrate.finish", "back"]) delete local[name];
    };
  }, [camera]);
  const seen = useRef(null);
  const guidance = told()?.guidance;
  useEffect(() => {
    const before = seen.current;
    seen.current = guidance;
    if (!before || !guidance) return;
    // Counted, not heard: between two states that reach the page the guide may have said more than one thing.
    const dropped = guidance.dropped > before.dropped;
    if (dropped) state.say("The last view is dropped.");
    if (before.words === guidance.words) return;
    if (guidance.views > before.views) sound("saved");
    if (guidance.phase === "refused" && before.phase !== "refused") sound("refused");
    if (!dropped && ["taken", "refused", "done"].includes(guidance.phase)) state.say(capital(guidance.words));
  }, [guidance]);
  const verdict = told()?.result?.verdict;
  useEffect(() => {
    if (!verdict) return;
    state.say(`Calibration of ${camera}: ${told().result.sentence}`);
    getJson("/api/rig").then(({ok, body}) => { if (ok) state.rig.value = body; });
  }, [verdict]);
}

/** What to do, large; what is off, below it: the guide puts a colon between them. */
function Say({phase, text}) {
  const [todo, ...more] = text.replace("; next: ", ": next: ").split(": ");
  return html`<p class="say" data-phase=${phase}>${capital(todo)}${more.length > 0 && html`<span>${capital(more.join(": "))}</span>`}</p>`;
}

function Words({phase, guidance, progress}) {
  if (phase === "starting") return html`<${Say} text="Getting ready…" />`;
  if (phase === "stopping") return html`<${Say} text="Ending; what was taken is kept." />`;
  if (phase === "finishing") {
    return html`<${Say} text="Comparing lens models…" /><progress class="models" max=${progress?.total ?? 1} value=${progress?.done ?? 0} aria-label="Comparing lens models" />`;
  }
  return html`<${Say} phase=${guidance?.phase} text=${guidance?.words ?? "Show the board to the camera."} />
    <label class="hold small muted">Hold still<progress max="1" value=${guidance?.held ?? 0} aria-label="How long the board has been held still" /></label>`;
}

function Have({guidance}) {
  const count = guidance?.views ?? 0;
  const share = Math.round((guidance?.covered ?? 0) * 100);
  return html`<div class="have">
    <p class="verdict-words small"><${Icon} name="circle-alert" /> ${sentence(verdictWords(guidance))}</p>
    <p><b class="figure number" data-views=${count}>${count}</b> <span class="muted">of ${LEAST} views</span></p>
    <p><b class="figure number">${share} %</b> <span class="muted">covered</span></p>
    <table class="tilts"><caption class="small muted">Tilts: the board looks</caption><thead><tr>${tilts(guidance).map(({words}) => html`<th scope="col" key=${words}>${words}</th>`)}</tr></thead>
      <tbody><tr>${tilts(guidance).map(({words, have, wanted}) => html`<td key=${words} class=${have >= wanted ? "number good" : "number warn"}><${Icon} name=${have >= wanted ? "check" : "circle"} />${have}/${wanted}</td>`)}</tr></tbody></table></div>`;
}

function Order({what, words, primary = false, disabled = false}) {
  const name = what === "take" ? "take" : `calibrate.${what}`;
  return html`<button class=${primary ? "take" : "button"} data-phase="ready" disabled=${disabled} aria-keyshortcuts=${shortcuts(name)}
    title=${`${words} (${hint(name)})`} onPointerDown=${keepFocus} onClick=${() => order(what)}>${primary && html`<${Icon} name="circle" />`}<span>${words}</span>
    ${primary && !disabled && html`<kbd>${hint(name)}</kbd>`}</button>`;
}

function Running({phase, guidance, progress}) {
  const deaf = phase !== "guiding";
  return html`<div class="doing stack"><${Words} phase=${phase} guidance=${guidance} progress=${progress} />
    <${Order} what="take" words="Take view" primary=${true} disabled=${deaf} />
    <div class="row orders"><${Order} what="drop" words="Drop last" disabled=${deaf || !guidance?.views} />
      <${Order} what="finish" words="Finish" disabled=${deaf || !guidance?.views} />
      <button class="button" disabled=${phase === "stopping"} onClick=${() => order("stop")} title="What was taken is kept">End</button></div></div>
    <${Have} guidance=${guidance} />`;
}

const TITLES = {good: "Good", usable: "Usable", "not yet": "Not yet"};

function Result({camera, result, again}) {
  const {verdict, error} = result;
  const fine = verdict === "good" || verdict === "usable";
  if (!verdict) {
    return html`<p class="say"><${Icon} name=${error.code === "interrupted" ? "square" : "triangle-alert"} /> ${sentence(error.message)}</p>
      <button class="button primary" onClick=${again}>Calibrate ${camera}</button>`;
  }
  const figures = [["Views", result.views], ["Distances sure to", result.focal_percent && `${result.focal_percent.toFixed(2)} %`],
    ["Held-out error", result.held_out_px && `${result.held_out_px.toFixed(2)} px`], ["Picture covered", result.covered_percent && `${Math.round(result.covered_percent)} %`],
    ["File", result.file && html`<code>${result.file}</code>`]];
  return html`<p class=${`level ${fine ? "good" : "warn"}`}><${Icon} name=${verdict === "good" ? "check" : "triangle-alert"} /> ${TITLES[verdict]}</p>
    <ul class="reasons">${result.reasons.map((words) => html`<li key=${words}>${sentence(words)}</li>`)}</ul>
    <dl class="facts-list small">${figures.filter(([, value]) => value).map(([name, value]) => html`<dt>${name}</dt><dd class="number">${value}</dd>`)}</dl>
    ${!fine && html`<p class="small">No file was written. The views are kept: go on with them.</p>`}
    <ul class="small muted reasons">${[...result.left_out.map((one) => `left out: ${one}`), ...result.notes].map((words) => html`<li key=${words}>${sentence(words)}</li>`)}</ul>
    <div class="row orders"><a class="button" href="/api/calibration/report" download><${Icon} name="activity" />Report</a>
      <button class="button" onClick=${again}>Calibrate again</button></div>`;
}

/** The view `/setup?calibrate=cam0`. */
export function Calibrate({camera}) {
  useCalibration(camera);
  const now = told();
  const mine = now?.camera === camera;
  const busy = BUSY.includes(now?.phase);
  const anew = state.calibrateAnew.value === camera;
  const guidance = mine && busy ? now.guidance : null;
  const start = async (fields) => {
    const problem = await send("start", fields);
    if (!problem) state.calibrateAnew.value = null;
    return problem && capital(problem);
  };
  return html`<div class="row spread"><h1>Calibrate ${camera}</h1><a class="button" href="/setup">Back to Set-up <kbd>Esc</kbd></a></div>
    <div class="live calibrate"><section class="pictures" aria-label="Picture"><figure class="bigpicture">
      <${Stage} id=${`calibrate-${camera}`} camera=${camera} extra=${ghostStrokes} guidance=${guidance} />
      <figcaption class="small muted">${guidance ? `Dashed blue: hold the board there. Green: covered already. ${guidance.size.join("×")}` : "What the camera sees."}</figcaption></figure></section>
    <section class="record panel" aria-labelledby="calibrate-title"><h2 id="calibrate-title" class="visually-hidden">What to do</h2>
      ${busy && !mine ? html`<p class="say">${now.camera} is being calibrated.</p><a class="button" href=${`/setup?calibrate=${now.camera}`}>Show it</a>`
        : busy ? html`<${Running} ...${now} />`
        : mine && now.result && !anew ? html`<${Result} camera=${camera} result=${now.result} again=${() => { state.calibrateAnew.value = camera; }} />`
        : html`<${BoardForm} camera=${camera} start=${start} />`}
    </section></div>`;
}
