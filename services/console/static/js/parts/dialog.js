// Dialogs are the browser's own: focus is kept inside and given back.
import {signal} from "@preact/signals";
import {useEffect, useRef} from "preact/hooks";
import {html, Icon} from "../html.js";
import * as state from "../state.js";
import {set} from "../actions.js";
import {KEYS, SCOPE_TITLES, shown} from "../keys.js";
import {Notes} from "./notes.js";

/** Which dialog is open: keys, notes or null. */
export const opened = signal(null);

export function open(name) {
  opened.value = name;
  if (name === "notes") state.unread.value = 0;
}

function Dialog({name, title, children}) {
  const self = useRef();
  useEffect(() => {
    if (opened.value === name && !self.current.open) self.current.showModal();
    if (opened.value !== name && self.current.open) self.current.close();
  }, [opened.value]);
  return html`<dialog ref=${self} aria-labelledby=${`${name}-title`} onClose=${() => { if (opened.value === name) opened.value = null; }}>
    <div class="row spread"><h2 id=${`${name}-title`}>${title}</h2>
      <button class="button" onClick=${() => self.current.close()}><${Icon} name="x" />Close</button></div>
    ${opened.value === name && children}</dialog>`;
}

function Keys() {
  const {sound, singleKeys} = state.settings.value;
  const scopes = Object.entries(SCOPE_TITLES);
  return html`<div class="stack">
    <div class="row">
      <label class="choice"><input type="checkbox" checked=${sound} onChange=${() => set({sound: !sound})} />Sounds: a tick when saved, two low tones when refused</label>
      <label class="choice"><input type="checkbox" checked=${!singleKeys} onChange=${() => set({singleKeys: !singleKeys})} />Single keys off</label>
      <label class="choice">Colours <select value=${state.theme.value} onChange=${(e) => { state.theme.value = e.currentTarget.value; }}>
        <option value="auto">as the system</option><option value="light">light</option><option value="dark">dark</option></select></label>
    </div>
    <div class="keys">${scopes.map(([scope, title]) => html`<section><h3>${title}</h3><dl>${KEYS.filter((one) => one.scope === scope).map((one) => html`
      <dt><kbd>${shown(one)}</kbd></dt><dd>${one.words}</dd>`)}</dl></section>`)}</div></div>`;
}

export const Dialogs = () => html`
  <${Dialog} name="keys" title="Keys and settings"><${Keys} /><//>
  <${Dialog} name="notes" title="Notes"><${Notes} /><//>`;
