// An ADXL345 at register level, independent of the one in wimu-sim: what the firmware uses of it.

import { Sensor } from './sensor.mjs';

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

export class Adxl345 extends Sensor {
  identity = 0xe5;
  startNs = 1_100_000;

  powerUp() {
    super.powerUp();
    this.registers[BW_RATE] = 0x0a;
    this.latest = [0, 0, 0];
    this.reading = null;
    this.overrun = false;
    this.level = false;
    this.setLine(false);
  }

  get nominalNs() {
    return 312_500 << (15 - (this.registers[BW_RATE] & 15));
  }

  get measuring() {
    return (this.registers[POWER_CTL] & 8) !== 0;
  }

  take(inG) {
    const format = this.registers[DATA_FORMAT];
    const range = 2 << (format & 3);
    const bits = format & 8 ? 10 + (format & 3) : 10;
    const half = 1 << (bits - 1);
    this.latest = inG.map((g) => {
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
      this.setLine(level);
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
    super.begin();
  }

  written(register, byte) {
    if (register === FIFO_CTL && byte >> 6 === 0) {
      this.fifo = [];
      this.overrun = false;
    }
    if (register === POWER_CTL || register === BW_RATE) {
      this.start();
    }
  }

  value(register) {
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
