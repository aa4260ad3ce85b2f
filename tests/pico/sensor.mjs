// What both sensors have: registers behind a pointer, samples at a period, an interrupt line.

export class Sensor {
  /**
   * @param clock the emulator's clock
   * @param setLine takes the level of the interrupt line
   * @param source gives the sample of a number: x, y, z in g
   * @param periodError how much longer than nominal a sample period is
   */
  constructor(clock, setLine, source, periodError = 0) {
    this.clock = clock;
    this.setLine = setLine;
    this.source = source;
    this.periodError = periodError;
    this.overruns = 0;
    /** When each sample was taken, ns on the clock. */
    this.takenAt = [];
    this.alarm = clock.createAlarm(() => this.sample());
    this.powerUp();
  }

  powerUp() {
    this.alarm.cancel();
    this.registers = new Uint8Array(0x80);
    this.fifo = [];
  }

  get periodNs() {
    return this.nominalNs * (1 + this.periodError);
  }

  start() {
    this.alarm.cancel();
    if (this.measuring) {
      this.alarm.schedule(this.startNs + this.periodNs);
    }
  }

  sample() {
    const number = this.takenAt.length;
    this.takenAt.push(this.clock.nanos);
    this.take(this.source(number));
    this.alarm.schedule(this.periodNs);
    this.update();
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
    this.registers[register] = byte;
    this.written(register, byte);
    this.update();
  }

  read() {
    const register = this.pointer;
    this.pointer = (register + 1) & 0x7f;
    return this.value(register);
  }
}
