// Charts: a row's sparkline in own lines, the large ones by uPlot, which is loaded when Health opens.
import {useEffect, useRef} from "preact/hooks";
import {html} from "../html.js";
import * as state from "../state.js";
import {KEPT, history, total} from "./history.js";

export function Spark({values}) {
  const canvas = useRef();
  useEffect(() => {
    if (!canvas.current) return;
    const context = canvas.current.getContext("2d");
    const {width, height} = canvas.current;
    const most = Math.max(1, ...values.map((n) => n ?? 0));
    context.clearRect(0, 0, width, height);
    context.strokeStyle = getComputedStyle(canvas.current).color;
    context.lineWidth = 2;
    context.beginPath();
    values.forEach((n, i) => context[i ? "lineTo" : "moveTo"]((i / Math.max(1, values.length - 1)) * width, height - 3 - ((n ?? 0) / most) * (height - 6)));
    context.stroke();
  });
  return html`<canvas class="spark" ref=${canvas} width="240" height="48" aria-hidden="true"></canvas>`;
}

let loading = null;
function uPlot() {
  loading ??= new Promise((resolve, reject) => {
    const style = Object.assign(document.createElement("link"), {rel: "stylesheet", href: "/static/vendor/uPlot.min.css"});
    const script = Object.assign(document.createElement("script"), {src: "/static/vendor/uPlot.iife.min.js"});
    script.onload = () => resolve(window.uPlot);
    script.onerror = reject;
    document.head.append(style, script);
  });
  return loading;
}

const PENS = [["--accent", []], ["--good", [8, 4]], ["--warn", [3, 3]]];

/** `series`: [{label, kind, field}] drawn over five minutes; lines differ by dash as well as by colour. */
export function Chart({title, unit, series}) {
  const place = useRef();
  const plot = useRef(null);
  useEffect(() => {
    let gone = false;
    uPlot().then((Plot) => {
      if (gone || !place.current) return;
      const style = getComputedStyle(place.current);
      const ink = (name) => style.getPropertyValue(name).trim();
      const axis = {stroke: ink("--muted"), grid: {stroke: ink("--hair"), width: 1}, ticks: {stroke: ink("--hair")}, font: "12px system-ui"};
      plot.current = new Plot({
        width: place.current.clientWidth, height: 180, cursor: {show: false}, legend: {show: false},
        scales: {x: {time: true, range: (_, low, high) => [high - KEPT, high]}, y: {range: (_, low, high) => [0, Math.max(1, high * 1.1)]}},
        axes: [axis, {...axis, size: 56, values: (_, ticks) => ticks.map((tick) => `${tick}`)}],
        series: [{}, ...series.map(({label}, i) => ({label, stroke: ink(PENS[i][0]), width: 2, dash: PENS[i][1], points: {show: false}}))],
      }, data(series), place.current);
    }).catch(() => { /* the table above says the same in numbers */ });
    return () => { gone = true; plot.current?.destroy(); plot.current = null; };
  }, [state.theme.value]);
  useEffect(() => { plot.current?.setData(data(series)); }, [history.at(-1)?.at]);
  useEffect(() => {
    if (!place.current) return undefined;
    const sizes = new ResizeObserver(() => plot.current?.setSize({width: place.current?.clientWidth ?? 300, height: 180}));
    sizes.observe(place.current);
    return () => sizes.disconnect();
  }, []);
  return html`<figure class="panel chart"><figcaption class="row spread"><h2>${title}</h2>
    <p class="legend small">${series.map(({label, kind, field}, i) => html`<span><i class="pen" data-pen=${i} aria-hidden="true"></i> ${label}
      <b class="number">${round(history.length ? total(history.at(-1), kind, field) : null)}</b></span>`)}<span class="muted">${unit}</span></p></figcaption>
    <div ref=${place} aria-hidden="true"></div></figure>`;
}

const round = (n) => (n === null ? "–" : n.toFixed(1));

const data = (series) => [history.map((one) => one.at), ...series.map(({kind, field}) => history.map((one) => total(one, kind, field)))];
