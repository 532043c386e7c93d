// Health: sentences first, then the pipe with its losses where they happen, then numbers, then charts.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {bytes, count, rate, span, timeOfDay} from "../format.js";
import {Notes} from "../parts/notes.js";
import {Chart, Spark} from "./chart.js";
import {history, lostOf, rateOf, total} from "./history.js";

const HOUR_MS = 3600e3;
const STAGES = [["capture", "captured"], ["detect", "detected"], ["label", "labelled"], ["store", "stored"]];
const KIND_WORDS = {running: "running", starting: "starting", faulty: "faulty", draining: "ending", stopped: "stopped"};

/** What is wrong or was within the hour, in sentences. */
function sentences() {
  const status = state.topics.status.value;
  const found = [];
  for (const name of status?.missing ?? []) found.push({bad: true, text: `${name} is not running.`, todo: "Its supervisor starts it anew; if it stays away, look at its log."});
  for (const [name, service] of Object.entries(status?.services ?? {})) {
    if (service.phase === "faulty") found.push({bad: true, text: `${name}: ${service.last_error ?? "is faulty."}`});
  }
  for (const [name, camera] of Object.entries(status?.cameras ?? {})) {
    if (!camera.present) found.push({bad: true, text: `${name} sends no pictures. ${camera.last_error ?? ""}`, todo: "Check its cable. Trying again."});
  }
  for (const note of state.notes.value) {
    if (!["service_lost", "service_back"].includes(note.kind) || Date.now() - Date.parse(note.time) > HOUR_MS) continue;
    found.push({bad: note.kind === "service_lost", healed: note.kind === "service_back", at: note.time, text: note.title, todo: note.what_to_do});
  }
  return found.slice(0, 8);
}

function Sentences() {
  const list = sentences();
  if (!state.topics.status.value) return html`<p class="muted">Asking the stack…</p>`;
  if (!list.length) return html`<p class="verdict good"><${Icon} name="check" />Everything runs.</p>`;
  return html`<ul class="sentences">${list.map((one) => html`<li class=${one.bad ? "bad" : ""}>
    <${Icon} name=${one.bad ? "triangle-alert" : "check"} /><p>${one.at && html`<time class="number muted">${timeOfDay(one.at)}</time> `}<strong>${one.text}</strong>
    ${one.todo && html` <span class="muted">${one.todo}</span>`}</p></li>`)}</ul>`;
}

function Pipe() {
  const status = state.topics.status.value;
  const latest = history.at(-1);
  if (!latest) return null;
  return html`<ol class="pipe" aria-label="From camera to disk">${STAGES.map(([kind, words]) => {
    const of = Object.entries(status.services).filter(([name]) => name.split(".")[0] === kind);
    const alive = of.length && of.every(([, one]) => one.alive);
    const lost = of.reduce((sum, [, one]) => sum + lostOf(one), 0);
    return html`<li class="panel" data-alive=${String(Boolean(alive))}><h2>${kind}</h2>
      <p class="figure number">${alive ? rate(total(latest, kind)) : html`<span class="warn"><${Icon} name="triangle-alert" /> away</span>`}</p><p class="muted small">${words} a second</p>
      <p class=${lost ? "number warn" : "number muted"}>${lost ? `${count(lost)} passed over` : "none lost"}</p></li>`;
  })}</ol>`;
}

function Row({name, service}) {
  const lost = Object.entries(service.dropped ?? {}).map(([why, n]) => `${count(n)} ${why.replaceAll(/[_:]/g, " ")}`).join(", ");
  const {latency_p50_ms: p50, latency_p99_ms: p99, cpu_percent: cpu} = service.numbers ?? {};
  return html`<tr><th scope="row">${name}</th>
    <td>${service.alive ? html`<span class=${service.phase === "running" ? "good" : "warn"}><${Icon} name=${service.phase === "running" ? "check" : "triangle-alert"} /> ${KIND_WORDS[service.phase]}</span>`
      : html`<span class="warn"><${Icon} name="triangle-alert" /> away for ${span(service.age_s)}</span>`}${service.restarts ? html` <span class="muted small">restarted ${service.restarts}×</span>` : ""}</td>
    <td class="number">${rate(rateOf(service))}</td>
    <td class="number">${p50 === undefined ? "" : `${Math.round(p50)} / ${Math.round(p99)} ms`}</td>
    <td class="number">${cpu === undefined ? "–" : `${Math.round(cpu)} %`}</td>
    <td class="small">${lost}</td>
    <td><${Spark} values=${history.slice(-120).map((one) => one.services[name]?.rate ?? null)} /></td></tr>`;
}

function Room() {
  const status = state.topics.status.value;
  const disk = state.topics.disk.value;
  if (!status) return null;
  const {shm} = status;
  return html`<dl class="room panel"><div><dt>Disk</dt><dd class="number">${disk?.samples_left == null ? "–" : `${count(disk.samples_left)} samples fit`}
      <span class="muted">${bytes(status.disk?.free_bytes)} free${disk?.hours_left ? `, ${span(disk.hours_left * 3600)} at this pace` : ""}</span></dd></div>
    <div><dt>Waiting to be saved</dt><dd class="number">${count(status.backlog)}</dd></div>
    ${shm?.total_bytes && html`<div><dt>Shared memory</dt><dd class="number">${bytes(shm.used_bytes)} of ${bytes(shm.total_bytes)}</dd></div>`}
    <div><dt>Session</dt><dd>${status.session ?? "none"}</dd></div>
    <div><dt>Folder</dt><dd><code>${status.dataset}</code></dd></div></dl>`;
}

export function Health() {
  const status = state.topics.status.value;
  const services = Object.entries(status?.services ?? {}).sort(([a], [b]) => order(a) - order(b) || a.localeCompare(b));
  return html`<h1 class="visually-hidden">Health</h1><div class="stack health">
    <${Sentences} /><${Pipe} />
    <div class="scroll panel" tabindex="0" role="region" aria-label="Services in numbers"><table class="services"><caption class="visually-hidden">Services</caption><thead><tr><th scope="col">Service</th><th scope="col">State</th>
      <th scope="col">a second</th><th scope="col">Wait p50 / p99</th><th scope="col">CPU</th><th scope="col">Passed over, and why</th><th scope="col">Last two minutes</th></tr></thead>
      <tbody>${services.map(([name, service]) => html`<${Row} key=${name} name=${name} service=${service} />`)}</tbody></table></div>
    <${Room} />
    <div class="two"><${Chart} title="Frames" unit="a second" series=${[{label: "captured", kind: "capture", field: "rate"}, {label: "labelled", kind: "label", field: "rate"}, {label: "stored", kind: "store", field: "rate"}]} />
      <${Chart} title="Wait until labelled" unit="ms" series=${[{label: "half of them", kind: "label", field: "p50"}, {label: "99 of 100", kind: "label", field: "p99"}]} /></div>
    <section class="panel"><h2>Warnings</h2><${Notes} only=${["warning", "service_lost", "service_back", "refused"]} most=${30} /></section>
  </div>`;
}

const ORDER = ["capture", "detect", "label", "store", "control", "console"];
const order = (name) => (ORDER.indexOf(name.split(".")[0]) + 1 || 99);
