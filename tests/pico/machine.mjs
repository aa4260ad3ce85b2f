// A Pico: the emulated chip with its ROM's flash functions, UARTs that take their time, and a bus.

import { RP2040 } from 'rp2040js';
import { Wire } from './wire.mjs';

const FLASH = 0x10000000;
const RAM = 0x20000000;
const VECTORS = FLASH + 0x100;
/** An address of the flash that no image reaches. */
const UNUSED = FLASH + 0x180000;
const FIFO_BYTES = 32;
const TX_INTERRUPT = 1 << 5;
/** A register that the emulator's UART lacks. */
const DMA_CONTROL = 0x48;
/** Registers that the emulator's I²C controller lacks. */
const INTERRUPT_MASK = 0x30;
const SDA_HOLD = 0x7c;
/** A sector erase and a page program of the flash, ns. */
const ERASE_NS = 45e6;
const PROGRAM_NS = 0.4e6;

/** Functions of the boot ROM that the firmware calls, by their codes. */
const ROM_FUNCTIONS = ['IF', 'EX', 'RE', 'RP', 'FC', 'CX', 'C4', 'MC', 'MS', 'S4'];

/** Blocks of registers that the emulator has nothing or no more than a part of. */
const XIP_CONTROL = 0x14000;
const TIMER = 0x40054;
const WATCHDOG = 0x40058;
const CHIP_RESET = 0x40064;
/** Why the chip was reset, as its register says. */
const BY_POWER = 1 << 8;
const BY_PIN = 1 << 16;

/** Where the stack begins in memory: the firmware leaves the rest out. */
const STACK_TOP = 256 * 1024;

/** Each byte of the stack at the start of the firmware. */
const STACK_PAINT = 0xcc;

/** What memory holds when power comes. */
const chance = (index) => ((index * 2654435761) >>> 13) & 0xff;

export class Pico {
  constructor() {
    this.clock = new RP2040().clock;
    this.complaints = [];
    this.resets = 0;
    this.deepest = 0;
    /** The longest time for which interrupts were off but for the flash, and where that ended. */
    this.masked = { ns: 0, until: 0 };
    this.received = [[], []];
    /** Zeros that the other ends of the UARTs heard at another rate than they were sent at. */
    this.strangeZeros = [0, 0];
    this.levels = new Map();
    /** At what rate the other ends of the UARTs are, bits/s. */
    this.hostBaud = [115200, 115200];
    this.absent = false;
    this.held = false;
    this.nacks = 0;
    this.eraseNs = ERASE_NS;
    /** How many more times the flash is changed before the power fails in the middle of it. */
    this.changesToCut = Infinity;
    this.fromHost = [0, 1].map(
      (index) => new Wire(this.clock, () => this.chip.uart[index].baudRate, (byte, stop) => this.hear(index, byte, stop)),
    );
    this.toHost = [0, 1].map(
      (index) =>
        new Wire(this.clock, () => this.hostBaud[index], (byte, _, baud) => {
          this.received[index].push(byte);
          // The emulator rounds what the chip's divider makes of a rate.
          const off = Math.abs(this.chip.uart[index].baudRate / baud - 1);
          this.strangeZeros[index] += byte === 0 && off > 0.02 ? 1 : 0;
        }),
    );
  }

  /** Puts an image of UF2 blocks into the flash, and power on the chip. */
  load(uf2) {
    this.start('power');
    for (let at = 0; at + 512 <= uf2.length; at += 512) {
      const block = uf2.subarray(at, at + 512);
      const view = new DataView(block.buffer, block.byteOffset, 512);
      if (view.getUint32(0, true) !== 0x0a324655 || view.getUint32(28, true) !== 0xe48bff56) {
        throw new Error(`block ${at / 512} is no UF2 for an RP2040`);
      }
      const address = view.getUint32(12, true);
      this.chip.flash.set(block.subarray(32, 32 + view.getUint32(16, true)), address - FLASH);
    }
  }

