"use strict";
// The laws of the page's list on a device: their parameters begin with the values that the device has of its own.

Live.laws = (() => {
  const { DEGREES } = Live.base;

  /** Whether a device has its own values of a law's parameters: eq. 6 by its profile, tuned laws that come with it. */
  const isOfDevice = (law) => ["eq6", "eq6-held"].includes(law.id) || (law.group === "Tuned" && law.id === law.content.name);

  /** The values that a device has for a law, as far as it has some. @param {any} law @param {any} content of the device */
  function ownValues(law, { parameters, laws }) {
    if (!isOfDevice(law)) return {};
    if (law.group === "Tuned") return laws[law.content.name] || {};
    const { nominal_tension, minimum_tension, error_offset } = parameters;
    return { nominal_tension, minimum_tension, error_offset_deg: error_offset * DEGREES };
  }

  /**
   * A law's parameters as sliders: beginning with the device's own values, within ranges that contain them.
   * @param {any} law @param {any} device both of the page's lists
   */
  function parametersOf(law, device) {
    const own = ownValues(law, device.content);
    return law.parameters.map((each) => {
      const value = Object.hasOwn(own, each.name) ? own[each.name] : each.value;
      return { ...each, value, low: Math.min(each.low, value), high: Math.max(each.high, value) };
    });
  }

  return { isOfDevice, parametersOf };
})();
