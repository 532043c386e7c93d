// Which board, and whether to go on with kept views: the form before a calibration.
import {useEffect} from "preact/hooks";
import {useSignal} from "@preact/signals";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {getJson} from "../api.js";
import {plural, timeOfDay} from "../format.js";
import {FIELDS, boardWords, described} from "./ghost.js";

const KINDS = [["charuco", "ChArUco"], ["chessboard", "Chessboard"], ["aprilgrid", "AprilGrid"], ["aruco-grid", "ArUco grid"]];
const HINTS = {family: "5x5_1000", columns: "11", rows: "8"};
const MOST_TEXT = 16384;

const day = (iso) => (new Date(iso).toDateString() === new Date().toDateString() ? timeOfDay(iso) : new Date(iso).toLocaleDateString("en-GB"));

function Choice({name, value, now, set, children}) {
  return html`<label class="choice"><input type="radio" name=${name} value=${value} checked=${now === value} onChange=${() => set(value)} />
    <span>${children}</span></label>`;
}

function Description({form, kind, change}) {
  return html`<div class="describe">
    <label>Kind<select value=${kind} onChange=${(e) => change({kind: e.currentTarget.value})}>
      ${KINDS.map(([value, words]) => html`<option value=${value}>${words}</option>`)}</select></label>
    ${FIELDS.filter(([, words]) => words[kind]).map(([name, words]) => html`<label key=${name}>${words[kind]}
      <input type="text" inputmode=${name === "family" ? "text" : "decimal"} value=${form[name] ?? ""} placeholder=${HINTS[name] ?? ""}
        onInput=${(e) => change({[name]: e.currentTarget.value})} /></label>`)}
    ${kind === "charuco" && html`<label class="choice"><input type="checkbox" checked=${form.legacy} onChange=${(e) => change({legacy: e.currentTarget.checked})} />
      Layout of OpenCV before 4.6</label>`}
  </div>`;
}

/** `start(fields)` sends the wish; resolves to the refusal's sentence, or null. */
export function BoardForm({camera, start}) {
  const known = useSignal(null);
  const source = useSignal("");
  const text = useSignal(null);
  const problem = useSignal("");
  const {kind = "charuco", ...form} = state.board.value;
  useEffect(() => {
    getJson("/api/calibration").then(({ok, body}) => {
      known.value = ok ? body : {boards: [], kept: {}};
      const kept = known.value.kept[camera];
      source.value = kept?.unfinished ? "kept" : known.value.boards.length ? known.value.boards[0].file : "describe";
    });
  }, [camera]);
  if (!known.value) return html`<p class="muted">Looking for board descriptions…</p>`;
  const kept = known.value.kept[camera];
  const choose = (value) => { source.value = value; problem.value = ""; };
  const take = async (file) => { text.value = file && file.size <= MOST_TEXT ? await file.text() : null; source.value = "file"; };
  const begin = async (event) => {
    event.preventDefault();
    const now = source.value;
    const fields = now === "kept" ? {go_on: true} : now === "describe" ? {board: described(kind, form)}
      : now === "file" ? {board_text: text.value ?? ""} : {board_file: now};
    problem.value = (await start({camera, ...fields})) ?? "";
  };
  return html`<form class="board stack" onSubmit=${begin}>
    <fieldset><legend><h3>Which board?</h3></legend>
      ${kept && html`<${Choice} name="board" value="kept" now=${source.value} set=${choose}>Go on with the ${plural(kept.views, "view")} of ${day(kept.at)} <span class="muted small">${kept.board}</span><//>`}
      ${known.value.boards.map(({file, board}) => html`<${Choice} key=${file} name="board" value=${file} now=${source.value} set=${choose}><code>${file}</code> <span class="muted small">${boardWords(board)}</span><//>`)}
      <${Choice} name="board" value="describe" now=${source.value} set=${choose}>Describe it<//>
      ${source.value === "describe" && html`<${Description} form=${form} kind=${kind} change=${(one) => { state.board.value = {...state.board.value, ...one}; }} />`}
      <${Choice} name="board" value="file" now=${source.value} set=${choose}>Its description from this device<//>
      ${source.value === "file" && html`<label class="file">A YAML file, as <code>tagmill markers board</code> writes it
        <input type="file" accept=".yaml,.yml" onChange=${(e) => take(e.currentTarget.files[0])} /></label>`}
    </fieldset>
    ${problem.value && html`<p class="bad-words" role="alert"><${Icon} name="triangle-alert" /> ${problem.value}</p>`}
    <button class="button primary" type="submit"><${Icon} name="camera" />Begin</button>
    <p class="small muted">Have the board flat and stiff. Its views are taken by themselves when it is still, sharp and somewhere new; about three minutes.</p>
  </form>`;
}
