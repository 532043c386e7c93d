// Equal tiles, the newest first; one of them is in the Tab order, arrows move.
import {useEffect, useRef} from "preact/hooks";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {sampleUrl} from "../api.js";
import {timeOfDay} from "../format.js";
import {quality} from "./model.js";

function words(sample) {
  const objects = sample.objects.map((one) => `${one.name} ${one.sides.join(" and ")} ${Math.round(one.distance_mm)} mm`).join("; ");
  const {word} = quality(sample);
  return `${timeOfDay(sample.captured_at)} ${sample.camera}: ${objects || "no object"}, ${word}`;
}

/** A picture that could not be read (the store was restarting) is asked for once more. */
function again({currentTarget: image}) {
  if (image.dataset.again) return;
  image.dataset.again = "1";
  setTimeout(() => { image.src = `${image.src}${image.src.includes("?") ? "&" : "?"}again=1`; }, 1000);
}

function Tile({sample, at, chosen, focused, bin, choose, open}) {
  const {word, px} = quality(sample);
  const [first] = sample.objects;
  return html`<div role="gridcell" class="tile" tabindex=${focused ? 0 : -1} data-at=${at} data-name=${sample.name} aria-selected=${String(chosen)} title=${words(sample)}
      onClick=${(event) => (event.shiftKey || event.ctrlKey || event.metaKey ? choose(at, {extend: event.shiftKey}) : open(sample.name))}>
    <img src=${sampleUrl(sample.name, "thumb", bin)} alt="" loading="lazy" width="320" height="180" onError=${again} />
    <button class="tick" tabindex="-1" aria-hidden="true" onClick=${(event) => { event.stopPropagation(); choose(at, {extend: event.shiftKey}); }}>${chosen && html`<${Icon} name="check" />`}</button>
    <p class="row spread"><strong class="number">${timeOfDay(sample.captured_at)}</strong><span class="muted">${sample.camera}</span></p>
    <p class="row spread small"><span>${first ? `${first.name}${sample.objects.length > 1 ? ` +${sample.objects.length - 1}` : ""}` : ""}</span>
      <span class=${["sharp", "good", "background"].includes(word) ? "muted" : "warn"}>${word}${px === null ? "" : html` <span class="number">${px.toFixed(2)}</span>`}</span></p></div>`;
}

export function Grid({samples, chosen, focusAt, bin, choose, open, columns}) {
  const grid = useRef();
  const across = useRef(1);
  useEffect(() => {
    if (!grid.current) return undefined;
    const count = () => {
      if (!grid.current?.isConnected) return;
      across.current = getComputedStyle(grid.current.firstElementChild).gridTemplateColumns.split(" ").length;
      columns(across.current);
    };
    const sizes = new ResizeObserver(count);
    sizes.observe(grid.current);
    count();
    return () => sizes.disconnect();
  }, [state.settings.value.tile]);
  return html`<div class="grid" role="grid" aria-label="Samples, the newest first" aria-multiselectable="true" ref=${grid} style=${{"--tile": `${state.settings.value.tile}px`}}>
    <div role="row" class="grid-row">${samples.map((sample, at) => html`<${Tile} key=${sample.name} sample=${sample} at=${at} chosen=${chosen.has(sample.name)}
      focused=${at === focusAt} bin=${bin} choose=${choose} open=${open} />`)}</div></div>`;
}
