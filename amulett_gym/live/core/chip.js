"use strict";
// An ATmega2560 that runs a hex file, by avr8js: the processor with the serial port that a host speaks to. Time passes only
// while it is asked for something.

Amulett.chip = (() => {
  const { AmulettError } = Amulett.base;
  const FREQUENCY = 16e6; // [Hz]
  const MEMORY = 8192, PORTS = 0x100; // bytes; the ports H to L are beyond those of the ATmega328P, which avr8js knows
  const SLEEP = 0x9588; // the instruction
  const BOOT = 0.01, ANSWER = 0.1; // [s] after the reset until the host speaks, and until an answer
  const HEAD = 24; // bytes of a snapshot before the memory: cycles, cycles at the next period, program counter

  /** The words of a program in Intel's hex format. @param {string} hex */
  function programOf(hex) {
    const bytes = new Uint8Array(0x40000);
    let above = 0;
    for (const line of hex.split("\n")) {
      if (line[0] !== ":") continue;
      const row = Uint8Array.from(line.slice(1).trim().match(/../g) || [], (pair) => parseInt(pair, 16));
      const [count, high, low, kind] = row, data = row.subarray(4, 4 + count);
      if (kind === 0) bytes.set(data, above + 256 * high + low);
      if (kind === 2) above = 16 * (256 * data[0] + data[1]);
      if (kind === 4) above = 65536 * (256 * data[0] + data[1]);
    }
    return new Uint16Array(bytes.buffer);
  }

  /**
   * Make a chip, and let it start. Interrupts have the vectors of the ATmega2560. Of its timers there is what `mega.c` uses:
   * the period by timer 1 and the count of cycles by timer 3; those of avr8js wake at every count, which takes most of the time.
   * @param {string} hex
   */
  function make(hex) {
    const { CPU, AVRUSART, avrInstruction, usart0Config } = avr8js;
    const program = programOf(hex), cpu = new CPU(program, MEMORY + PORTS);
    const period = addPeriod(cpu);
    addClock(cpu);
    const serial = new AVRUSART(cpu, { ...usart0Config, rxCompleteInterrupt: 0x32, dataRegisterEmptyInterrupt: 0x34, txCompleteInterrupt: 0x36 }, FREQUENCY);
    serial.UDRE.constant = true; // the flag says that there is room for a byte: taking its interrupt does not clear it
    const UCSRB = usart0Config.UCSRB, RECEIVES = 0x10, control = cpu.writeHooks[UCSRB];
    // Nor does writing to the control register take back a byte that has arrived: avr8js does so while the receiver is on.
    cpu.writeHooks[UCSRB] = (value, before, ...others) => control(value, before & ~RECEIVES, ...others);
    let waiting = [], sent = [], ended = false;
    const deliver = () => { if (waiting.length) serial.writeByte(waiting.shift()); };
    serial.onRxComplete = deliver;
    serial.onByteTransmit = (byte) => {
      sent.push(byte);
      ended = byte === 0;
    };

    /**
     * Run for a time [s], or until a zero was sent, or until nothing is left to do before the next period: all that the chip
     * knows is then in its memory. While it sleeps, time jumps to the next event.
     * @param {number} seconds @param {"time" | "zero" | "rest"} until @returns {boolean} whether it rests, if that was wanted
     */
    function run(seconds, until) {
      const end = cpu.cycles + Math.round(seconds * FREQUENCY), zero = until === "zero", rest = until === "rest";
      while (cpu.cycles < end && !(zero && ended)) {
        if (program[cpu.pc] === SLEEP && cpu.nextInterrupt < 0) {
          const event = cpu.nextClockEvent;
          if (rest && event?.callback === period.end && !event.next) return true;
          const next = event ? Math.min(event.cycles, end) : end;
          if (next > cpu.cycles) cpu.cycles = next;
        }
        avrInstruction(cpu);
        cpu.tick();
      }
      return false;
    }

    function settle() {
      if (!run(ANSWER, "rest")) throw new AmulettError("the firmware does not rest after its answer; restart");
    }

    run(BOOT, "time");
    settle();

    /** Send bytes, and run until the chip has answered them, up to a zero, and rests again. @param {Iterable<number>} bytes */
    function exchange(bytes) {
      [waiting, sent, ended] = [[...bytes], [], false];
      deliver();
      run(ANSWER, "zero");
      settle();
      return sent;
    }

    /** The chip at rest, as bytes. */
    function snapshot() {
      const bytes = new Uint8Array(HEAD + cpu.data.length);
      new Float64Array(bytes.buffer, 0, 3).set([cpu.cycles, cpu.nextClockEvent.cycles, cpu.pc]);
      bytes.set(cpu.data, HEAD);
      return bytes;
    }

    /** Whether bytes are a snapshot of this chip. @param {Uint8Array} bytes */
    function fits(bytes) {
      if (bytes.length !== HEAD + cpu.data.length) return false;
      const [cycles, next, place] = new Float64Array(bytes.slice(0, HEAD).buffer);
      return [cycles, next, place].every(Number.isSafeInteger) && cycles >= 0 && next >= cycles && program[place] === SLEEP;
    }

    /** Go to a snapshot's moment. @param {Uint8Array} bytes of which `fits` is true */
    function restore(bytes) {
      const [cycles, next, place] = new Float64Array(bytes.slice(0, HEAD).buffer);
      cpu.reset();
      serial.reset();
      [waiting, cpu.cycles, cpu.pc] = [[], cycles, place];
      cpu.data.set(bytes.subarray(HEAD));
      cpu.addClockEvent(period.end, next - cycles);
    }

    return { exchange, snapshot, fits, restore, size: HEAD + cpu.data.length, get cycles() { return cpu.cycles; } };
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
    return { end };
  }

  /** Timer 3 as `mega.c` sets it: it counts cycles. */
  function addClock(cpu) {
    const TCNT3 = 0x94;
    cpu.readHooks[TCNT3] = () => { // the low byte is read first, and keeps the high one
      cpu.dataView.setUint16(TCNT3, cpu.cycles & 0xffff, true);
      return cpu.data[TCNT3];
    };
  }

  return { make };
})();
