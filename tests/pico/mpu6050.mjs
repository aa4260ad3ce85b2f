// An MPU-6050 at register level, independent of the one in wimu-sim: what the firmware uses of it.

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

export class Mpu6050 {
  /**
   * @param clock the emulator's clock
   * @param setInt takes the level of INT, latched until INT_STATUS is read
   * @param source gives the sample of a number: x, y, z in g
   * @param periodError how much longer than nominal a sample period is
   */
  constructor(clock, setInt, source, periodError = 0) {
    this.clock = clock;
    this.setInt = setInt;
    this.source = source;
    this.periodError = periodError;
    this.identity = 0x68;
    this.overruns = 0;
    /** When each sample was taken, ns on the clock. */
    this.takenAt = [];
    this.alarm = clock.createAlarm(() => this.sample());
    this.powerUp();
  }

  powerUp() {
    this.alarm.cancel();
    this.registers = new Uint8Array(0x80);
    this.registers[PWR_MGMT_1] = 0x40;
    this.fifo = [];
    this.status = 0;
    this.update();
  }

  get periodNs() {
    return 1_000_000 * (1 + this.registers[SMPLRT_DIV]) * (1 + this.periodError);
  }

  start() {
    this.alarm.cancel();
    if ((this.registers[PWR_MGMT_1] & 0x40) === 0) {
      this.alarm.schedule(this.periodNs);
    }
  }

  sample() {
    const number = this.takenAt.length;
    this.takenAt.push(this.clock.nanos);
    const lsbPerG = 16384 >> ((this.registers[ACCEL_CONFIG] >> 3) & 3);
    const force = this.source(number).map((g) => Math.round(g * lsbPerG));
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
    this.alarm.schedule(this.periodNs);
    this.update();
  }

  update() {
    this.setInt((this.status & this.registers[INT_ENABLE]) !== 0);
  }

  begin() {
    this.expectsRegister = true;
  }

  write(byte) {
    if (this.expectsRegister) {
      this.expectsRegister = false;
      this.pointer = byte & 0x7f;
      return;
    }
    const register = this.pointer;
    this.pointer = (register + 1) & 0x7f;
    if (register === PWR_MGMT_1 && byte & 0x80) {
      this.powerUp();
      return;
    }
    this.registers[register] = byte;
    if (register === USER_CTRL && byte & 4) {
      this.fifo = [];
      this.registers[USER_CTRL] = byte & ~4;
    }
    if (register === PWR_MGMT_1 || register === SMPLRT_DIV) {
      this.start();
    }
    this.update();
  }

  read() {
    const register = this.pointer;
    if (register !== FIFO_R_W) {
      this.pointer = (register + 1) & 0x7f;
    }
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
