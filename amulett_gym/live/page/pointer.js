"use strict";
// Mouse and finger on the arm: the setpoint is dragged, the forearm is pulled by an elastic band.

Live.pointer = (() => {
  const { clamp, DEGREES } = Live.base;
  const REACH = 120; // of the band at the largest torque, in the drawing's units

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{frame: () => any, limits: {setpoint: number, push: number}, setpoint: (angle: number) => void,
   *   push: (torque: number) => void, touched: () => void}} app angles in rad, torques in N m
   */
  function make(canvas, app) {
    /** @type {"" | "setpoint" | "forearm"} */
    let part = "";
    let held = -1;
    /** @type {number[]} */
    let at = [0, 0];

    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return Live.arm.toDrawing(event.clientX - box.left, event.clientY - box.top, box.width, box.height);
    };

    function follow() {
      if (part === "setpoint") {
        const most = app.limits.setpoint * DEGREES, angle = clamp(Live.arm.angleAt(at) * DEGREES, -most, most);
        app.setpoint(Math.round(angle * 2) / 2 / DEGREES);
      } else if (part === "forearm") {
        const { along, aside } = Live.arm.onForearm(at, app.frame().angle);
        const lever = clamp(along / Live.arm.FOREARM, 0.35, 1);
        const torque = clamp((app.limits.push * aside * lever) / REACH, -app.limits.push, app.limits.push);
        app.push(Math.round(100 * torque) / 100);
      }
    }

    canvas.addEventListener("pointerdown", (event) => {
      if (held >= 0 || event.button) return;
      at = place(event);
      part = Live.arm.partAt(at, app.frame());
      held = event.pointerId;
      canvas.setPointerCapture(held);
      canvas.classList.toggle("pushing", part === "forearm");
      app.touched();
      follow();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (held < 0) canvas.classList.toggle("over-setpoint", Live.arm.partAt(place(event), app.frame()) === "setpoint");
      if (event.pointerId !== held) return;
      at = place(event);
      follow();
    });
    const release = (event) => {
      if (event.pointerId !== held) return;
      if (part === "forearm") app.push(0);
      [part, held] = ["", -1];
      canvas.classList.remove("pushing");
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, release);

    return {
      /** Pull anew where the arm is now; call it once a frame. */
      follow: () => { if (part === "forearm") follow(); },
      get part() { return part; },
      get pull() { return part === "forearm" ? at : null; },
    };
  }

  return { make };
})();
