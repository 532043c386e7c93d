// Everything that was said, kept: nothing that matters has a time limit.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {timeOfDay} from "../format.js";

const ICONS = {
  saved: "check", refused: "circle-alert", service_lost: "triangle-alert", service_back: "check", warning: "triangle-alert",
  deleted: "trash-2", restored: "archive-restore", ended: "square",
};

export function Notes({only = null, most = 200}) {
  const list = state.notes.value.filter((note) => (only ? only.includes(note.kind) : note.kind !== "saved")).slice(0, most);
  if (!list.length) return html`<p class="muted">Nothing to note so far.</p>`;
  return html`<ol class="notes">${list.map((note) => html`<li key=${note.n}>
    <time class="number muted" datetime=${note.time}>${timeOfDay(note.time)}</time><${Icon} name=${ICONS[note.kind] ?? "bell"} />
    <strong>${note.times > 1 ? `${note.times} times: ` : ""}${note.title}</strong>
    ${note.what_to_do && html`<p class="muted small">${note.what_to_do}</p>`}</li>`)}</ol>`;
}
