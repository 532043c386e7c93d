import {html} from "../html.js";
export const Coverage = () => html`<h1>Coverage</h1>`;
