// An ADXL345 at register level, independent of the one in wimu-sim: what the firmware uses of it.

const REGISTERS = 0x40;
const FIFO_SAMPLES = 32;
const BW_RATE = 0x2c;
const POWER_CTL = 0x2d;
const INT_ENABLE = 0x2e;
const INT_SOURCE = 0x30;
const DATA_FORMAT = 0x31;
const DATAX0 = 0x32;
const DATAZ1 = 0x37;
const FIFO_CTL = 0x38;
const FIFO_STATUS = 0x39;

export class Adxl345 {
  /**
   * @param clock the emulator's clock
   * @param setInt1 takes the level of INT1
   * @param source gives the sample of a number: x, y, z in g
   * @param periodError how much longer than nominal a sample period is
   */
  constructor(clock, setInt1, source, periodError = 0) {
    this.clock = clock;
    this.setInt1 = setInt1;
    this.source = source;
    this.periodError = periodError;
    this.identity = 0xe5;
    this.overruns = 0;
    /** When each sample was taken, ns on the clock. */
    this.takenAt = [];
    this.alarm = clock.createAlarm(() => this.sample());
    this.powerUp();
  }

  powerUp() {
    this.alarm.cancel();
    this.registers = new Uint8Array(REGISTERS);
    this.registers[BW_RATE] = 0x0a;
    this.fifo = [];
    this.latest = [0, 0, 0];
    this.reading = null;
    this.overrun = false;
    this.level = false;
    this.setInt1(false);
  }

  get measuring() {
    return (this.registers[POWER_CTL] & 8) !== 0;
  }

  get periodNs() {
    return (312_500 << (15 - (this.registers[BW_RATE] & 15))) * (1 + this.periodError);
  }

  start() {
    this.alarm.cancel();
    if (this.measuring) {
      this.alarm.schedule(1_100_000 + this.periodNs);
    }
  }

  sample() {
    const number = this.takenAt.length;
    this.takenAt.push(this.clock.nanos);
    const format = this.registers[DATA_FORMAT];
    const range = 2 << (format & 3);
    const bits = format & 8 ? 10 + (format & 3) : 10;
    const half = 1 << (bits - 1);
    this.latest = this.source(number).map((g) => {
      const digit = Math.max(-half, Math.min(half - 1, Math.round((g / range) * half)));
      return format & 4 ? digit << (16 - bits) : digit;
    });
    if (this.registers[FIFO_CTL] >> 6 !== 0) {
      if (this.fifo.length === FIFO_SAMPLES) {
        this.fifo.shift();
        this.overrun = true;
        this.overruns += 1;
      }
      this.fifo.push(this.latest);
    }
    this.alarm.schedule(this.periodNs);
    this.update();
  }

  get interrupts() {
    const watermark = this.registers[FIFO_CTL] & 31;
    return (
      (this.fifo.length > 0 ? 0x80 : 0) |
      (this.fifo.length >= watermark ? 0x02 : 0) |
      (this.overrun ? 0x01 : 0)
    );
  }

  update() {
    const level = (this.interrupts & this.registers[INT_ENABLE]) !== 0;
    if (level !== this.level) {
      this.level = level;
      this.setInt1(level);
    }
  }

  endReading() {
    if (this.reading) {
      this.reading = null;
      this.fifo.shift();
      this.update();
    }
  }

  begin() {
    this.endReading();
    this.expectsRegister = true;
  }

  write(byte) {
    if (this.expectsRegister) {
      this.expectsRegister = false;
      this.pointer = byte & 0x3f;
      return;
    }
    const register = this.pointer;
    this.pointer = (register + 1) & 0x3f;
    this.registers[register] = byte;
    if (register === FIFO_CTL && byte >> 6 === 0) {
      this.fifo = [];
      this.overrun = false;
    }
    if (register === POWER_CTL || register === BW_RATE) {
      this.start();
    }
    this.update();
  }

  read() {
    const register = this.pointer;
    this.pointer = (register + 1) & 0x3f;
    switch (true) {
      case register === 0:
        return this.identity;
      case register === INT_SOURCE:
        return this.interrupts;
      case register === FIFO_STATUS:
        return this.fifo.length;
      case register >= DATAX0 && register <= DATAZ1: {
        this.reading ??= this.fifo[0] ?? this.latest;
        this.overrun = false;
        const offset = register - DATAX0;
        const value = this.reading[offset >> 1] & 0xffff;
        if (register === DATAZ1) {
          this.endReading();
        }
        return offset & 1 ? value >> 8 : value & 0xff;
      }
      default:
        return this.registers[register];
    }
  }
}
