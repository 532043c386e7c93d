// Templates without a build step: htm bound to preact, and the icon that stands beside a word.
import {h} from "preact";
import htm from "htm";

export const html = htm.bind(h);

export const Icon = ({name}) =>
  html`<svg class="icon" viewBox="0 0 24 24" fill="none" stroke-width="2" stroke-linecap="round" stroke-linejoin="round"
    aria-hidden="true"><use href=${`/static/vendor/icons.svg#${name}`} /></svg>`;
