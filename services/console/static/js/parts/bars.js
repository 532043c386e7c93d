// Bars under the top bar: what keeps the page or its keys from working.
import {html, Icon} from "../html.js";
import * as state from "../state.js";

export function Bars({focused}) {
  const lost = {lost: "No connection to tagmill. Trying again.", refused: state.connectionWhy.value}[state.connection.value];
  return html`<div class="bars">
    ${lost && html`<p class="bar fault"><${Icon} name="unplug" /><span>${lost} ${state.connection.value === "lost" ? state.connectionWhy.value : ""}
      The recording goes on without this page.</span></p>`}
    ${!focused && state.settings.value.singleKeys && html`<p class="bar"><${Icon} name="keyboard" />Click here, then the keys work.</p>`}
  </div>`;
}
