// Five minutes of numbers, one a second, from what the stack reports.
import {effect} from "@preact/signals";
import * as state from "../state.js";

export const KEPT = 300;
/** Each: {at (s), services: {name: {rate, p50, p99, dropped, alive}}, backlog}. */
export const history = [];

/** The one rate that matters of a service: the first one, which is its main. */
export const rateOf = (service) => Object.entries(service.rates ?? {})[0]?.[1] ?? null;
export const lostOf = (service) => Object.entries(service.dropped ?? {}).reduce((sum, [, n]) => sum + n, 0);

function point(status) {
  const services = Object.fromEntries(Object.entries(status.services ?? {}).map(([name, one]) => [name, {
    rate: one.alive ? rateOf(one) : 0, p50: one.numbers?.latency_p50_ms ?? null, p99: one.numbers?.latency_p99_ms ?? null,
    dropped: lostOf(one), alive: one.alive,
  }]));
  return {at: Date.now() / 1000, services, backlog: status.backlog ?? 0};
}

effect(() => {
  const status = state.topics.status.value;
  if (!status?.services) return;
  const made = point(status);
  if (history.length && made.at - history.at(-1).at < 0.9) return;
  history.push(made);
  if (history.length > KEPT) history.shift();
});

/** The services of one kind ("detect") added up at a moment; null where none reports. */
export function total(moment, kind, field = "rate") {
  const all = Object.entries(moment.services).filter(([name]) => name.split(".")[0] === kind).map(([, one]) => one[field]).filter((n) => n !== null);
  return all.length ? (field === "rate" || field === "dropped" ? all.reduce((a, b) => a + b, 0) : Math.max(...all)) : null;
}
