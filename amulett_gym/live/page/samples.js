"use strict";
// What the strips show: the newest samples of one arm, in a ring of numbers.

Live.samples = (() => {
  const CHANNELS = ["time", "setpoint", "angle", "biceps", "triceps", "tensionSetpoint", "stiffness", "bicepsSpeed",
    "tricepsSpeed", "push", "contact", "cost"];

  /**
   * @param {number} capacity number of samples that are kept
   */
  function make(capacity) {
    const rings = Object.fromEntries(CHANNELS.map((name) => [name, new Float64Array(capacity)]));
    let count = 0, next = 0, cleared = 0;

    /** Add what `arm.read()` returned. @param {any} state */
    function add(state) {
      const row = {
        time: state.time, setpoint: state.setpoint, angle: state.angle, biceps: state.tension[0], triceps: state.tension[1],
        tensionSetpoint: state.tensionSetpoint === null ? NaN : state.tensionSetpoint, stiffness: state.stiffness,
        bicepsSpeed: state.driveSpeeds[0], tricepsSpeed: state.driveSpeeds[1], push: state.push, contact: state.contact, cost: state.cost,
      };
      for (const name of CHANNELS) rings[name][next] = row[name];
      next = (next + 1) % capacity;
      count = Math.min(count + 1, capacity);
    }

    /** Call `visit(time, value)` for the newest sample up to `begin` [s], and for all later ones. */
    function each(channel, begin, visit) {
      const times = rings.time, values = rings[channel];
      let k = count - 1;
      while (k > 0 && times[at(k)] > begin) k--;
      for (; k >= 0 && k < count; k++) visit(times[at(k)], values[at(k)]);
    }

    /** @returns {number[]} the least and the largest value from `begin` [s] on */
    function range(channel, begin) {
      let least = Infinity, most = -Infinity;
      each(channel, begin, (_, value) => {
        if (value < least) least = value;
        if (value > most) most = value;
      });
      return [least, most];
    }

    const at = (k) => (next - count + k + capacity) % capacity;
    const last = (channel) => (count ? rings[channel][at(count - 1)] : NaN);
    const clear = () => {
      count = next = 0;
      cleared++;
    };
    return { add, each, range, last, clear, get cleared() { return cleared; } };
  }

  return { make };
})();
