// The page put together: frame, view, keys, and the six places that say the record state.
import {render} from "preact";
import {effect, useSignal} from "@preact/signals";
import {useEffect} from "preact/hooks";
import {html} from "./html.js";
import * as state from "./state.js";
import {phaseIs, run} from "./actions.js";
import {getJson} from "./api.js";
import {SCOPES, match} from "./keys.js";
import {STATE_WORDS} from "./live/modes.js";
import {Live} from "./live/view.js";
import {Coverage} from "./coverage/view.js";
import {Health} from "./health/view.js";
import {Setup} from "./setup/view.js";
import {Gallery, openedSample} from "./gallery/view.js";
import {Bars} from "./parts/bars.js";
import {Dialogs, open, opened} from "./parts/dialog.js";
import {Spoken, Toast} from "./parts/spoken.js";
import {TopBar} from "./parts/topbar.js";
import {VIEWS, go, listen, route} from "./route.js";
import {keepConnected} from "./socket.js";
import {sound, unlock} from "./sound.js";

const PAGES = {live: Live, coverage: Coverage, health: Health, setup: Setup, gallery: Gallery};

function App() {
  const {view} = route.value;
  const Page = PAGES[view];
  const focused = useSignal(document.hasFocus());
  useEffect(() => {
    const look = () => { focused.value = document.hasFocus(); };
    for (const name of ["focus", "blur"]) addEventListener(name, look);
    return () => { for (const name of ["focus", "blur"]) removeEventListener(name, look); };
  }, []);
  return html`<a class="skip button primary" href="#main">To the content</a>
    <${TopBar} /><${Bars} focused=${focused.value} />
    <main id="main" tabindex="-1" key=${view}><${Page} /></main>
    <${Toast} /><${Spoken} /><${Dialogs} />`;
}

/** Title, favicon and the frame round the page; the button, the top bar and the live region read the same signal. */
function showState() {
  const phase = state.phase.value;
  const record = state.topics.record.value;
  document.documentElement.dataset.phase = phase;
  const number = phase === "recording" ? record.count : state.stored.value ?? "";
  const sign = {ready: "○", asked: "◌", recording: "●", finishing: "◐", cannot: "▲", unknown: "▨"}[phase];
  const view = VIEWS.find((one) => one.id === route.value.view).title;
  document.title = `${sign} ${number} ${phase === "ready" ? view : STATE_WORDS[phase].toLowerCase()} · tagmill`;
  const icon = document.getElementById("favicon");
  const wanted = `/static/icons/${phase}.svg`;
  if (icon.getAttribute("href") !== wanted) icon.setAttribute("href", wanted);
  phaseIs(phase);
}

let spokenPhase = "";
function speakState() {
  const phase = state.phase.value;
  if (phase === spokenPhase) return;
  if (spokenPhase) state.say(STATE_WORDS[phase].toLowerCase(), spokenPhase === "recording" && ["cannot", "unknown"].includes(phase));
  spokenPhase = phase;
}

/** An opened sample and a calibration have keys of their own. */
function scopesNow() {
  const {view, query} = route.value;
  if (view === "gallery" && openedSample.value) return SCOPES.opened;
  return view === "setup" && query.calibrate ? SCOPES.calibrate : SCOPES[view];
}

function keyDown(event) {
  unlock();
  const target = event.target;
  const scopes = scopesNow();
  const found = match({
    key: event.key, code: event.code, shiftKey: event.shiftKey, ctrlKey: event.ctrlKey, altKey: event.altKey,
    metaKey: event.metaKey, repeat: event.repeat, isComposing: event.isComposing,
    target: {
      tag: target.localName, type: target.type, role: target.getAttribute?.("role"), editable: target.isContentEditable,
      focusVisible: target.matches?.(":focus-visible"),
    },
  }, scopes, {singleKeys: state.settings.value.singleKeys, dialogOpen: opened.value !== null});
  if (!found) return;
  event.preventDefault();
  if (found.command === "keys" || found.command === "notes") open(found.command);
  else if (found.command === "filter") toFilter();
  else if (found.command === "back") target.blur?.(), run("back");
  else run(found.command, event);
}

function toFilter() {
  go("/gallery");
  requestAnimationFrame(() => document.querySelector("#filter select")?.focus());
}

/** Space is prevented on both ways of the key, or a focused button would still be pressed. */
function keyUp(event) {
  const record = scopesNow().some((one) => one === "record" || one === "calibrate");
  const own = event.target.matches?.("button:focus-visible, a:focus-visible, input, select, textarea, summary:focus-visible");
  if (event.code === "Space" && record && !own && opened.value === null) event.preventDefault();
}

async function learn() {
  const [rig, words] = await Promise.all([getJson("/api/rig"), getJson("/api/words")]);
  if (rig.ok) state.rig.value = rig.body;
  if (words.ok) state.words.value = words.body;
}

let heard = 0;
function hearEvents() {
  const [note] = state.notes.value;
  if (!note || note.n === heard) return;
  const old = heard === 0 && Date.now() - Date.parse(note.time) > 3000;
  heard = note.n;
  if (!old && (note.kind === "saved" || note.kind === "refused")) sound(note.kind);
}

listen();
effect(showState);
effect(speakState);
effect(hearEvents);
effect(() => { if (state.connection.value === "open") learn(); });
effect(() => {
  if (state.theme.value === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = state.theme.value;
});
addEventListener("keydown", keyDown);
addEventListener("keyup", keyUp);
addEventListener("pointerdown", unlock, {passive: true});
const root = document.getElementById("app");
root.replaceChildren();
render(html`<${App} />`, root);
keepConnected();
