// The one socket: state as text, pictures as binary, and the wish what to show. Commands never go this way.
import * as state from "./state.js";
import {getJson} from "./api.js";

const FIRST_MS = 250;
const LONGEST_MS = 5000;
const PING_MS = 5000;
const SILENT_MS = 15000;
const REFUSED = {4401: "The access was changed. Open the address with its token again.", 4403: "This address is not allowed here."};

/** Views that want pictures: id → {camera, kind, width, draw(header, blob)}. */
const views = new Map();
let socket = null;
let wait = FIRST_MS;
let retry = 0;
let heard = 0;
let wished = "";
let wishing = false;

export function watch(id, wish, draw) {
  views.set(id, {...wish, draw});
  wishSoon();
}

export function unwatch(id) {
  views.delete(id);
  wishSoon();
}

export function acknowledge(id, seq) {
  send({t: "ack", id, seq});
}

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** All changes of one turn make one message. */
function wishSoon() {
  if (wishing) return;
  wishing = true;
  queueMicrotask(() => {
    wishing = false;
    const visible = document.visibilityState === "visible";
    const wish = [...views].map(([id, {camera, kind, width}]) => ({id, camera, kind, width}));
    const text = JSON.stringify({t: "watch", views: visible ? wish : [], visible});
    if (text !== wished && socket?.readyState === WebSocket.OPEN) {
      wished = text;
      socket.send(text);
    }
  });
}

export function connect() {
  clearTimeout(retry);
  if (socket && socket.readyState <= WebSocket.OPEN) return;
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const mine = new WebSocket(`${scheme}://${location.host}/ws`);
  socket = mine;
  mine.binaryType = "arraybuffer";
  mine.onopen = () => {
    heard = Date.now();
    wished = "";
    send({t: "hello", v: 1});
    wishSoon();
  };
  mine.onmessage = ({data}) => {
    heard = Date.now();
    if (typeof data === "string") takeText(JSON.parse(data));
    else takePicture(data);
  };
  mine.onclose = ({code}) => {
    if (socket !== mine) return;
    socket = null;
    if (REFUSED[code]) {
      state.connectionWhy.value = REFUSED[code];
      state.connection.value = "refused";
      return;
    }
    if (state.connection.value !== "connecting") state.connection.value = "lost";
    retry = setTimeout(connect, wait * (0.75 + Math.random() / 2));
    wait = Math.min(wait * 2, LONGEST_MS);
    checkAccess();
  };
}

/** A refused handshake tells a browser nothing: ask plainly whether it is the access. */
async function checkAccess() {
  const answer = await getJson("/api/status");
  if (answer.status === 401 || answer.status === 403) {
    clearTimeout(retry);
    state.connectionWhy.value = REFUSED[answer.status === 401 ? 4401 : 4403];
    state.connection.value = "refused";
  }
}

function takeText(message) {
  if (message.t === "state") {
    if (state.connection.value !== "open") opened();
    state.takeState(message.topic, message.data);
  } else if (message.t === "event") {
    const missed = state.lastEvent.value && message.n > state.lastEvent.value + 1;
    if (missed) catchUp();
    else if (message.n > state.lastEvent.value) state.takeEvent(message);
  } else if (message.t === "bye") {
    state.connectionWhy.value = message.why ?? "";
  }
}

function opened() {
  wait = FIRST_MS;
  state.connectionWhy.value = "";
  state.connection.value = "open";
  catchUp();
}

let catching = false;
/** Events that went by while the page was away (or hidden behind a gap) are asked for. */
async function catchUp() {
  if (catching) return;
  catching = true;
  const {ok, body} = await getJson(`/api/events?after=${state.lastEvent.value}`);
  catching = false;
  if (!ok) return;
  if (body.last < state.lastEvent.value) state.lastEvent.value = 0; // the console itself is a new one
  for (const event of body.events) if (event.n > state.lastEvent.value) state.takeEvent(event);
}

function takePicture(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const view = views.get(header.id);
  if (view) view.draw(header, new Blob([new Uint8Array(buffer, 4 + length)], {type: "image/jpeg"}));
  else acknowledge(header.id, header.seq);
}

export function keepConnected() {
  connect();
  addEventListener("online", connect);
  document.addEventListener("visibilitychange", () => {
    if (document.visibilityState === "visible") connect();
    wishSoon();
  });
  setInterval(() => {
    send({t: "ping"});
    if (socket?.readyState === WebSocket.OPEN && Date.now() - heard > SILENT_MS) socket.close();
  }, PING_MS);
}
