import {html} from "../html.js";
export const Setup = () => html`<h1>Setup</h1>`;
