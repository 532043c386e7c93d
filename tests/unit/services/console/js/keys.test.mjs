import assert from "node:assert/strict";
import test from "node:test";
import {KEYS, SCOPES, SCOPE_TITLES, hint, match, nameOf, shortcuts} from "../../../../../services/console/static/js/keys.js";

const press = (key, more = {}) => ({key, code: more.code ?? (key.length === 1 && /[a-z]/i.test(key) ? `Key${key.toUpperCase()}` : ""), ...more});
const command = (event, view = "live", options = {}) => match(event, SCOPES[view], options)?.command ?? null;

test("no key has two meanings in scopes that are active together", () => {
  for (const [view, scopes] of Object.entries(SCOPES)) {
    const active = KEYS.filter((one) => scopes.includes(one.scope)).map((one) => `${one.key}/${Boolean(one.mod)}/${Boolean(one.shift)}`);
    assert.deepEqual(active.filter((name, i) => active.indexOf(name) !== i), [], view);
  }
});

test("no letter means one thing in one view and another elsewhere; only Space, Enter and arrows do", () => {
  const meanings = new Map();
  for (const {key, mod, shift, command: what} of KEYS) {
    const name = `${key}/${Boolean(mod)}/${Boolean(shift)}`;
    meanings.set(name, (meanings.get(name) ?? new Set()).add(what));
  }
  const double = [...meanings].filter(([, all]) => all.size > 1).map(([name]) => name.split("/")[0]);
  assert.deepEqual([...new Set(double)].sort(), ["Space", "arrowleft", "arrowright", "enter"]);
});

test("every scope has a title and belongs to a view", () => {
  for (const {scope} of KEYS) {
    assert.ok(SCOPE_TITLES[scope]);
    assert.ok(Object.values(SCOPES).some((scopes) => scopes.includes(scope)));
  }
});

test("the keys of the design are there", () => {
  assert.equal(command(press(" ", {code: "Space"})), "take");
  assert.equal(command(press("r")), "take");
  assert.equal(command(press("?", {shiftKey: true})), "keys");
  assert.equal(command(press("1", {code: "Digit1"})), "view.live");
  assert.equal(command(press("M", {shiftKey: true})), "mode.previous");
  assert.equal(command(press("z", {ctrlKey: true})), "undo");
  assert.equal(command(press("z", {metaKey: true})), "undo");
  assert.equal(command(press("x"), "health"), "stop");
  assert.equal(command(press("Delete"), "gallery"), "gallery.delete");
  assert.equal(command(press("ArrowLeft"), "opened"), "opened.previous");
});

test("Space takes a sample in Live, chooses in the gallery and does nothing in Health", () => {
  const space = press(" ", {code: "Space"});
  assert.equal(command(space, "gallery"), "grid.choose");
  assert.equal(command(space, "health"), null);
});

test("nothing fires while somebody types, composes, holds a key down or has a dialog open", () => {
  for (const target of [{tag: "input", type: "number"}, {tag: "textarea"}, {tag: "select"}, {editable: true, tag: "div"}]) {
    assert.equal(command(press("r", {target})), null);
  }
  assert.equal(command(press("r", {target: {tag: "input", type: "radio"}})), "take");
  assert.equal(command(press("r", {isComposing: true})), null);
  assert.equal(command(press("r", {repeat: true})), null);
  assert.equal(command(press("r"), "live", {dialogOpen: true}), null);
  assert.equal(command(press("ArrowDown", {repeat: true}), "gallery"), "grid.down");
});

test("Ctrl, Alt and Meta make it somebody else's key", () => {
  for (const more of [{ctrlKey: true}, {altKey: true}, {metaKey: true}]) assert.equal(command(press("r", more)), null);
});

test("a control that was reached with Tab keeps its Space; R records all the same", () => {
  const target = {tag: "button", focusVisible: true};
  assert.equal(command(press(" ", {code: "Space", target})), null);
  assert.equal(command(press("r", {target})), "take");
  assert.equal(command(press(" ", {code: "Space", target: {tag: "button", focusVisible: false}})), "take");
  assert.equal(command(press(" ", {code: "Space", target: {tag: "div", role: "gridcell", focusVisible: true}}), "gallery"), "grid.choose");
});

test("letters of other alphabets go by where the key is, digits always do", () => {
  assert.equal(nameOf({key: "ρ", code: "KeyR"}), "r");
  assert.equal(nameOf({key: "к", code: "KeyR"}), "r");
  assert.equal(nameOf({key: "&", code: "Digit1"}), "Digit1");
  assert.equal(nameOf({key: "1", code: "Digit1", shiftKey: true}), "Digit1");
  assert.equal(nameOf({key: "!", code: "Digit1", shiftKey: true}), "!");
  assert.equal(nameOf({key: "/", code: "Digit7", shiftKey: true}), "/");
  assert.equal(nameOf({key: "à", code: "Digit0"}), "Digit0");
  assert.equal(nameOf({key: "q", code: "KeyA"}), "q");
});

test("single keys can be switched off; Ctrl+Z, Escape and Space stay", () => {
  const off = {singleKeys: false};
  assert.equal(command(press("r"), "live", off), null);
  assert.equal(command(press("z", {ctrlKey: true}), "live", off), "undo");
  assert.equal(command(press("Escape"), "live", off), "back");
  assert.equal(command(press(" ", {code: "Space"}), "live", off), "take");
});

test("hints on buttons come from the same table", () => {
  assert.equal(hint("overlay.K"), "K");
  assert.equal(shortcuts("undo"), "U Control+Z");
  assert.equal(shortcuts("take"), "Space R");
});
