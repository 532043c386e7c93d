// One view's two canvases: the newest picture, and its own label over it. Acknowledged when drawn, never queued.
import {effect} from "@preact/signals";
import * as state from "../state.js";
import {acknowledge, unwatch, watch} from "../socket.js";
import {paint, strokes} from "./overlay.js";

const STALE_MS = 1000;
/** Erasing takes its time: in the split a picture is dated after a second and dimmed after three. */
const SPLIT_STALE_MS = 3000;
const KEPT = 12;

export class Painter {
  /**
   * `root` holds the canvases; `follows`: frames are kept and drawn when `show` names them (the split's left side);
   * `extra`: makes what is drawn, instead of the label, of what `guide` was given last.
   */
  constructor(root, {id, camera, kind, chosen = null, follows = false, onDrawn = null, extra = null}) {
    Object.assign(this, {root, id, camera, kind, chosen, follows, onDrawn, extra});
    this.guidance = null;
    [this.picture, this.over] = root.querySelectorAll("canvas");
    this.pending = null;
    this.latest = 0;
    this.kept = new Map();
    this.header = null;
    this.times = [];
    this.closed = false;
    this.led = 0;
    this.labelled = performance.now();
    this.sizes = new ResizeObserver(() => this.resized());
    this.sizes.observe(root);
    this.seen = new IntersectionObserver(([entry]) => { this.inView = entry.isIntersecting; this.wish(); });
    this.seen.observe(root);
    this.stops = [
      effect(() => { state.heldStill.value; this.wish(); }),
      effect(() => { state.overlays.value; this.overlay(); }),
      effect(() => { state.now.value; this.report(); }),
    ];
  }

  close() {
    this.closed = true;
    for (const stop of this.stops) stop();
    this.sizes.disconnect();
    this.seen.disconnect();
    unwatch(this.id);
    this.pending?.bitmap.close();
    for (const {bitmap} of this.kept.values()) bitmap.close();
    const {[this.id]: _, ...others} = state.drawn.peek();
    state.drawn.value = others;
  }

  /** Ask for pictures as wide as they are shown, in device pixels; none while out of sight or held still. */
  wish() {
    const width = Math.round((this.root.clientWidth || 320) * devicePixelRatio);
    if (this.inView === false || state.heldStill.peek()) unwatch(this.id);
    else watch(this.id, {camera: this.camera, kind: this.kind, width: Math.max(16, width)}, (header, blob) => this.take(header, blob));
  }

  resized() {
    this.wish();
    this.overlay();
  }

  async take(header, blob) {
    const order = (this.latest += 1);
    let bitmap;
    try {
      bitmap = await createImageBitmap(blob);
    } catch {
      acknowledge(this.id, header.seq); // a picture that can't be decoded is a skipped frame
      return;
    }
    header.received = performance.now();
    if (this.closed || (this.pending && this.pending.order > order)) return this.skip(bitmap, header);
    if (this.pending) this.skip(this.pending.bitmap, this.pending.header);
    const waiting = this.pending !== null;
    this.pending = {bitmap, header, order};
    if (!waiting) requestAnimationFrame(() => this.frame());
  }

  skip(bitmap, header) {
    bitmap.close();
    acknowledge(this.id, header.seq);
  }

  frame() {
    const {pending} = this;
    this.pending = null;
    if (!pending) return;
    if (this.closed) return pending.bitmap.close();
    this.follows ? this.keep(pending) : this.draw(pending);
    if (!this.follows) pending.bitmap.close();
    acknowledge(this.id, pending.header.seq);
  }

  /** Keep the newest few; drawn at once when nobody has led for a second. */
  keep(pending) {
    this.kept.set(pending.header.frame, pending);
    for (const [frame, old] of this.kept) {
      if (this.kept.size <= KEPT) break;
      old.bitmap.close();
      this.kept.delete(frame);
    }
    if (performance.now() - this.led > STALE_MS) this.draw(pending);
  }

  /** Draw the kept picture of this very frame, or the nearest before it. */
  show(frame) {
    const best = [...this.kept.values()].filter((one) => one.header.frame <= frame).at(-1);
    if (!best) return;
    this.led = performance.now();
    this.draw(best);
  }

  draw({bitmap, header}) {
    const {picture} = this;
    if (picture.width !== bitmap.width || picture.height !== bitmap.height) {
      picture.width = bitmap.width;
      picture.height = bitmap.height;
      this.root.style.setProperty("--ratio", `${header.source_size[0]} / ${header.source_size[1]}`);
    }
    picture.getContext("2d").drawImage(bitmap, 0, 0);
    const first = this.header === null;
    this.header = header;
    if (header.label) this.labelled = performance.now();
    this.times.push(performance.now());
    if (this.times.length > 60) this.times.shift();
    this.root.label = header.label;
    this.root.dataset.frame = header.frame;
    this.root.dataset.boot = header.boot;
    this.overlay();
    if (first) this.report();
    this.onDrawn?.(header);
  }

  /** The label of the picture that is drawn, on device pixels; nothing where it has none. */
  overlay() {
    const {header, over, root} = this;
    if (!header) return;
    const [w, h] = header.source_size;
    const ratio = devicePixelRatio;
    const fit = Math.min(root.clientWidth / w, root.clientHeight / h);
    const [width, height] = [Math.max(1, Math.round(w * fit * ratio)), Math.max(1, Math.round(h * fit * ratio))];
    if (over.width !== width || over.height !== height) {
      over.width = width;
      over.height = height;
    }
    const show = state.overlays.peek();
    const own = this.extra ? this.extra(this.guidance) : show.on ? strokes(header.label, show, this.chosen) : [];
    const list = root.hasAttribute("data-stale") ? [] : own;
    paint(over.getContext("2d"), list, {width, height, scale: width / w, ratio});
  }

  /** Draw this over the picture from now on. */
  guide(guidance) {
    this.guidance = guidance;
    this.overlay();
  }

  /** Twice a second: how old, how many a second; a picture older than a second is dimmed. */
  report() {
    const {header} = this;
    if (!header) return;
    const moment = performance.now();
    const age_ms = header.age_ms + moment - header.received;
    const limit = this.follows || this.kind === "after" ? SPLIT_STALE_MS : STALE_MS;
    const stale = age_ms > limit && !state.heldStill.peek();
    if (stale !== this.root.hasAttribute("data-stale")) {
      this.root.toggleAttribute("data-stale", stale);
      this.overlay();
    }
    const recent = this.times.filter((at) => moment - at < 2000);
    const fps = recent.length > 1 ? ((recent.length - 1) * 1000) / (recent.at(-1) - recent[0]) : null;
    state.drawn.value = {...state.drawn.peek(), [this.id]: {...header, drawn_age_ms: header.age_ms, age_ms, stale, late: moment - this.labelled > STALE_MS, fps: stale ? 0 : fps}};
  }

  /** The frame as the operator sees it now, while it is younger than `ms`. */
  fresh(ms) {
    return this.header && this.header.age_ms + performance.now() - this.header.received < ms ? this.header.frame : null;
  }
}
