//! The FIFO of the simulated LSM303AGR, register by register, in virtual time.

use std::rc::Rc;

use embedded_hal_async::i2c::I2c;
use wimu_model::Counts;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::SimI2c;
use wimu_sim::lsm303agr::ACCELEROMETER_ADDRESS as AT;
use wimu_sim::sensor::Sensor;
use wimu_sim::source::Replay;

const CTRL1: u8 = 0x20;
const CTRL3: u8 = 0x22;
const CTRL5: u8 = 0x24;
const FIFO_CTRL: u8 = 0x2E;
const STREAM: u8 = 0x80;
const UNTIL_FULL: u8 = 0x40;
/// FIFO_SRC.
const ABOVE: u8 = 0x80;
const FULL: u8 = 0x40;
const EMPTY: u8 = 0x20;
/// 400 Hz.
const PERIOD_US: u64 = 2_500;

struct Bench {
    clock: VirtualClock,
    sensor: Sensor,
    bus: SimI2c,
}

impl Bench {
    async fn write(&mut self, register: u8, value: u8) {
        let outcome = self.bus.write(AT, &[register, value]).await;
        outcome.expect("the bus works");
    }

    async fn read<const N: usize>(&mut self, register: u8) -> [u8; N] {
        let mut values = [0; N];
        let register = [register | 0x80];
        let outcome = self.bus.write_read(AT, &register, &mut values).await;
        outcome.expect("the bus works");
        values
    }

    async fn source(&mut self) -> u8 {
        let [source] = self.read(0x2F).await;
        source
    }

    /// The numbers of the `N` oldest samples, in one burst.
    async fn numbers<const BYTES: usize>(&mut self) -> Vec<i16> {
        let bytes: [u8; BYTES] = self.read(0x28).await;
        let sample = |bytes: &[u8]| {
            let axis = |at: usize| i16::from_le_bytes([bytes[at], bytes[at + 1]]) >> 4;
            let [x, y, z] = [axis(0), axis(2), axis(4)];
            assert_eq!([y, z], [-x, x], "torn");
            x
        };
        bytes.chunks(6).map(sample).collect()
    }

    /// Waits until as many samples have been taken and no other one is near.
    async fn taken(&self, count: u64) {
        while self.sensor.samples_taken() < count {
            self.clock.until(self.clock.now() + 50).await;
        }
        self.clock.until(self.clock.now() + PERIOD_US / 2).await;
    }
}

/// Runs `use_it` with a sensor whose samples tell their number, 12 bits at 400 Hz, and whose FIFO
/// is in this mode.
fn on_bench(fifo: u8, use_it: impl AsyncFnOnce(&mut Bench)) {
    let clock = VirtualClock::new();
    let counts = (0..500).map(|k| Counts([k << 4, -(k << 4), k << 4]));
    let sensor = Sensor::lsm303agr(&clock, Replay::new(counts));
    let bus = SimI2c::new(&clock, [Rc::new(sensor.clone()) as Rc<_>]);
    let mut bench = Bench { clock: clock.clone(), sensor, bus };
    let run = async {
        bench.write(0x23, 0x88).await;
        bench.write(CTRL3, 0x04).await;
        bench.write(CTRL5, 0x40).await;
        bench.write(FIFO_CTRL, fifo).await;
        bench.write(CTRL1, 0x77).await;
        use_it(&mut bench).await;
    };
    clock.run(run).expect("nothing stalls");
}

#[test]
fn every_sample_is_given_once_and_one_burst_gives_several() {
    on_bench(STREAM, async |bench| {
        assert_eq!(bench.source().await, EMPTY);
        bench.taken(4).await;
        assert_eq!(bench.source().await, ABOVE | 4);
        assert_eq!(bench.numbers::<18>().await, [0, 1, 2]);
        assert_eq!(bench.source().await, ABOVE | 1);
        assert_eq!(bench.numbers::<6>().await, [3]);
        assert_eq!(bench.source().await, EMPTY);
        bench.taken(6).await;
        assert_eq!(bench.numbers::<12>().await, [4, 5]);
    });
}

#[test]
fn the_line_is_high_while_more_wait_than_the_threshold() {
    on_bench(STREAM | 7, async |bench| {
        for round in 0..5 {
            assert_eq!(bench.sensor.ready().await, bench.clock.now());
            assert_eq!(bench.source().await, ABOVE | 8);
            bench.numbers::<6>().await;
            assert_eq!(bench.source().await, 7);
            let rest = bench.numbers::<42>().await;
            assert_eq!(rest[6], round * 8 + 7);
        }
    });
}

#[test]
fn a_full_fifo_says_so_and_goes_on_without_the_oldest_or_stops() {
    for (mode, oldest) in [(STREAM, 8), (UNTIL_FULL, 0)] {
        on_bench(mode | 15, async |bench| {
            bench.taken(31).await;
            assert_eq!(bench.source().await, ABOVE | 31);
            bench.taken(32).await;
            assert_eq!(bench.source().await, ABOVE | FULL | 31);
            bench.taken(40).await;
            assert_eq!(bench.source().await, ABOVE | FULL | 31);
            assert_eq!(bench.numbers::<6>().await, [oldest]);
            assert_eq!(bench.source().await, ABOVE | 31);
        });
    }
}

#[test]
fn bypass_empties_it() {
    on_bench(STREAM, async |bench| {
        bench.taken(5).await;
        bench.write(FIFO_CTRL, 0).await;
        assert_eq!(bench.source().await, EMPTY);
        bench.write(FIFO_CTRL, STREAM).await;
        bench.taken(6).await;
        assert_eq!(bench.numbers::<6>().await, [5]);
    });
}

#[test]
fn the_oldest_sample_of_a_full_fifo_can_be_replaced_while_it_is_read() {
    on_bench(STREAM, async |bench| {
        bench.taken(40).await;
        // Half of it, then half of the one that took its place.
        let [x0, x1]: [u8; 2] = bench.read(0x28).await;
        bench.taken(41).await;
        let [z0, z1]: [u8; 2] = bench.read(0x2C).await;
        let numbers = [[x0, x1], [z0, z1]].map(|axis| i16::from_le_bytes(axis) >> 4);
        assert_eq!(numbers, [8, 9]);
    });
}
