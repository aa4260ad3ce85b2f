// A Pico: the emulated chip with its ROM's flash functions, UARTs that take their time, and a bus.

import { RP2040 } from 'rp2040js';

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

export class Pico {
  constructor() {
    const chip = new RP2040();
    this.chip = chip;
    this.clock = chip.clock;
    chip.logger = { debug() {}, info() {}, warn() {}, error: (...words) => this.complaints.push(words.join(' ')) };
    this.complaints = [];
    this.resets = 0;
    chip.loadBootrom(bootrom());
    chip.onBreak = (number) => this.romFunction(ROM_FUNCTIONS[number]);
    chip.peripherals[0x40058].onWatchdogTrigger = () => {
      this.resets += 1;
      this.restart = true;
    };
    this.received = [[], []];
    chip.uart.forEach((uart, index) => paced(uart, this.clock, (byte) => {
      this.received[index].push(byte);
      this.onByte?.(index, byte);
    }));
  }

  /** Puts an image of UF2 blocks into the flash. */
  load(uf2) {
    for (let at = 0; at + 512 <= uf2.length; at += 512) {
      const block = uf2.subarray(at, at + 512);
      const view = new DataView(block.buffer, block.byteOffset, 512);
      if (view.getUint32(0, true) !== 0x0a324655 || view.getUint32(28, true) !== 0xe48bff56) {
        throw new Error(`block ${at / 512} is no UF2 for an RP2040`);
      }
      const address = view.getUint32(12, true);
      this.chip.flash.set(block.subarray(32, 32 + view.getUint32(16, true)), address - FLASH);
    }
    this.boot();
  }

  boot() {
    // The second stage of the bootloader sits at the start of the flash.
    this.chip.core.reset();
    this.chip.core.PC = FLASH;
  }

  /** Connects a device that has begin, write and read to I2C0. */
  connect(address, device) {
    const bus = this.chip.i2c[0];
    const byteNs = 9 / 400e3 * 1e9;
    const later = (done) => {
      const alarm = this.clock.createAlarm(done);
      alarm.schedule(byteNs);
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
    this.absent = false;
    bus.onStart = () => bus.completeStart();
    bus.onConnect = (asked, mode) => later(() => {
      mine = asked === address && !this.absent;
      if (mine && mode === 0) {
        device.begin();
      }
      bus.completeConnect(mine);
    });
    bus.onWriteByte = (byte) => later(() => {
      device.write(byte);
      bus.completeWrite(!this.absent);
    });
    bus.onReadByte = () => later(() => bus.completeRead(device.read()));
    bus.onStop = () => bus.completeStop();
  }

  /** Sends bytes to a UART at its speed. */
  send(index, bytes) {
    const uart = this.chip.uart[index];
    let at = 0;
    const alarm = this.clock.createAlarm(() => {
      uart.feedByte(bytes[at]);
      at += 1;
      if (at < bytes.length) {
        alarm.schedule(byteNs(uart));
      }
    });
    if (bytes.length > 0) {
      alarm.schedule(byteNs(uart));
    }
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

  /** Runs up to `ns` on the clock. */
  run(ns) {
    const { core } = this.chip;
    const { clock } = this;
    while (clock.nanos < ns) {
      if (this.restart) {
        this.restart = false;
        this.boot();
      }
      if (core.waiting) {
        const idle = clock.nanosToNextAlarm;
        clock.tick(idle > 0 ? Math.min(idle, ns - clock.nanos) : 8);
      } else {
        clock.tick(core.executeInstruction() * 8);
      }
    }
  }

  romFunction(name) {
    const { registers } = this.chip.core;
    const [r0, r1, r2] = registers;
    const memory = (address) => address >>> 0;
    switch (name) {
      case 'RE':
        this.chip.flash.fill(0xff, r0, r0 + r1);
        this.clock.tick((r1 / 4096) * ERASE_NS);
        break;
      case 'RP':
        for (let k = 0; k < r2; k++) {
          this.chip.flash[r0 + k] &= this.chip.readUint8(memory(r1) + k);
        }
        this.clock.tick((r2 / 256) * PROGRAM_NS);
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
function paced(uart, clock, deliver) {
  const fifo = [];
  const half = FIFO_BYTES / 2;
  const write = uart.writeUint32.bind(uart);
  const alarm = clock.createAlarm(() => {
    deliver(fifo.shift());
    if (fifo.length > 0) {
      alarm.schedule(byteNs(uart));
    }
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
      return;
    }
    if (fifo.length >= FIFO_BYTES) {
      throw new Error('a byte was written into a full FIFO');
    }
    fifo.push(value & 0xff);
    if (fifo.length === 1) {
      alarm.schedule(byteNs(uart));
    }
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
