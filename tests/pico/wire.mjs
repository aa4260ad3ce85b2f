// An asynchronous serial line, bit by bit: what one end sends at its rate, the other hears at its own.

/** Bits of a byte with its start and its stop. */
const BITS = 10;

export class Wire {
  /**
   * @param clock the emulator's clock
   * @param baud gives the rate at which the receiving end listens
   * @param deliver takes each byte heard, whether its stop bit was there, and the rate it was heard at
   */
  constructor(clock, baud, deliver) {
    this.clock = clock;
    this.baud = baud;
    this.deliver = deliver;
    /** Times at which the level changed, ns, the first to low; it is high before. */
    this.edges = [];
    this.listening = false;
    this.free = 0;
  }

  /** Puts a byte on the line, from now on. */
  send(byte, baud) {
    const bit = 1e9 / baud;
    const frame = (byte << 1) | 0x200;
    const start = this.clock.nanos;
    let level = 1;
    for (let k = 0; k < BITS; k++) {
      const next = (frame >> k) & 1;
      if (next !== level) {
        this.edges.push(start + k * bit);
        level = next;
      }
    }
    this.listen();
  }

  level(time) {
    let changes = 0;
    while (changes < this.edges.length && this.edges[changes] <= time) {
      changes += 1;
    }
    return changes % 2 === 0 ? 1 : 0;
  }

  /** Waits for the next start bit. */
  listen() {
    if (this.listening) {
      return;
    }
    // Pairs of edges that are over are forgotten: the level after them is high again.
    while (this.edges.length >= 2 && this.edges[1] <= this.free) {
      this.edges.splice(0, 2);
    }
    const falls = this.edges.find((time, index) => index % 2 === 0 && time >= this.free);
    if (falls === undefined) {
      return;
    }
    this.listening = true;
    const baud = this.baud();
    const bit = 1e9 / baud;
    const alarm = this.clock.createAlarm(() => {
      let byte = 0;
      for (let k = 0; k < 8; k++) {
        byte |= this.level(falls + (k + 1.5) * bit) << k;
      }
      const stop = this.level(falls + 9.5 * bit);
      this.free = falls + 9.5 * bit;
      this.listening = false;
      this.deliver(byte, stop === 1, baud);
      this.listen();
    });
    alarm.schedule(Math.max(0, falls + 9.5 * bit - this.clock.nanos));
  }
}
