"use strict";
// The keyboard: everything that the pointer can do.

Live.keys = (() => {
  const { byId, element } = Live.base;

  /**
   * @typedef {{keys: string[], shown: string, does: string, down: (event: KeyboardEvent) => void, up?: () => void}} Key
   * `keys`: values of `KeyboardEvent.key`, lower case
   */

  /** List the keys in the help. @param {Key[]} table */
  function list(table) {
    byId("help-keys").replaceChildren(...table.flatMap((key) => [
      element("dt", {}, ...key.shown.split(" ").map((name) => element("kbd", { text: name }))),
      element("dd", { text: key.does }),
    ]));
  }

  /** Whether an element takes a key itself. @param {Element | null} target @param {string} key */
  function takes(target, key) {
    if (!(target instanceof HTMLElement)) return false;
    const tag = target.tagName, type = target.getAttribute("type");
    if (tag === "SELECT" || tag === "TEXTAREA" || (tag === "INPUT" && type !== "range" && type !== "checkbox")) return true;
    if (tag === "INPUT" && type === "range") return key.startsWith("arrow");
    return key === " " && ["BUTTON", "INPUT", "SUMMARY", "A", "LABEL"].includes(tag);
  }

  /** @param {Key[]} table */
  function make(table) {
    list(table);
    /** @type {Map<string, Key>} */
    const held = new Map();
    const find = (name) => table.find((key) => key.keys.includes(name));
    document.addEventListener("keydown", (event) => {
      const name = event.key.toLowerCase(), key = find(name);
      if (!key || event.ctrlKey || event.metaKey || event.altKey || byId("help").open || takes(document.activeElement, name)) return;
      if (!byId("keys-on").checked && name.length === 1 && name !== " ") return;
      event.preventDefault();
      if (key.up) {
        if (held.has(name)) return; // the system repeats keys that are held
        held.set(name, key);
      }
      key.down(event);
    });
    const release = (name) => {
      const key = held.get(name);
      held.delete(name);
      if (key && key.up) key.up();
    };
    document.addEventListener("keyup", (event) => release(event.key.toLowerCase()));
    window.addEventListener("blur", () => [...held.keys()].forEach(release));
  }

  return { make };
})();
