// Runs an image for a while. Usage: node run.mjs IMAGE.uf2 SECONDS FOLDER [SCRIPT.json]
//
// WIMU_PICO_SENSOR=mpu6050: the sensor is an MPU-6050 instead of an ADXL345.
// FOLDER gets wireless.bin and cable.bin, what came out of UART0 and UART1, and report.json. SCRIPT
// is a list of {"at_ms", "uart", "hex"}, bytes to send, {"at_ms", "uart", "baud"}, the rate of the
// other end from then on, and {"at_ms", "do"}: "unplug" and "plug" the sensor, "exchange" it for
// another chip, "hold" the bus low and "release" it, "nack" a byte of the sensor's, give the flash
// its longest erase ("slow_flash"), "damage" the image, "hang" or "fault" the processor, let it go on in the function at
// "address" with an "argument" ("call"), press "reset", take the "power" off, or when the flash has been changed "count" times from then on, in the middle of that ("cut").

import { mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { Adxl345 } from './adxl345.mjs';
import { Pico } from './machine.mjs';
import { Mpu6050 } from './mpu6050.mjs';

const [image, seconds, folder, script] = process.argv.slice(2);
const pico = new Pico();
const INT1 = 6;
const noise = (number, axis) => Math.sin(number * (1.7 + axis)) * 0.004;
const isMpu = process.env.WIMU_PICO_SENSOR === 'mpu6050';
const sensor = new (isMpu ? Mpu6050 : Adxl345)(
  pico.clock,
  (level) => pico.setPin(INT1, level),
  (number) => [0.05 + noise(number, 0), -0.04 + noise(number, 1), 0.98 + noise(number, 2)],
  0.021,
);
pico.connect(isMpu ? 0x68 : 0x53, sensor);
pico.load(readFileSync(image));

const actions = script ? JSON.parse(readFileSync(script)) : [];
actions.sort((a, b) => a.at_ms - b.at_ms);
for (const action of actions) {
  pico.run(action.at_ms * 1e6);
  if (action.hex) {
    pico.send(action.uart, Buffer.from(action.hex, 'hex'));
  }
  if (action.baud) {
    pico.hostBaud[action.uart] = action.baud;
  }
  switch (action.do) {
    case undefined:
    case '':
      break;
    case 'unplug':
      pico.absent = true;
      break;
    case 'plug':
      pico.absent = false;
      break;
    case 'exchange':
      sensor.identity = 0x33;
      break;
    case 'hold':
      pico.held = true;
      break;
    case 'release':
      pico.held = false;
      break;
    case 'nack':
      pico.nacks = 1;
      break;
    case 'slow_flash':
      pico.eraseNs = 400e6;
      break;
    case 'cut':
      pico.changesToCut = action.count;
      break;
    case 'power':
      pico.restart = 'power';
      break;
    case 'hang':
      pico.hang();
      break;
    case 'damage':
      pico.damage();
      break;
    case 'fault':
      pico.fault();
      break;
    case 'call':
      pico.call(action.address, action.argument);
      break;
    case 'reset':
      pico.restart = 'pin';
      break;
    default:
      throw new Error(`cannot ${action.do}`);
  }
}
pico.run(Number(seconds) * 1e9);

mkdirSync(folder, { recursive: true });
writeFileSync(`${folder}/wireless.bin`, Buffer.from(pico.received[0]));
writeFileSync(`${folder}/cable.bin`, Buffer.from(pico.received[1]));
writeFileSync(
  `${folder}/report.json`,
  JSON.stringify({
    samples: sensor.takenAt.length,
    taken_at_ns: sensor.takenAt,
    overruns: sensor.overruns,
    resets: pico.resets,
    stack_bytes: pico.deepestStack(),
    complaints: pico.complaints.slice(0, 20),
    strange_zeros: pico.strangeZeros,
    longest_masked: pico.masked,
    led: pico.chip.gpio[25].value,
  }),
);
