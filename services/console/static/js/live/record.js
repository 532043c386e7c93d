// The record panel: how, the one big button, what would stop it, the last sample, what was refused.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {run, set, take} from "../actions.js";
import {sampleUrl} from "../api.js";
import {hint, shortcuts} from "../keys.js";
import {timeOfDay} from "../format.js";
import {MODES, button, canSay, modeWords} from "./modes.js";

/** A press by pointer gives the focus back to the picture, so that Space still records. */
export const keepFocus = (event) => {
  event.preventDefault();
  document.querySelector(".bigpicture .stage, main")?.focus({preventScroll: true});
};

export const watched = () =>
  (state.allCameras.value ? state.cameras.value : [state.bigCamera.value].filter(Boolean));

export function BigButton() {
  const record = state.topics.record.value;
  const phase = state.phase.value;
  const it = button(phase, state.settings.value.mode, record, state.asked.value === "waiting");
  return html`<button class="take" data-phase=${phase} disabled=${it.disabled} aria-keyshortcuts=${shortcuts("take")}
      onPointerDown=${keepFocus} onClick=${take}>
    <${Icon} name=${it.shape} /><span>${it.text}</span>${!it.disabled && html`<kbd>Space</kbd>`}
  </button>`;
}

export function Can() {
  const record = state.topics.record.value;
  const phase = state.phase.value;
  if (phase === "unknown") {
    return html`<p class="can bad"><${Icon} name="unplug" /><span>The recording goes on without this page.${record ? ` Last known: ${record.phase}, ${record.count ?? 0} samples.` : ""}</span></p>`;
  }
  if (phase === "cannot") return html`<p class="can bad"><${Icon} name="triangle-alert" /><span>${record.why?.what_to_do || record.why?.title}</span></p>`;
  if (phase === "recording") {
    const waits = Object.entries(record.waiting_for ?? {}).filter(([, code]) => !["not_due", "not_new"].includes(code));
    const [first] = waits;
    const title = first && (state.words.value[first[1]]?.title ?? first[1]);
    return first ? html`<p class="can bad"><${Icon} name="triangle-alert" /><span>${first[0]} waits: ${title}</span></p>`
      : html`<p class="can"><${Icon} name="check" /><span>${modeWords(record)}. Samples are being saved.</span></p>`;
  }
  const say = canSay(record, watched(), state.words.value);
  return html`<p class=${say.ok ? "can" : "can bad"}><${Icon} name=${say.ok ? "check" : "triangle-alert"} />
    <span>${say.ok ? `Can record: ${say.text}` : `${say.text} ${say.todo}`}</span></p>`;
}

export function Modes() {
  const {mode, count, every_s} = state.settings.value;
  const busy = ["recording", "finishing"].includes(state.phase.value);
  return html`<fieldset class="modes" disabled=${busy}>
    <legend class="visually-hidden">How to record</legend>
    <div class="mode-list">${MODES.map((one) => html`<label class="choice" title=${one.words}>
      <input type="radio" name="mode" value=${one.id} checked=${mode === one.id} onChange=${() => set({mode: one.id})} />${one.title}</label>`)}</div>
    <label class="mode-select"><span class="visually-hidden">How to record</span><select value=${mode} onChange=${(e) => set({mode: e.currentTarget.value})}>
      ${MODES.map((one) => html`<option value=${one.id}>${one.title}: ${one.words}</option>`)}</select></label>
    ${mode === "burst" && html`<label class="choice">How many
      <input type="number" min="1" max="1000" value=${count} onChange=${(e) => set({count: clamp(e.currentTarget.value, 1, 1000)})} /></label>`}
    ${mode === "every" && html`<label class="choice">Every
      <input type="number" min="0.1" max="3600" step="0.1" value=${every_s} onChange=${(e) => set({every_s: clamp(e.currentTarget.value, 0.1, 3600)})} /> s</label>`}
    <p class="small muted">${MODES.find((one) => one.id === mode)?.words}</p>
  </fieldset>`;
}

const clamp = (text, low, high) => Math.min(high, Math.max(low, Number(text) || low));

export function Last() {
  const last = state.topics.record.value?.last;
  if (!last) return html`<p class="last muted small">Nothing recorded since this page's server started.</p>`;
  const words = `${timeOfDay(last.time)} ${last.camera}`;
  return html`<div class="last" key=${last.sample}>
    <a href="/gallery"><img class="thumb" src=${sampleUrl(last.sample, "thumb")} alt=${`Last sample, ${words}`} width="128" height="72" /></a>
    <p><strong class="number">${timeOfDay(last.time)}</strong> ${last.camera}<br /><span class="good"><${Icon} name="check" /> saved</span></p>
    <button class="button" aria-keyshortcuts=${shortcuts("undo")} onPointerDown=${keepFocus} onClick=${() => run("undo")}
      title=${`Undo ${words}`}><${Icon} name="undo-2" />Undo <span class="visually-hidden">${words}</span><kbd>${hint("undo")}</kbd></button></div>`;
}

export function Refused() {
  const refused = state.topics.record.value?.refused ?? [];
  if (!refused.length) return null;
  return html`<div class="refused"><h3>Refused in the last minute</h3><ul>${refused.map((one) => html`<li>
    <span class="number">${one.times}×</span> ${one.title} <span class="muted">${one.what_to_do}</span></li>`)}</ul></div>`;
}

export function Record() {
  const session = state.topics.record.value?.session;
  return html`<section class="record panel" aria-labelledby="record-title">
    <div class="row spread"><h2 id="record-title">Record</h2>
      <span class="muted small">${session ? html`session <strong>${session}</strong>` : ""}</span></div>
    <${Modes} /><${BigButton} /><${Can} /><${Last} /><${Refused} />
  </section>`;
}
