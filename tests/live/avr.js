"use strict";
// The firmware's hex file in JavaScript: an ATmega2560 by avr8js, with the serial port that the host speaks to. It runs in
// node and in a browser; `avr.py` gives it a job and compares what the chip answers with what it answered in simavr.

/**
 * Load avr8js from the texts of its CommonJS modules.
 * @param {Object<string, string>} texts by path, as "cpu/cpu"
 */
function loadAvr8js(texts) {
  const loaded = {};
  const load = (path) => {
    if (loaded[path]) return loaded[path];
    const exports = (loaded[path] = {});
    const beside = (name) => new URL(name, `file:///${path}`).pathname.slice(1);
    new Function("exports", "require", texts[path])(exports, (name) => load(beside(name)));
    return exports;
  };
  return load("index");
}

/** The words of a program in Intel's hex format. @param {string} hex */
function programOf(hex) {
  const bytes = new Uint8Array(0x40000);
  let above = 0;
  for (const line of hex.split("\n")) {
    if (line[0] !== ":") continue;
    const row = Uint8Array.from(line.slice(1).trim().match(/../g), (pair) => parseInt(pair, 16));
    const [count, high, low, kind] = row, data = row.subarray(4, 4 + count);
    if (kind === 0) bytes.set(data, above + 256 * high + low);
    if (kind === 2) above = 16 * (256 * data[0] + data[1]);
    if (kind === 4) above = 65536 * (256 * data[0] + data[1]);
  }
  return new Uint16Array(bytes.buffer);
}

/**
 * A chip that runs a program. Vectors are those of the ATmega2560; avr8js knows those of the ATmega328P. Its timers wake
 * at every count, which takes most of the time; this program needs only an overflow and a count of cycles.
 * @param {any} avr8js @param {string} hex
 */
function makeChip(avr8js, hex) {
  const { CPU, AVRUSART, avrInstruction, usart0Config } = avr8js;
  const program = programOf(hex), cpu = new CPU(program, 8192 + 0x100), frequency = 16e6, sleep = 0x9588; // 0x100: the ports H to L
  addPeriod(cpu);
  addClock(cpu);
  const serial = new AVRUSART(cpu, { ...usart0Config, rxCompleteInterrupt: 0x32, dataRegisterEmptyInterrupt: 0x34, txCompleteInterrupt: 0x36 }, frequency);
  serial.UDRE.constant = true; // the flag says that there is room for a byte: taking its interrupt does not clear it
  const UCSRB = usart0Config.UCSRB, receives = 0x10, control = cpu.writeHooks[UCSRB];
  // Nor does writing to the control register take back a byte that has arrived: avr8js does so while the receiver is on.
  cpu.writeHooks[UCSRB] = (value, before, ...others) => control(value, before & ~receives, ...others);
  let waiting = [], sent = [], ended = false;
  const deliver = () => { if (waiting.length) serial.writeByte(waiting.shift()); };
  serial.onRxComplete = deliver;
  serial.onByteTransmit = (byte) => {
    sent.push(byte);
    ended = byte === 0;
  };

  /** Run for so many cycles, or until a zero was sent; while it sleeps, time jumps to the next event. */
  function run(cycles, untilZero) {
    const end = cpu.cycles + cycles;
    ended = false;
    while (cpu.cycles < end && !(untilZero && ended)) {
      if (program[cpu.pc] === sleep && cpu.nextInterrupt < 0) {
        const next = cpu.nextClockEvent ? Math.min(cpu.nextClockEvent.cycles, end) : end;
        if (next > cpu.cycles) cpu.cycles = next;
      }
      avrInstruction(cpu);
      cpu.tick();
    }
  }

  return {
    cpu,
    wait: (seconds) => run(Math.round(seconds * frequency), false),
    /** Send bytes; return what the chip answers, up to a zero, if it has to answer. */
    exchange(bytes, answers) {
      [waiting, sent] = [[...waiting, ...bytes], []];
      if (!serial.rxBusy) deliver();
      if (answers) run(0.1 * frequency, true);
      return sent;
    },
  };
}

/** Timer 1 as `mega.c` sets it: it overflows at ICR1, with eight cycles for a count. */
function addPeriod(cpu) {
  const [TIFR1, TCCR1B, ICR1, TIMSK1, CS11] = [0x36, 0x81, 0x86, 0x6f, 0x02];
  const overflow = { address: 0x28, flagRegister: TIFR1, flagMask: 1, enableRegister: TIMSK1, enableMask: 1 };
  const next = () => cpu.addClockEvent(end, 8 * (cpu.dataView.getUint16(ICR1, true) + 1));
  function end() {
    cpu.setInterruptFlag(overflow);
    next();
  }
  cpu.writeHooks[TCCR1B] = (value, before) => { if (value & CS11 && !(before & CS11)) next(); };
  cpu.writeHooks[TIMSK1] = (value) => cpu.updateInterruptEnable(overflow, value);
}

/** Timer 3 as `mega.c` sets it: it counts cycles. */
function addClock(cpu) {
  const TCNT3 = 0x94;
  cpu.readHooks[TCNT3] = () => { // the low byte is read first, and keeps the high one
    cpu.dataView.setUint16(TCNT3, cpu.cycles & 0xffff, true);
    return cpu.data[TCNT3];
  };
}

/**
 * Give a chip the bytes that a host has sent, and compare its answers.
 * @param {{avr8js: Object<string, string>, hex: string, exchanges: [number[], number[]][], boot: number}} job
 *   `exchanges`: bytes to the chip, and from it; `boot`: time until the first ones [s]
 */
function play({ avr8js, hex, exchanges, boot }) {
  const chip = makeChip(loadAvr8js(avr8js), hex), answers = [];
  chip.wait(boot);
  const cycles = chip.cpu.cycles, begin = performance.now();
  for (const [bytes, expected] of exchanges) answers.push(chip.exchange(bytes, expected.length > 0));
  return { answers, cycles: chip.cpu.cycles - cycles, seconds: (performance.now() - begin) / 1000 };
}

if (typeof process === "object") process.stdout.write(JSON.stringify(play(JSON.parse(require("node:fs").readFileSync(0, "utf8")))));
