"use strict";
// The firmware as a control loop: the host's end of the line to the chip, with the frames of amulett_gym/firmware/protocol.py.

Amulett.firmware = (() => {
  const { AmulettError } = Amulett.base;
  const VERSION = 1, HELLO = 1, START = 2, SAMPLE = 3, REPLY = 0x80;
  const MOVE_BEGINS = 1, LATE = 2;

  /** The CRC-16/IBM-3740: polynomial 0x1021, begin 0xFFFF. */
  function crc(bytes) {
    let found = 0xffff;
    for (const byte of bytes) {
      found ^= byte << 8;
      for (let k = 0; k < 8; k++) found = ((found << 1) ^ (found & 0x8000 ? 0x1021 : 0)) & 0xffff;
    }
    return found;
  }

  /** A frame: kind, sequence number, content and CRC, coded by COBS, with a zero before and after. */
  function frameOf(kind, sequence, content) {
    const frame = [kind, sequence, ...content], check = crc(frame), coded = [0, 0];
    let place = 1; // of the code byte
    for (const byte of [...frame, check & 0xff, check >> 8]) {
      if (byte) coded.push(byte);
      else {
        coded[place] = coded.length - place;
        place = coded.length;
        coded.push(0);
      }
    }
    coded[place] = coded.length - place;
    return [...coded, 0];
  }

  /** Kind, sequence number and content of a frame, or null if it is broken. @param {number[]} coded with its zero */
  function contentOf(coded) {
    const found = [], end = coded.length - 1;
    for (let place = 0; place < end;) {
      const next = place + coded[place];
      if (coded[place] === 0 || next > end) return null;
      if (place) found.push(0);
      found.push(...coded.slice(place + 1, next));
      place = next;
    }
    const frame = found.slice(0, -2), [low, high] = found.slice(-2);
    return frame.length >= 2 && crc(frame) === low + 256 * high ? Uint8Array.from(frame) : null;
  }

  /** Start the firmware. @param {string} hex */
  function make(hex) {
    const chip = Amulett.chip.make(hex);
    let sequence = 0;

    function ask(kind, content) {
      sequence = (sequence + 1) % 256;
      const frame = contentOf(chip.exchange(frameOf(kind, sequence, content)));
      if (!frame || frame[0] !== (REPLY | kind) || frame[1] !== sequence) throw new AmulettError("the firmware does not answer as it should; restart");
      return new DataView(frame.buffer, 2);
    }

    const hello = ask(HELLO, [VERSION]);
    const [version, real, exactEncoder, exactSliders] = [0, 1, 2, 3].map((k) => hello.getUint8(k));
    if (version !== VERSION || real !== 4 || exactEncoder || exactSliders) throw new AmulettError("the firmware is not one of this amulett-gym for a device with counting sensors");

    return {
      id: hello.getUint32(4, true),
      /** Begin an episode. @param {number[]} numbers of `controller_begin` (controller.h), in its order @param {number} agonist */
      start: (numbers, agonist) => {
        const content = new DataView(new ArrayBuffer(4 * numbers.length + 1));
        numbers.forEach((value, k) => content.setFloat32(4 * k, value, true));
        content.setInt8(4 * numbers.length, agonist);
        ask(START, new Uint8Array(content.buffer));
      },
      /**
       * Do one control tick.
       * @param {{encoder: number, biceps: number, triceps: number, setpoint: number, jump: number, begins: boolean, late: boolean}} of
       *   counts of the sensors; setpoint and its jump since the last tick [rad]
       */
      tick: ({ encoder, biceps, triceps, setpoint, jump, begins, late }) => {
        const content = new DataView(new ArrayBuffer(21));
        [encoder, biceps, triceps].forEach((count, k) => content.setInt32(4 * k, count, true));
        [setpoint, jump].forEach((value, k) => content.setFloat32(12 + 4 * k, value, true));
        content.setUint8(20, MOVE_BEGINS * Number(begins) + LATE * Number(late));
        const report = ask(SAMPLE, new Uint8Array(content.buffer));
        const [first, second, tension] = [0, 4, 8].map((place) => report.getFloat32(place, true));
        return { commands: [first, second], tension, agonist: report.getInt8(12) };
      },
      size: 1 + chip.size,
      snapshot: () => new Uint8Array([sequence, ...chip.snapshot()]),
      /** @param {Uint8Array} bytes */
      fits: (bytes) => chip.fits(bytes.subarray(1)),
      restore: (bytes) => {
        sequence = bytes[0];
        chip.restore(bytes.subarray(1));
      },
    };
  }

  return { make };
})();
