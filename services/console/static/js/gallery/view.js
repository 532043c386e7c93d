// Gallery: what was recorded; filter, look, choose, to the bin and back.
import {signal} from "@preact/signals";
import {useEffect} from "preact/hooks";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {local, remove, restore, set} from "../actions.js";
import {command} from "../api.js";
import {count, plural} from "../format.js";
import {hint} from "../keys.js";
import {ask, route} from "../route.js";
import {Filter} from "./filter.js";
import {Grid} from "./grid.js";
import {between, filterOf, isFiltered, move} from "./model.js";
import {Opened} from "./opened.js";

const PAGE = 60;

/** The name of the opened sample, "" while the grid is shown. */
export const openedSample = signal("");
const list = signal(null);
const chosen = signal(new Set());
const focusAt = signal(0);
let anchor = 0;
let columns = 1;
export const setColumns = (n) => { columns = n; };

/** The first samples anew, as many as are shown: newest first. */
async function load(limit) {
  const filter = filterOf(route.peek().query);
  const answer = await command("samples", {filter, limit: Math.min(500, limit)}, 30000);
  if (JSON.stringify(filter) !== JSON.stringify(filterOf(route.peek().query))) return; // another list is wanted by now
  if (!answer.ok) { list.value = {samples: [], total: 0, stored: null, in_bin: null, why: answer.error.message}; return; }
  list.value = {...answer, bin: Boolean(filter.bin)};
  const there = new Set(answer.samples.map((one) => one.name));
  chosen.value = new Set([...chosen.peek()].filter((name) => there.has(name)));
  focusAt.value = Math.min(focusAt.peek(), Math.max(0, answer.samples.length - 1));
}

async function more() {
  const known = list.peek();
  const answer = await command("samples", {filter: filterOf(route.peek().query), limit: PAGE, offset: known.next_offset}, 30000);
  if (answer.ok) list.value = {...known, next_offset: answer.next_offset, samples: [...known.samples, ...answer.samples]};
}

const names = () => (list.value?.samples ?? []).map((one) => one.name);
const wanted = () => (openedSample.value ? [openedSample.value] : chosen.value.size ? [...chosen.value] : names().slice(focusAt.value, focusAt.value + 1));

export function choose(at, {extend = false} = {}) {
  const all = names();
  const next = new Set(chosen.value);
  if (extend) for (const name of between(all, anchor, at)) next.add(name);
  else {
    anchor = at;
    if (!next.delete(all[at])) next.add(all[at]);
  }
  chosen.value = next;
  focusAt.value = at;
}

function step(where, event) {
  const at = move(focusAt.value, where, columns, names().length);
  if (event?.shiftKey) {
    choose(at, {extend: true});
  } else {
    anchor = at;
    focusAt.value = at;
  }
  requestAnimationFrame(() => document.querySelector(`[role="gridcell"][data-at="${at}"]`)?.focus());
}

export function open(name) {
  ask({sample: name});
}

function openNext(by) {
  const all = names();
  const next = all[all.indexOf(openedSample.value) + by];
  if (next) ask({sample: next}, {replace: true});
}

async function toBin(samples = wanted()) {
  if (!samples.length || route.value.query.bin) return;
  const next = openedSample.value ? names()[names().indexOf(openedSample.value) + 1] ?? "" : "";
  if (await remove(samples)) {
    chosen.value = new Set();
    if (openedSample.value) ask({sample: next || null}, {replace: true});
  }
}

async function putBack(samples = wanted()) {
  if (samples.length && route.value.query.bin && await restore(samples)) chosen.value = new Set();
}

function back() {
  if (openedSample.value) ask({sample: null});
  else if (chosen.value.size) chosen.value = new Set();
}

async function copy() {
  const [name] = wanted();
  if (!name) return;
  try {
    await navigator.clipboard.writeText(name);
    state.tell(`${name} copied.`);
  } catch {
    state.tell(`This browser lets no page copy here. The name: ${name}`);
  }
}

