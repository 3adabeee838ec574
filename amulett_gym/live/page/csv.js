"use strict";
// The run as a table: simulated anew from the record, a row for each control tick.

Live.csv = (() => {
  const { DEGREES } = Live.base;

  /** @type {[string, (state: any) => number | null][]} columns of each arm, named as those of `amulett simulate` */
  const OWN = [
    ["joint_angle_deg", (state) => state.angle * DEGREES],
    ["joint_velocity_deg_per_s", (state) => state.velocity * DEGREES],
    ["tension_setpoint_N", (state) => state.tensionSetpoint],
    ["force_biceps_N", (state) => state.tension[0]],
    ["force_triceps_N", (state) => state.tension[1]],
    ["command_biceps_deg", (state) => state.commands[0] * DEGREES],
    ["command_triceps_deg", (state) => state.commands[1] * DEGREES],
    ["drive_biceps_deg", (state) => state.driveAngles[0] * DEGREES],
    ["drive_triceps_deg", (state) => state.driveAngles[1] * DEGREES],
    ["contact_torque_Nm", (state) => state.contact],
    ["joint_stiffness_Nm_per_rad", (state) => state.stiffness],
    ["cost", (state) => state.cost],
  ];

  /** An arm that has not failed, if there is one: only that one goes on. */
  const going = (mine, twin) => (mine.failed ? twin : mine);

  /** @type {[string, (mine: any, twin: any, time: number) => number | null][]} */
  const COLUMNS = [
    ["time_s", (mine, twin, time) => time],
    ["setpoint_deg", (mine, twin) => going(mine, twin).setpoint * DEGREES],
    ["push_torque_Nm", (mine, twin) => going(mine, twin).push],
    ...OWN.map(([name, value]) => /** @type {[string, any]} */ ([name, (mine) => value(mine)])),
    ...OWN.map(([name, value]) => /** @type {[string, any]} */ ([`eq6_${name}`, (mine, twin) => value(twin)])),
  ];

  /** @param {any} run @param {any} core @returns {string} the table of the run up to its present tick */
  function table(run, core) {
    const again = Live.run.make(core, run.spec, run.events), lines = [COLUMNS.map(([name]) => name).join(",")];
    const row = () => lines.push(COLUMNS.map(([, value]) => text(value(again.state.mine, again.state.twin, again.time))).join(","));
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