  /** Starts the chip anew after its power, its reset "pin" or its "watchdog": what survives that, survives. */
  start(cause) {
    const before = this.chip;
    const chip = new RP2040(this.clock);
    this.chip = chip;
    this.maskedSince = undefined;
    chip.logger = { debug() {}, info() {}, warn() {}, error: (...words) => this.complaints.push(words.join(' ')) };
    chip.loadBootrom(bootrom());
    chip.onBreak = (number) => this.romFunction(ROM_FUNCTIONS[number]);
    const watchdog = chip.peripherals[WATCHDOG];
    const reset = chip.peripherals[CHIP_RESET];
    reset.readUint32 = () => this.resetBy;
    // No read of the flash goes on in the background.
    chip.peripherals[XIP_CONTROL] = { readUint32: () => 0, writeUint32Atomic() {} };
    if (before) {
      this.deepest = this.deepestStack(before);
      chip.flash.set(before.flash);
      this.resets += 1;
    }
    if (cause === 'watchdog') {
      watchdog.reason = before.peripherals[WATCHDOG].reason;
    } else {
      this.resetBy = cause === 'pin' ? BY_PIN : BY_POWER;
    }
    if (cause === 'power') {
      // Memory holds what it likes.
      chip.sram.forEach((_, index) => {
        chip.sram[index] = chance(index);
      });
      this.sensor?.powerUp();
    } else {
      chip.sram.set(before.sram);
    }
    watchdog.onWatchdogTrigger = () => {
      // A reset switches it off.
      watchdog.alarm.enable = false;
      if (this.chip === chip) {
        this.restart = 'watchdog';
      }
    };
    // The timer starts at 0.
    const begun = this.clock.nanos;
    const { clock } = this;
    chip.peripherals[TIMER].clock = {
      get nanos() {
        return clock.nanos - begun;
      },
    };
    chip.uart.forEach((uart, index) => paced(uart, this.clock, (byte) => {
      if (this.chip === chip) {
        this.toHost[index].send(byte, uart.baudRate);
      }
    }));
    if (this.sensor) {
      this.wire(chip);
    }
    this.levels.forEach((level, pin) => chip.gpio[pin].setInputValue(level));
    // The second stage of the bootloader sits at the start of the flash.
    chip.core.reset();
    chip.core.PC = FLASH;
  }

  /** The most bytes that the stack has had so far: below them is the paint of the start (`cortex-m-rt`). */
  deepestStack({ sram } = this.chip) {
    let used = 0;
    for (let deep = 1, alike = 0; alike < 8192 && deep <= STACK_TOP; deep += 1) {
      const index = STACK_TOP - deep;
      alike = sram[index] === STACK_PAINT ? alike + 1 : 0;
      used = alike === 0 ? deep : used;
    }
    return Math.max(used, this.deepest);
  }

  /** Sets the level of a pin. */
  setPin(pin, level) {
    this.levels.set(pin, level);
    this.chip?.gpio[pin].setInputValue(level);
  }

  /** Connects a sensor that has begin, write, read and powerUp to I2C0. */
  connect(address, sensor) {
    this.sensor = sensor;
    this.address = address;
  }

  wire(chip) {
    const bus = chip.i2c[0];
    const { sensor } = this;
    // A bit takes as long as the firmware has set the controller to; its clock is the processor's.
    const later = (done) => {
      const bitNs = (bus.fsClockLowPeriod + bus.fsClockHighPeriod) * 8;
      const alarm = this.clock.createAlarm(() => {
        if (this.held && this.chip === chip) {
          // A controller that waits for the bus has no limit.
          alarm.schedule(50e3);
        } else if (this.chip === chip) {
          done();
        }
      });
      alarm.schedule(9 * bitNs);
    };
    const write = bus.writeUint32.bind(bus);
    bus.writeUint32 = (offset, value) => {
      if (offset === INTERRUPT_MASK) {
        bus.intEnable = value;
        bus.checkInterrupts();
      } else if (offset !== SDA_HOLD) {
        write(offset, value);
      }
    };
    let mine = false;
    bus.onStart = () => bus.completeStart();
    bus.onConnect = (asked, mode) => later(() => {
      mine = asked === this.address && !this.absent;
      if (mine && mode === 0) {
        sensor.begin();
      }
      bus.completeConnect(mine);
    });
    bus.onWriteByte = (byte) => later(() => {
      const heard = !this.absent && this.nacks === 0;
      if (heard) {
        sensor.write(byte);
      } else if (this.nacks > 0) {
        this.nacks -= 1;
      }
      bus.completeWrite(heard);
    });
    bus.onReadByte = () => later(() => bus.completeRead(sensor.read()));
    bus.onStop = () => bus.completeStop();
  }