const COMMANDS = {
  ...Object.fromEntries(["left", "right", "up", "down", "first", "last"].map((where) => [`grid.${where}`, (event) => step(where, event)])),
  "grid.open": () => names()[focusAt.value] && open(names()[focusAt.value]),
  "grid.choose": () => names().length && choose(focusAt.value),
  "grid.all": () => { chosen.value = new Set(names()); },
  "gallery.delete": () => toBin(), "gallery.restore": () => putBack(), "gallery.copy": copy,
  "opened.previous": () => openNext(-1), "opened.next": () => openNext(1), back,
};

function Empty({query}) {
  if (list.value?.why) return html`<p class="empty">${list.value.why}</p>`;
  if (isFiltered(query)) return html`<p class="empty">No sample matches. <button class="button" onClick=${() => ask({object: null, side: null, camera: null, quality: null})}>Clear the filter</button></p>`;
  if (query.bin) return html`<p class="empty">The bin is empty.</p>`;
  return html`<p class="empty">No samples yet. Press <kbd>Space</kbd> in <a href="/live">Live</a> to record the first.</p>`;
}

function Toolbar({query}) {
  const {total = 0, stored, in_bin} = list.value ?? {};
  const n = chosen.value.size;
  return html`<div class="row spread"><div class="row">
      <h1>${query.bin ? "Bin" : "Gallery"}</h1>
      <p class="number muted">${isFiltered(query) ? `${count(total)} of ${count(query.bin ? in_bin : stored)}` : plural(total, "sample")}</p></div>
    <div class="row">
      ${n > 0 && html`<span class="number"><strong>${n}</strong> chosen</span>`}
      ${query.bin ? html`<button class="button" disabled=${!n} onClick=${() => putBack()}><${Icon} name="archive-restore" />Put back <kbd>${hint("gallery.restore")}</kbd></button>`
        : html`<button class="button" disabled=${!n} onClick=${() => toBin()}><${Icon} name="trash-2" />To the bin <kbd>${hint("gallery.delete")}</kbd></button>`}
      <label class="choice">Size <input type="range" min="140" max="360" step="20" value=${state.settings.value.tile} onInput=${(e) => set({tile: Number(e.currentTarget.value)})} /></label>
      <button class="button" aria-pressed=${String(Boolean(query.bin))} onClick=${() => { chosen.value = new Set(); ask({bin: query.bin ? null : "1"}); }}>
        <${Icon} name="trash-2" />Bin <span class="number">${count(in_bin)}</span></button></div></div>`;
}

export function Gallery() {
  const {query} = route.value;
  openedSample.value = query.sample ?? "";
  const filter = JSON.stringify(filterOf(query));
  useEffect(() => { Object.assign(local, COMMANDS); return () => { for (const name of Object.keys(COMMANDS)) delete local[name]; openedSample.value = ""; }; }, []);
  useEffect(() => { focusAt.value = 0; load(PAGE); }, [filter]);
  useEffect(() => {
    const soon = setTimeout(() => load(Math.max(PAGE, names().length)), 250);
    return () => clearTimeout(soon);
  }, [state.samplesVersion.value]);
  const samples = list.value?.samples ?? [];
  const sample = samples.find((one) => one.name === query.sample);
  if (query.sample) {
    return html`<${Opened} key=${query.sample} name=${query.sample} sample=${sample} bin=${Boolean(query.bin)} close=${back} copy=${copy}
      toBin=${() => toBin([query.sample])} putBack=${() => putBack([query.sample])} next=${openNext} />`;
  }
  return html`<div class="stack"><${Toolbar} query=${query} /><${Filter} query=${query} />
    ${list.value === null ? html`<p class="muted">Reading…</p>` : samples.length
      ? html`<${Grid} samples=${samples} chosen=${chosen.value} focusAt=${focusAt.value} bin=${list.value.bin} choose=${choose} open=${open} columns=${setColumns} />` : html`<${Empty} query=${query} />`}
    ${list.value?.next_offset != null && html`<button class="button" onClick=${more}>Show more, ${count(list.value.total - samples.length)} are left</button>`}</div>`;
}
