// Coverage: from where each object was recorded, what is missing, and what to do next.
import {useEffect} from "preact/hooks";
import {useSignal} from "@preact/signals";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {getJson} from "../api.js";
import {count} from "../format.js";
import {ask, route} from "../route.js";
import {Caption, Stage} from "../live/stage.js";
import {BigButton, Can, Modes} from "../live/record.js";
import {Globe} from "./globe.js";
import {bars, rows, sides} from "./map.js";

const AGAIN_MS = 3000;

/** The answer of /api/coverage for an object: renewed when samples change, and every few seconds for the next step. */
function useCoverage(object) {
  const found = useSignal(null);
  const version = state.samplesVersion.value;
  useEffect(() => {
    if (!object) return undefined;
    let gone = false;
    const look = async () => {
      const {ok, body} = await getJson(`/api/coverage?object=${encodeURIComponent(object)}`);
      if (!gone && ok) found.value = body;
    };
    const soon = setTimeout(look, found.peek()?.object === object ? 500 : 0);
    const again = setInterval(look, AGAIN_MS);
    return () => { gone = true; clearTimeout(soon); clearInterval(again); };
  }, [object, version]);
  return found.value?.object === object ? found.value : null;
}

function Map({coverage, now}) {
  return html`<div class="scroll" tabindex="0" role="region" aria-label="Map of directions"><table class="map number"><caption class="visually-hidden">Samples by direction: columns are the side
    that is seen, rows how far the camera is above it</caption>
    <thead><tr><td></td>${sides(coverage.bins.azimuth).map((one) => html`<th scope="colgroup" colspan=${one.span}>${one.name}</th>`)}</tr></thead>
    <tbody>${rows(coverage, now?.cell).map((row) => html`<tr><th scope="row">${row.from}…${row.to}°</th>
      ${row.cells.map((cell) => html`<td class="cell" data-count=${cell.count} data-level=${cell.level} data-wanted=${String(cell.wanted)} data-now=${cell.now ? "" : undefined}
        title=${`${cell.words}: ${cell.count}`}>${cell.now ? html`<span class="here" aria-hidden="true"></span><span class="visually-hidden">now here, </span>` : ""}
        ${cell.count || (cell.wanted ? html`<span aria-label="none">0</span>` : html`<span aria-label="not needed">·</span>`)}</td>`)}</tr>`)}</tbody></table></div>
    <p class="legend small"><span><b class="cell swatch" data-level="0" data-wanted="true">0</b> missing</span>
      <span><b class="cell swatch" data-level="1">1</b><b class="cell swatch" data-level="2">3</b><b class="cell swatch" data-level="3">7</b><b class="cell swatch" data-level="4">8</b> samples</span>
      <span>· no marker can be seen from there</span>${now && html`<span><span class="here" aria-hidden="true"></span> the view now</span>`}</p>`;
}

function Distances({coverage, now}) {
  const list = bars(coverage.distances, now?.distance_mm ?? null);
  if (!list.length) return null;
  return html`<figure class="distances"><figcaption><h2>Distance</h2></figcaption>
    <ol class="histogram" aria-label="Samples by distance">${list.map((bar) => html`<li data-now=${bar.now ? "" : undefined}>
      <span class="number">${bar.count}</span><span class="bar-ink" style=${{height: `${Math.round(bar.share * 72) + 2}px`}}></span>
      <span class="caption number">${(bar.from / 1000).toFixed(bar.from % 100 ? 2 : 1)}</span></li>`)}</ol>
    <p class="caption muted">metres, each bar begins at its number${now ? html` · now <strong class="number">${(now.distance_mm / 1000).toFixed(2)} m</strong>` : ""}</p></figure>`;
}

/** The live value beside each limit of auto-record: "why not now?" answers itself. */
function Limits({now}) {
  const limits = state.rig.value?.auto ?? {};
  if (!now) return html`<p class="muted">The object is not in view.</p>`;
  const row = (words, value, limit, ok) => html`<tr><th scope="row">${words}</th><td class="number">${value}</td>
    <td class="number muted">${limit}</td><td>${ok === null ? "" : html`<span class=${ok ? "good" : "warn"}><${Icon} name=${ok ? "check" : "triangle-alert"} />${ok ? "fits" : "not yet"}</span>`}</td></tr>`;
  const isNew = now.new_by_deg === null || now.new_by_mm === null || now.new_by_deg >= limits.new_deg || now.new_by_mm >= limits.new_mm;
  const differs = now.new_by_deg === null && now.new_by_mm === null ? "first" : `${now.new_by_deg === null ? "–" : `${now.new_by_deg}°`}`;
  return html`<table class="limits"><caption>Would Auto take it?</caption><tbody>
    ${row("New view", differs, `≥ ${limits.new_deg ?? "?"}° or ${limits.new_mm ?? "?"} mm`, isNew)}
    ${limits.sharpness ? row("Sharp", now.sharpness ?? "–", `≥ ${limits.sharpness}`, now.sharpness === null ? null : now.sharpness >= limits.sharpness) : ""}
    ${row("Fit", `${now.fit_px} px`, `≤ ${limits.fit_px ?? "?"} px`, now.fit_px <= (limits.fit_px ?? Infinity))}</tbody></table>`;
}

export function Coverage() {
  const names = (state.rig.value?.objects ?? []).map((one) => one.name);
  const object = names.includes(route.value.query.object) ? route.value.query.object : names[0];
  const coverage = useCoverage(object);
  const now = state.topics.coverage.value?.[object] ?? null;
  const camera = now?.camera ?? state.bigCamera.value;
  const id = `cover-${camera}`;
  return html`<div class="coverage"><section class="stack wide" aria-label="What is recorded">
      <div class="row spread"><h1>Coverage</h1>
        <label class="choice">Object <select value=${object} onChange=${(event) => ask({object: event.currentTarget.value})}>
          ${names.map((name) => html`<option value=${name}>${name}</option>`)}</select></label></div>
      ${coverage && html`<p class="next"><strong class="views number">${count(coverage.views_covered)} of ${count(coverage.views_wanted)} views</strong>
        <span>${coverage.next ? `Next: ${coverage.next}` : "Every view is recorded."}</span></p>
      ${coverage.total ? "" : html`<p class="muted">Nothing recorded of ${object} yet. Its views appear here.</p>`}
      <div class="charts"><${Globe} coverage=${coverage} now=${now} /><div class="stack"><${Map} coverage=${coverage} now=${now} /></div></div>
      <${Distances} coverage=${coverage} now=${now} />`}
    </section>
    <section class="side record panel" aria-label="Record">
      ${camera && html`<figure class="bigpicture"><${Stage} key=${id} id=${id} camera=${camera} chosen=${object} big=${true} />
        <figcaption><${Caption} camera=${camera} kind="rgb" header=${state.drawn.value[id]} /></figcaption></figure>`}
      <${BigButton} /><${Can} /><${Limits} now=${now} /><${Modes} />
    </section></div>`;
}
