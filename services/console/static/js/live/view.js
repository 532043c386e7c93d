// Live + Record: one big picture, the others small, and the record panel beside it.
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {run} from "../actions.js";
import {hint, shortcuts} from "../keys.js";
import {Caption, Legend, SplitStage, Stage} from "./stage.js";
import {Record, keepFocus} from "./record.js";

const LETTERS = [["K", "Markers"], ["B", "Box"], ["W", "Window"], ["C", "Class"], ["D", "Distance"], ["E", "Uncertainty"], ["P", "Sides"]];

function Toggle({command, on, children, icon}) {
  return html`<button class="button" aria-pressed=${on === undefined ? undefined : String(Boolean(on))} aria-keyshortcuts=${shortcuts(command)}
    onPointerDown=${keepFocus} onClick=${() => run(command)}>${icon && html`<${Icon} name=${icon} />`}${children} <kbd>${hint(command)}</kbd></button>`;
}

/** Everything that changes what is drawn; shared with the gallery's opened sample. */
export function PictureTools({depth, hold = true, split = true}) {
  return html`<div class="tools" role="group" aria-label="What the picture shows">
    ${split && html`<${Toggle} command="split" on=${state.split.value}>Before | After<//>`}
    ${depth && html`<${Toggle} command="depth" on=${state.kind.value === "depth"}>Depth<//>`}
    ${hold && html`<${Toggle} command="hold" on=${state.heldStill.value} icon="pause">Hold<//>`}
    <${Toggle} command="fullscreen" icon="maximize">Full screen<//>
  </div>`;
}

/** Which parts of the label are drawn. */
export function Overlays() {
  const shown = state.overlays.value;
  return html`<div class="tools overlays" role="group" aria-label="Overlays">
    <${Toggle} command="overlay.all" on=${shown.on} icon="layers">Overlays<//>
    ${LETTERS.map(([letter, words]) => html`<${Toggle} command=${`overlay.${letter}`} on=${shown.on && shown[letter]}>${words}<//>`)}
  </div>`;
}

function Cameras() {
  const all = state.cameras.value;
  if (all.length < 2) return null;
  const big = state.bigCamera.value;
  return html`<section class="others" aria-label="Other cameras">
    ${all.filter((name) => name !== big).map((name) => html`<button class="other" key=${name} onPointerDown=${keepFocus}
        onClick=${() => { state.camera.value = name; }}>
      <${Stage} id=${`small-${name}`} camera=${name} />
      <${Caption} camera=${name} kind="rgb" header=${state.drawn.value[`small-${name}`]} />
      <span class="visually-hidden">Show ${name} large</span></button>`)}
    <p class="small muted"><kbd aria-label="comma">,</kbd> <kbd aria-label="full stop">.</kbd> change the camera · <kbd>0</kbd> ${state.allCameras.value ? "recording from all cameras" : "record from all"}</p>
  </section>`;
}

export function Live() {
  const camera = state.bigCamera.value;
  const depth = state.topics.status.value?.cameras?.[camera]?.depth;
  const kind = depth ? state.kind.value : "rgb";
  if (!camera) return html`<h1 class="visually-hidden">Live</h1><div class="live"><p class="empty">No camera has said a word yet.</p><${Record} /></div>`;
  const id = state.split.value ? `after-${camera}` : `big-${camera}-${kind}`;
  const header = state.drawn.value[id];
  return html`<h1 class="visually-hidden">Live</h1><div class="live">
    <section class="pictures" aria-label="Pictures">
      <figure class="bigpicture">
        ${state.split.value ? html`<${SplitStage} key=${camera} camera=${camera} />`
          : html`<${Stage} key=${id} id=${id} camera=${camera} kind=${kind} big=${true} />`}
        <figcaption class="row spread"><${Caption} camera=${camera} kind=${state.split.value ? "after" : kind} header=${header} />
          ${kind === "depth" && html`<${Legend} header=${header} />`}<${PictureTools} depth=${depth} /></figcaption>
      </figure>
      <${Overlays} />
      <${Cameras} />
    </section>
    <${Record} />
  </div>`;
}
