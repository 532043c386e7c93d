// A tick for a durable sample, two low tones for a refusal: heard at the object, two metres from the screen.
import {settings} from "./state.js";

let audio = null;

/** Browsers let a page sound only after a key or a press. */
export function unlock() {
  audio ??= typeof AudioContext === "function" ? new AudioContext() : null;
  if (audio?.state === "suspended") audio.resume();
}

function tone(hertz, start_s, length_s, volume) {
  const at = audio.currentTime + start_s;
  const source = new OscillatorNode(audio, {frequency: hertz, type: "sine"});
  const gain = new GainNode(audio, {gain: 0});
  gain.gain.setValueAtTime(0, at);
  gain.gain.linearRampToValueAtTime(volume, at + 0.005);
  gain.gain.exponentialRampToValueAtTime(0.001, at + length_s);
  source.connect(gain).connect(audio.destination);
  source.start(at);
  source.stop(at + length_s);
}

let last = 0;
/** `what`: saved or refused; at most eight a second. */
export function sound(what) {
  if (!settings.peek().sound || audio?.state !== "running" || Date.now() - last < 125) return;
  last = Date.now();
  if (what === "saved") tone(1760, 0, 0.06, 0.15);
  else for (const start of [0, 0.16]) tone(196, start, 0.14, 0.25);
}
