"use strict";
// Short texts at the bottom of the page, which screen readers read out.

Live.messages = (() => {
  const { byId, element } = Live.base;
  const MOST = 4;

  /** @param {string} text @param {boolean} [isError] errors stay longer */
  function show(text, isError = false) {
    const shown = element("p", { class: isError ? "error" : "", text: text.slice(0, 2000) });
    const place = byId("messages");
    place.append(shown);
    while (place.children.length > MOST) place.firstChild.remove();
    shown.addEventListener("click", () => shown.remove());
    setTimeout(() => shown.remove(), Math.min(4000 + 60 * text.length, 20000) * (isError ? 1.6 : 1));
  }

  /** Show an error; what is not meant for people is also written to the console. @param {any} error */
  function fail(error) {
    show(error instanceof Error ? error.message : String(error), true);
    if (!(error instanceof Live.base.UserError)) console.error(error);
  }

  return { show, fail };
})();
