import {signal} from "@preact/signals";
import {html} from "../html.js";
export const openedSample = signal(null);
export const Gallery = () => html`<h1>Gallery</h1>`;
