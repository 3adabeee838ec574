"use strict";
// The run as a table: simulated anew from the record, a row for each control tick.

Live.csv = (() => {
  const { DEGREES } = Live.base;

  /** @type {[string, (mine: any, twin: any) => number | null][]} column and its value */
  const COLUMNS = [
    ["time [s]", (mine) => mine.time],
    ["setpoint [deg]", (mine) => mine.setpoint * DEGREES],
    ["push [N m]", (mine) => mine.push],
    ...["", "eq. 6: "].flatMap((of, k) => /** @type {[string, any][]} */ ([
      ["angle [deg]", (each) => each.angle * DEGREES],
      ["velocity [deg/s]", (each) => each.velocity * DEGREES],
      ["tension biceps [N]", (each) => each.tension[0]],
      ["tension triceps [N]", (each) => each.tension[1]],
      ["tension setpoint [N]", (each) => each.tensionSetpoint],
      ["joint stiffness [N m/rad]", (each) => each.stiffness],
      ["drive biceps [deg]", (each) => each.driveAngles[0] * DEGREES],
      ["drive triceps [deg]", (each) => each.driveAngles[1] * DEGREES],
      ["command biceps [deg]", (each) => each.commands[0] * DEGREES],
      ["command triceps [deg]", (each) => each.commands[1] * DEGREES],
      ["contact [N m]", (each) => each.contact],
      ["cost [1]", (each) => each.cost],
    ]).map(([name, value]) => /** @type {[string, any]} */ ([of + name, (mine, twin) => value(k ? twin : mine)]))),
  ];

  /** @param {any} run @param {any} core @returns {string} the table of the run up to its present tick */
  function table(run, core) {
    const again = Live.run.make(core, run.spec, run.events), lines = [COLUMNS.map(([name]) => name).join(",")];
    const row = () => lines.push(COLUMNS.map(([, value]) => text(value(again.state.mine, again.state.twin))).join(","));
    row();
    while (again.tick < run.tick) {
      again.advance(again.tick + 1);
      row();
    }
    return lines.join("\n") + "\n";
  }

  /** All digits of a number, so that reading it gives the same one; nothing where there is none. */
  const text = (value) => (value === null || !Number.isFinite(value) ? "" : String(value));

  return { table, COLUMNS };
})();