  /** Sends bytes to a UART at the speed of its other end. */
  send(index, bytes) {
    const baud = this.hostBaud[index];
    let at = 0;
    const alarm = this.clock.createAlarm(() => {
      this.fromHost[index].send(bytes[at], baud);
      at += 1;
      if (at < bytes.length) {
        alarm.schedule((10 / baud) * 1e9);
      }
    });
    if (bytes.length > 0) {
      alarm.schedule(0);
    }
  }

  /** Takes a byte that a UART heard, or what it took for one. */
  hear(index, byte, stop) {
    const uart = this.chip.uart[index];
    if (!uart.enabled || uart.baudDivider === 0) {
      return;
    }
    const { rxFIFO } = uart;
    if (rxFIFO.full) {
      uart.overrun = true;
      return;
    }
    const framing = stop ? 0 : 1 << 8;
    const breaks = !stop && byte === 0 ? 1 << 10 : 0;
    const overrun = uart.overrun ? 1 << 11 : 0;
    uart.overrun = false;
    uart.feedByte(byte | framing | breaks | overrun);
  }

  /** Lets the processor do nothing more, interrupts off. */
  hang() {
    const { core } = this.chip;
    this.chip.flashView.setUint32(UNUSED - FLASH, 0xe7fdbf30, true); // 1: wfi; b 1b
    core.enabledInterrupts = 0;
    core.pendingInterrupts = 0;
    core.PC = UNUSED;
    core.waiting = false;
  }

  /** Flips a bit of the image that nothing uses: of the vector of SysTick. */
  damage() {
    this.chip.flash[VECTORS - FLASH + 15 * 4] ^= 0x80;
  }

  /** Lets the processor enter its fault handler, from the instruction at UNUSED. */
  fault() {
    const { core } = this.chip;
    core.SP -= 32;
    [0, 0, 0, 0, 0, 0, UNUSED, 0x01000000].forEach((word, index) => {
      this.chip.writeUint32(core.SP + index * 4, word);
    });
    core.LR = 0xfffffff9;
    core.PM = true;
    core.PC = this.chip.readUint32(VECTORS + 12) & ~1;
    core.waiting = false;
  }

  /** Lets the processor go on in the function at `address`. */
  call(address, argument) {
    const { core } = this.chip;
    core.registers[0] = argument;
    core.PC = address & ~1;
    core.waiting = false;
  }

  /** Runs up to `ns` on the clock. */
  run(ns) {
    let { core } = this.chip;
    const { clock } = this;
    while (clock.nanos < ns) {
      if (this.restart) {
        this.start(this.restart);
        this.restart = undefined;
        core = this.chip.core;
      }
      if (core.waiting) {
        const idle = clock.nanosToNextAlarm;
        clock.tick(idle > 0 ? Math.min(idle, ns - clock.nanos) : 8);
      } else {
        clock.tick(core.executeInstruction() * 8);
        this.noteMask(core);
      }
    }
  }

  noteMask(core) {
    if (core.PM) {
      this.maskedSince ??= this.clock.nanos;
      return;
    }
    const ns = this.clock.nanos - this.maskedSince;
    if (ns > this.masked.ns && !this.flashed) {
      this.masked = { ns, until: core.PC };
    }
    this.maskedSince = undefined;
    this.flashed = false;
  }

  /** Changes bytes of the flash one after another; power that fails meanwhile leaves the rest. */
  changeFlash(ns, bytes, change) {
    this.changesToCut -= 1;
    this.flashed = true;
    const cut = this.changesToCut === 0;
    for (let k = 0; k < (cut ? bytes / 2 : bytes); k++) {
      change(k);
    }
    this.clock.tick(cut ? ns / 2 : ns);
    if (cut) {
      this.restart = 'power';
    }
  }

  romFunction(name) {
    const { registers } = this.chip.core;
    const [r0, r1, r2] = registers;
    const memory = (address) => address >>> 0;
    switch (name) {
      case 'RE':
        this.changeFlash((r1 / 4096) * this.eraseNs, r1, (k) => {
          this.chip.flash[r0 + k] = 0xff;
        });
        break;
      case 'RP':
        this.changeFlash((r2 / 256) * PROGRAM_NS, r2, (k) => {
          this.chip.flash[r0 + k] &= this.chip.readUint8(memory(r1) + k);
        });
        break;
      case 'C4':
      case 'MC':
        for (let k = 0; k < r2; k++) {
          this.chip.writeUint8(memory(r0) + k, this.chip.readUint8(memory(r1) + k));
        }
        break;
      case 'MS':
      case 'S4':
        for (let k = 0; k < r2; k++) {
          this.chip.writeUint8(memory(r0) + k, r1 & 0xff);
        }
        break;
      default: // Nothing to do for an emulated flash.
    }
  }
}

