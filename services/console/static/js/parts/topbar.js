// The same on every view: am I recording, how many, how much disk, is there news.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {runsFor} from "../actions.js";
import {count, span} from "../format.js";
import {hint} from "../keys.js";
import {STATE_WORDS, modeWords} from "../live/modes.js";
import {VIEWS, route} from "../route.js";
import {open} from "./dialog.js";

export function stateText() {
  const phase = state.phase.value;
  const record = state.topics.record.value;
  if (phase === "recording") return `${runsFor(record, state.now.value)} · ${count(record.count)}`;
  if (phase === "finishing") return count(record.finishing);
  if (phase === "asked") return `${Math.max(0, (state.askedUntil.value - state.now.value) / 1000).toFixed(0)} s`;
  return "";
}

function State() {
  const phase = state.phase.value;
  const record = state.topics.record.value;
  return html`<p class="state"><span class="dot" aria-hidden="true"></span><span>${STATE_WORDS[phase]}</span>
    <span>${stateText()}</span>${phase === "recording" && html`<span class="small">${modeWords(record)}</span>`}</p>`;
}

function Disk() {
  const disk = state.topics.disk.value ?? state.topics.record.value?.disk;
  if (disk?.samples_left == null) return null;
  return html`<p class="fact optional"><b>${count(disk.samples_left)}</b>
    <span>samples fit${disk.hours_left ? `, ${span(disk.hours_left * 3600)}` : ""}</span></p>`;
}

export function TopBar() {
  const session = state.topics.record.value?.session ?? state.topics.session.value?.session;
  return html`<header class="top">
    <a class="brand" href="/live">tagmill</a>
    <nav class="tabs" aria-label="Views">${VIEWS.map((view, i) => html`<a href=${`/${view.id}`} aria-keyshortcuts=${String(i + 1)}
      aria-current=${route.value.view === view.id ? "page" : undefined}><${Icon} name=${view.icon} />${view.title}<kbd aria-hidden="true">${i + 1}</kbd></a>`)}</nav>
    <div class="facts"><${State} />
      <p class="fact session"><b>${count(state.stored.value)}</b><span>in ${session ?? "the session"}</span></p>
      <${Disk} />
      <button class="button quiet" onClick=${() => open("notes")} aria-keyshortcuts=${hint("notes")}>
        <${Icon} name="bell" />${state.unread.value ? html`<strong>${state.unread.value}</strong> new` : "Notes"}</button>
      <button class="button quiet" onClick=${() => open("keys")} aria-label="Keys and settings" title="Keys and settings (?)"><${Icon} name="keyboard" /></button>
    </div></header>`;
}

