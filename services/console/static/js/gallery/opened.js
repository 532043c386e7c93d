// One sample, large: its label drawn over it, before | after where the original was kept, its name to copy.
import {useEffect, useRef} from "preact/hooks";
import {useSignal} from "@preact/signals";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {getJson, sampleUrl} from "../api.js";
import {hint} from "../keys.js";
import {timeOfDay} from "../format.js";
import {paint, strokes} from "../live/overlay.js";
import {Overlays, PictureTools} from "../live/view.js";
import {quality} from "./model.js";

/** A stored picture with the label's strokes; a canvas as in Live, so that both look alike. */
function Still({name, what, bin, label, clip}) {
  const root = useRef();
  const bitmap = useSignal(null);
  const failed = useSignal(false);
  const overlays = state.overlays.value;
  useEffect(() => {
    let gone = false;
    failed.value = false;
    fetch(sampleUrl(name, what, bin)).then((answer) => (answer.ok ? answer.blob() : Promise.reject(answer.status)))
      .then((blob) => createImageBitmap(blob))
      .then((made) => { if (gone) made.close(); else bitmap.value = made; })
      .catch(() => { failed.value = !gone; });
    return () => { gone = true; bitmap.peek()?.close(); bitmap.value = null; };
  }, [name, what, bin]);
  useEffect(() => {
    if (!root.current) return undefined;
    const draw = () => drawStill(root.current, bitmap.peek(), label, overlays);
    draw();
    const sizes = new ResizeObserver(draw);
    sizes.observe(root.current);
    return () => sizes.disconnect();
  }, [bitmap.value, label, overlays]);
  return html`<div class=${`stage ${clip ? "after" : ""}`} ref=${root} tabindex="-1" role="img" data-kind=${what} aria-label=${`${name}, ${what === "original" ? "before erasing" : what}`}>
    <canvas class="picture"></canvas><canvas class="over"></canvas>
    ${failed.value && html`<p class="trouble">This picture can't be read.</p>`}</div>`;
}

function drawStill(root, bitmap, label, overlays) {
  if (!root || !bitmap) return;
  const [picture, over] = root.querySelectorAll("canvas");
  Object.assign(picture, {width: bitmap.width, height: bitmap.height});
  root.style.setProperty("--ratio", `${bitmap.width} / ${bitmap.height}`);
  picture.getContext("2d").drawImage(bitmap, 0, 0);
  const [w, h] = label?.camera ? [label.camera.width, label.camera.height] : [bitmap.width, bitmap.height];
  const ratio = devicePixelRatio;
  const fit = Math.min(root.clientWidth / w, root.clientHeight / h);
  const size = {width: Math.max(1, Math.round(w * fit * ratio)), height: Math.max(1, Math.round(h * fit * ratio))};
  Object.assign(over, size);
  paint(over.getContext("2d"), overlays.on ? strokes(label, overlays) : [], {...size, scale: size.width / w, ratio});
  root.dataset.drawn = "1";
}

function Split({name, bin, label}) {
  const at = state.divider.value;
  return html`<div class="split" style=${{"--at": `${at}%`}}><${Still} name=${name} what="original" bin=${bin} label=${label} />
    <${Still} name=${name} what="rgb" bin=${bin} label=${label} clip=${true} />
    <span class="split-word before" aria-hidden="true">Before</span><span class="split-word behind" aria-hidden="true">After</span>
    <input class="divider" type="range" min="0" max="100" value=${at} aria-label="Divider between before and after"
      onInput=${(event) => { state.divider.value = Number(event.currentTarget.value); }} /></div>`;
}

function Objects({objects}) {
  return html`<div class="scroll"><table><thead><tr><th scope="col">Object</th><th scope="col">Sides</th><th scope="col">Distance</th><th scope="col">Fit</th><th scope="col">Pose</th></tr></thead>
    <tbody>${objects.map((one) => html`<tr><th scope="row">${one.name}</th><td>${one.sides.join(", ")}</td>
      <td class="number">${Math.round(one.distance_mm)} mm${one.uncertainty_mm == null ? "" : ` ±${one.uncertainty_mm.toFixed(1)}`}</td>
      <td class="number">${one.reprojection_error_px.toFixed(2)} px</td><td>${one.ambiguous ? html`<span class="warn"><${Icon} name="triangle-alert" /> two fit</span>` : one.pose_source}</td></tr>`)}</tbody></table></div>`;
}

export function Opened({name, sample, bin, close, copy, toBin, putBack, next}) {
  const label = useSignal(null);
  useEffect(() => {
    let gone = false;
    getJson(sampleUrl(name, "label", bin)).then(({ok, body}) => { if (!gone && ok) label.value = body; });
    document.querySelector(".opened h1")?.focus();
    return () => { gone = true; };
  }, [name, bin]);
  const files = sample?.files ?? label.value?.files ?? {};
  const {word, px} = sample ? quality(sample) : {word: "", px: null};
  const split = state.split.value && files.original;
  const what = state.kind.value === "depth" && files.depth ? "depth" : "rgb";
  return html`<article class="opened stack"><div class="row spread">
      <button class="button" onClick=${close}>Back to the gallery <kbd>Esc</kbd></button>
      <div class="row"><button class="button" onClick=${() => next(-1)}>Newer <kbd>←</kbd></button><button class="button" onClick=${() => next(1)}>Older <kbd>→</kbd></button>
      ${bin ? html`<button class="button" onClick=${putBack}><${Icon} name="archive-restore" />Put back <kbd>${hint("gallery.restore")}</kbd></button>`
        : html`<button class="button" onClick=${toBin}><${Icon} name="trash-2" />To the bin <kbd>${hint("gallery.delete")}</kbd></button>`}</div></div>
    <figure class="bigpicture">${split ? html`<${Split} name=${name} bin=${bin} label=${label.value} />`
      : html`<${Still} key=${what} name=${name} what=${what} bin=${bin} label=${label.value} />`}
      <figcaption class="row spread"><h1 tabindex="-1"><code>${name}</code></h1><button class="button" onClick=${copy}><${Icon} name="copy" />Copy <kbd>${hint("gallery.copy")}</kbd></button>
        <span class="muted">${sample ? timeOfDay(sample.captured_at) : ""} ${word}${px === null ? "" : ` ${px.toFixed(2)} px`}</span>
        <${PictureTools} depth=${Boolean(files.depth)} hold=${false} split=${Boolean(files.original)} /></figcaption></figure>
    <${Overlays} />
    ${sample?.objects.length ? html`<${Objects} objects=${sample.objects} />` : ""}</article>`;
}
