"use strict";
// A device of one's own: a profile, dropped as YAML or JSON.

Live.profile = (() => {
  const { UserError } = Live.base;

  /** @param {any} content of the file @param {string} file its name @param {any} layout @param {any} data */
  function read(content, file, layout, data) {
    throw new UserError(`'${file}' is a profile`);
  }

  return { read };
})();
