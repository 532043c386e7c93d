// A picture on the page: canvases, the words that say which picture it is, and how old.
import {useEffect, useRef} from "preact/hooks";
import {html} from "../html.js";
import * as state from "../state.js";
import {bigPicture} from "../actions.js";
import {span, timeOfDay} from "../format.js";
import {Painter} from "./painter.js";

/** The sentence a screen reader hears instead of the picture. */
export function sentence(camera, header) {
  if (!header) return `${camera}: no picture yet`;
  const objects = header.label?.objects ?? [];
  if (!header.label) return `${camera}: picture without labels`;
  if (!objects.length) return `${camera}: no object in view`;
  return `${camera}: ${objects.map((o) => `${o.name}, ${[...new Set(o.sides.map((s) => s.class))].join(" and ") || o.pose_source}, ${Math.round(o.distance_mm)} mm`).join("; ")}`;
}

const Canvases = () => html`<canvas class="picture"></canvas><canvas class="over"></canvas>`;

function usePainter(root, options, deps, whenReady) {
  useEffect(() => {
    if (!root.current) return undefined;
    const painter = new Painter(root.current, options);
    whenReady?.(painter);
    return () => { whenReady?.(null); painter.close(); };
  }, deps);
}

/** What is wrong with the picture, in words over it; nothing while all is well. */
function Trouble({camera, header, labels = true}) {
  const phase = state.topics.status.value?.cameras?.[camera];
  if (state.heldStill.value) return html`<p class="trouble held">Held still at ${header ? timeOfDay(Date.now() - header.age_ms) : ""} · press H to go on</p>`;
  if (!header || header.stale) {
    const age = header ? header.age_ms / 1000 : phase?.frame_age_s;
    const gone = age === null || age === undefined ? "No picture yet." : `No picture for ${span(age)}.`;
    const why = phase && !phase.present ? `${camera}: ${phase.last_error ?? "is away"}. Check its cable. Trying again.` : "";
    if (!header && !why) return html`<p class="trouble quiet">${gone}</p>`;
    return html`<p class="trouble"><strong>${gone}</strong> ${why}</p>`;
  }
  if (labels && header.late) {
    const title = state.words.value[header.why]?.title ?? "Labels are late.";
    return html`<p class="trouble chiplike">${title} Overlays are hidden.</p>`;
  }
  return null;
}

export function Caption({camera, kind, header}) {
  return html`<p class="caption-line number">
    <strong>${camera}</strong>
    <span>${{depth: "Depth", after: "Before | after"}[kind] ?? "RGB"}</span>
    ${header && html`<span>frame ${header.frame}</span><span>${header.fps === null ? "–" : header.fps.toFixed(1)}/s</span>
      <span>${header.age_ms > 1000 + header.drawn_age_ms ? html`<strong class="warn">${(header.age_ms / 1000).toFixed(1)} s old</strong>` : `${Math.round(header.drawn_age_ms)} ms`}</span>
      <span class="optional">${header.source_size[0]}×${header.source_size[1]}${header.reduced ? " · reduced for this connection" : ""}</span>`}
  </p>`;
}

/** `big`: the one that the keys and the record button mean. */
export function Stage({id, camera, kind = "rgb", big = false, chosen = null, extra = null, guidance = null}) {
  const root = useRef();
  const own = useRef(null);
  const header = state.drawn.value[id];
  usePainter(root, {id, camera, kind, chosen, extra}, [id, camera, kind, chosen, extra], (painter) => {
    own.current = painter;
    if (big) bigPicture.painter = painter;
  });
  useEffect(() => { own.current?.guide(guidance); }, [guidance, extra]);
  return html`<div class="stage" ref=${root} tabindex="-1" role="img" data-view=${id} data-kind=${kind} aria-label=${useSentence(camera, header)}>
    <${Canvases} /><${Trouble} camera=${camera} header=${header} labels=${!extra} /></div>`;
}

/** Renewed at most every two seconds. */
function useSentence(camera, header) {
  const kept = useRef({at: -Infinity, text: ""});
  const text = sentence(camera, header);
  if (performance.now() - kept.current.at > 2000 || !kept.current.text.startsWith(camera)) kept.current = {at: performance.now(), text};
  return kept.current.text;
}

/** Before | after with a divider: both sides show the same frame. */
export function SplitStage({camera}) {
  const left = useRef();
  const right = useRef();
  const before = useRef(null);
  const [id, after] = [`before-${camera}`, `after-${camera}`];
  const at = state.divider.value;
  usePainter(left, {id, camera, kind: "rgb", follows: true}, [camera], (painter) => { before.current = painter; bigPicture.painter = painter; });
  usePainter(right, {id: after, camera, kind: "after", onDrawn: (header) => before.current?.show(header.frame)}, [camera]);
  const header = state.drawn.value[after];
  return html`<div class="split" style=${{"--at": `${at}%`}}>
    <div class="stage" ref=${left} tabindex="-1" role="img" data-view=${id} data-kind="rgb" aria-label=${useSentence(camera, state.drawn.value[id])}>
      <${Canvases} /></div>
    <div class="stage after" ref=${right} role="img" data-view=${after} data-kind="after" aria-label=${`${camera} with the markers erased`}>
      <${Canvases} />${!header && html`<p class="trouble quiet">Erasing the markers…</p>`}</div>
    <span class="split-word before" aria-hidden="true">Before</span><span class="split-word behind" aria-hidden="true">After</span>
    <input class="divider" type="range" min="0" max="100" value=${at} aria-label="Divider between before and after"
      onInput=${(event) => { state.divider.value = Number(event.currentTarget.value); }} />
  </div>`;
}

/** Depth's colours with millimetres. */
export function Legend({header}) {
  const [low, high] = header?.depth_range_mm ?? [null, null];
  if (low === null) return null;
  return html`<p class="legend number"><span>${Math.round(low)} mm</span><span class="viridis" aria-hidden="true"></span>
    <span>${Math.round(high)} mm</span><span class="muted"><span class="hatch" aria-hidden="true"></span> no depth there</span></p>`;
}
