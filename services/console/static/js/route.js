// Views are real addresses: /live, /gallery?object=box-1; back and forward work.
import {signal} from "@preact/signals";

export const VIEWS = [
  {id: "live", title: "Live", icon: "camera"},
  {id: "coverage", title: "Coverage", icon: "globe"},
  {id: "health", title: "Health", icon: "activity"},
  {id: "setup", title: "Set-up", icon: "list-checks"},
  {id: "gallery", title: "Gallery", icon: "images"},
];

function read() {
  const id = location.pathname.slice(1);
  return {view: VIEWS.some((one) => one.id === id) ? id : "live", query: Object.fromEntries(new URLSearchParams(location.search))};
}

export const route = signal(read());

export function go(path, {replace = false} = {}) {
  if (path === location.pathname + location.search) return;
  history[replace ? "replaceState" : "pushState"](null, "", path);
  route.value = read();
}

/** Change one part of the query; null removes it. */
export function ask(changes, options) {
  const query = {...route.value.query, ...changes};
  const wanted = Object.entries(query).filter(([, value]) => value !== null && value !== "");
  const text = new URLSearchParams(wanted).toString();
  go(location.pathname + (text ? `?${text}` : ""), options);
}

export function listen() {
  addEventListener("popstate", () => { route.value = read(); });
  document.addEventListener("click", (event) => {
    const link = event.target.closest?.("a[href^='/']");
    if (!link || link.target || link.hasAttribute("download") || event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
    const path = link.getAttribute("href");
    if (!VIEWS.some((one) => path.split("?")[0] === `/${one.id}`)) return;
    event.preventDefault();
    go(path);
  });
}
