// The filter lives in the address: a list can be sent to somebody, and back works.
import {html} from "../html.js";
import * as state from "../state.js";
import {ask} from "../route.js";
import {QUALITIES, isFiltered} from "./model.js";

function Choice({name, title, query, options}) {
  return html`<label class="choice">${title} <select value=${query[name] ?? ""} onChange=${(event) => ask({[name]: event.currentTarget.value || null}, {replace: true})}>
    <option value="">any</option>${options.map(([value, words]) => html`<option value=${value}>${words}</option>`)}</select></label>`;
}

const same = (list) => [...new Set(list)].map((one) => [one, one]);

export function Filter({query}) {
  const objects = state.rig.value?.objects ?? [];
  return html`<div class="row" id="filter" role="group" aria-label="Filter">
    <${Choice} name="object" title="Object" query=${query} options=${same(objects.map((one) => one.name))} />
    <${Choice} name="side" title="Side" query=${query} options=${same(objects.flatMap((one) => one.sides.map((side) => side.class)))} />
    <${Choice} name="camera" title="Camera" query=${query} options=${same(state.cameras.value)} />
    <${Choice} name="quality" title="Quality" query=${query} options=${Object.entries(QUALITIES).map(([id, {words}]) => [id, words])} />
    ${isFiltered(query) && html`<button class="button" onClick=${() => ask({object: null, side: null, camera: null, quality: null})}>Clear the filter</button>`}</div>`;
}
