// What is said aloud by a screen reader, at most once a second, and the short line at the bottom.
import {useSignal} from "@preact/signals";
import {useEffect, useRef} from "preact/hooks";
import {html} from "../html.js";
import * as state from "../state.js";

export function Spoken() {
  const polite = useSignal("");
  const urgent = useSignal("");
  const last = useRef(0);
  const timer = useRef(0);
  const {text, urgent: now} = state.spoken.value;
  useEffect(() => {
    if (now) { urgent.value = text; return; }
    clearTimeout(timer.current);
    timer.current = setTimeout(() => {
      last.current = Date.now();
      polite.value = state.spoken.peek().text;
    }, Math.max(0, 1000 - (Date.now() - last.current)));
  }, [state.spoken.value]);
  return html`<div class="visually-hidden" role="status" aria-live="polite">${polite.value}</div>
    <div class="visually-hidden" role="alert" aria-live="assertive">${urgent.value}</div>`;
}

export function Toast() {
  const toast = state.toast.value;
  if (!toast) return null;
  return html`<div class="toast"><span>${toast.text}</span>${toast.action && html`
    <button class="button" onClick=${() => { state.toast.value = null; toast.action.run(); }}>${toast.action.text}</button>`}</div>`;
}
