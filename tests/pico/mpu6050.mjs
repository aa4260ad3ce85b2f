// An MPU-6050 at register level, independent of the one in wimu-sim: what the firmware uses of it.

import { Sensor } from './sensor.mjs';

const FIFO_BYTES = 1024;
const SMPLRT_DIV = 0x19;
const GYRO_CONFIG = 0x1b;
const ACCEL_CONFIG = 0x1c;
const FIFO_EN = 0x23;
const INT_ENABLE = 0x38;
const INT_STATUS = 0x3a;
const TEMP_OUT_H = 0x41;
const USER_CTRL = 0x6a;
const PWR_MGMT_1 = 0x6b;
const FIFO_COUNT_H = 0x72;
const FIFO_R_W = 0x74;
const WHO_AM_I = 0x75;
const DATA_READY = 0x01;
const OVERFLOW = 0x10;

export class Mpu6050 extends Sensor {
  identity = 0x68;
  startNs = 0;

  powerUp() {
    super.powerUp();
    this.registers[PWR_MGMT_1] = 0x40;
    this.status = 0;
    this.update();
  }

  get nominalNs() {
    return 1_000_000 * (1 + this.registers[SMPLRT_DIV]);
  }

  get measuring() {
    return (this.registers[PWR_MGMT_1] & 0x40) === 0;
  }

  take(inG) {
    const lsbPerG = 16384 >> ((this.registers[ACCEL_CONFIG] >> 3) & 3);
    const force = inG.map((g) => Math.round(g * lsbPerG));
    // 90°/s about z.
    const lsbPerDps = 131.072 / (1 << ((this.registers[GYRO_CONFIG] >> 3) & 3));
    const rate = [0, 0, Math.round(90 * lsbPerDps)];
    this.status |= DATA_READY;
    if (this.registers[USER_CTRL] & 0x40 && this.registers[FIFO_EN] === 0x78) {
      for (const value of [...force, ...rate]) {
        this.fifo.push((value >> 8) & 0xff, value & 0xff);
      }
      while (this.fifo.length > FIFO_BYTES) {
        this.fifo.shift();
        this.status |= OVERFLOW;
      }
      this.overruns += this.status & OVERFLOW ? 1 : 0;
    }
  }

  /** INT is latched until INT_STATUS is read. */
  update() {
    this.setLine((this.status & this.registers[INT_ENABLE]) !== 0);
  }

  written(register, byte) {
    if (register === PWR_MGMT_1 && byte & 0x80) {
      this.powerUp();
    } else if (register === USER_CTRL && byte & 4) {
      this.fifo = [];
      this.registers[USER_CTRL] = byte & ~4;
    } else if (register === PWR_MGMT_1 || register === SMPLRT_DIV) {
      this.start();
    }
  }

  value(register) {
    switch (register) {
      case WHO_AM_I:
        return this.identity;
      case INT_STATUS: {
        const { status } = this;
        this.status = 0;
        this.update();
        return status;
      }
      case FIFO_COUNT_H:
        this.count = this.fifo.length;
        return this.count >> 8;
      case FIFO_COUNT_H + 1:
        return this.count & 0xff;
      case FIFO_R_W:
        this.pointer = FIFO_R_W;
        return this.fifo.shift() ?? 0xff;
      case TEMP_OUT_H: // 25 °C: 340 LSB/K from 36.53 °C.
        return 0xf0;
      case TEMP_OUT_H + 1:
        return 0xb0;
      default:
        return this.registers[register];
    }
  }
}