function byteNs(uart) {
  return (10 / uart.baudRate) * 1e9;
}

/** Lets a UART send through a FIFO of 32 bytes at its baud rate; the emulator's own takes no time. */
function paced(uart, clock, begin) {
  const fifo = [];
  const half = FIFO_BYTES / 2;
  const write = uart.writeUint32.bind(uart);
  let sending = false;
  const next = () => {
    if (fifo.length > 0 && uart.enabled && !sending) {
      sending = true;
      begin(fifo[0]);
      alarm.schedule(byteNs(uart));
    }
  };
  const alarm = clock.createAlarm(() => {
    fifo.shift();
    sending = false;
    next();
    if (fifo.length === half) {
      uart.interruptStatus |= TX_INTERRUPT;
      if (uart.interruptStatus & uart.interruptMask) {
        // Only ever on: off would also end what the firmware has set pending by itself.
        uart.rp2040.setInterrupt(uart.irq, true);
      }
    }
  });
  uart.checkInterrupts = () =>
    uart.rp2040.setInterrupt(uart.irq, !!(uart.interruptStatus & uart.interruptMask));
  Object.defineProperty(uart, 'flags', {
    get: () =>
      (uart.rxFIFO.full ? 1 << 6 : 0) |
      (uart.rxFIFO.empty ? 1 << 4 : 0) |
      (fifo.length === 0 ? 1 << 7 : 1 << 3) |
      (fifo.length >= FIFO_BYTES ? 1 << 5 : 0),
  });
  const read = uart.readUint32.bind(uart);
  let dma = 0;
  uart.readUint32 = (offset) => (offset === DMA_CONTROL ? dma : read(offset));
  uart.writeUint32 = (offset, value) => {
    if (offset === DMA_CONTROL) {
      dma = value;
      return;
    }
    if (offset !== 0) {
      write(offset, value);
      next();
      return;
    }
    if (fifo.length >= FIFO_BYTES) {
      throw new Error('a byte was written into a full FIFO');
    }
    fifo.push(value & 0xff);
    next();
    if (fifo.length > half) {
      uart.interruptStatus &= ~TX_INTERRUPT;
      uart.checkInterrupts();
    }
  };
}

/** A ROM of which each function breaks with its number and returns. */
function bootrom() {
  const rom = new Uint32Array(4096);
  const halves = new Uint16Array(rom.buffer);
  const TABLE = 0x40;
  const LOOKUP = 0x100;
  const FUNCTIONS = 0x200;
  rom[0] = RAM + 264 * 1024;
  halves[0x14 / 2] = TABLE;
  halves[0x18 / 2] = LOOKUP | 1;
  ROM_FUNCTIONS.forEach((code, index) => {
    const entry = TABLE / 2 + index * 2;
    halves[entry] = code.charCodeAt(0) | (code.charCodeAt(1) << 8);
    halves[entry + 1] = (FUNCTIONS + index * 4) | 1;
    halves[FUNCTIONS / 2 + index * 2] = 0xbe00 | index; // bkpt
    halves[FUNCTIONS / 2 + index * 2 + 1] = 0x4770; // bx lr
  });
  // lookup(table, code): the pointer beside the code, or 0.
  [
    0x8802, // next: ldrh r2, [r0]
    0x8843, //       ldrh r3, [r0, #2]
    0x3004, //       adds r0, #4
    0x2a00, //       cmp r2, #0
    0xd002, //       beq none
    0x428a, //       cmp r2, r1
    0xd1f8, //       bne next
    0x4618, //       mov r0, r3
    0x4770, //       bx lr
  ].forEach((half, index) => {
    halves[LOOKUP / 2 + index] = half;
  });
  // none: falls on the return with r0 = 0.
  halves[LOOKUP / 2 + 7] = 0x1c18; // adds r0, r3, #0
  return rom;
}
