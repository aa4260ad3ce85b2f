//! The driver of the ADXL345 on the simulated sensor.

use std::rc::Rc;

use embedded_hal_async::i2c::I2c;
use embedded_hal_async::spi::SpiDevice;
use wimu_link::message::Resolution::{High, Normal};
use wimu_model::Counts;
use wimu_node::sensor::SensorFault;
use wimu_sensors::{Adxl345, I2cBus, SpiBus};
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{I2cError, SimI2c};
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::{Physics, Replay, Source};
use wimu_sim::spi::SimSpi;
use wimu_sim::truth::SensorTruth;

use crate::fifo_bench::{OnClock, bus, driver, next, start};

type OnI2c = OnClock<Adxl345<I2cBus<SimI2c>>>;

/// Runs `use_it` with a driver on a bus with a sensor that takes its samples from `source`.
fn on_bench(
    source: impl Source + 'static,
    use_it: impl AsyncFnOnce(&VirtualClock, &Sensor, &mut OnI2c) -> Result<(), SensorFault>,
) {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, source);
    let mut driver = driver(&clock, &sensor, Adxl345::new(bus(&clock, &sensor, 0x53)));
    let outcome = clock.run(use_it(&clock, &sensor, &mut driver));
    outcome.expect("nothing stalls").expect("the bus works");
}

fn at_rest() -> Physics {
    Physics::new(SensorTruth::ideal(), Scene::new(World::default()), 1)
}

/// Samples that tell their number.
fn numbered(count: i16) -> Replay {
    Replay::new((0..count).map(|k| Counts([k << 6, -(k << 6), 0])))
}

fn numbers(samples: &[Counts]) -> impl Iterator<Item = i16> {
    samples.iter().map(|sample| sample.0[0] >> 6)
}

#[test]
fn every_format_reads_one_g_upward() {
    for range_g in [2, 4, 8, 16] {
        for resolution in [Normal, High] {
            on_bench(at_rest(), async |_, _, driver| {
                let plan = start(driver, 100, range_g, resolution).await?;
                let (_, samples) = next(driver).await?;
                let [x, y, z] = samples[0].0;
                assert_eq!([x, y], [0, 0]);
                let g = f64::from(z) / plan.sensor.accelerometer.sensitivity().lsb_per_g();
                // Local gravity, to half a step.
                assert!((g - 1.0).abs() < 0.02 * f64::from(range_g), "±{range_g} g: {g} g");
                Ok(())
            });
        }
    }
}

#[test]
fn the_fifo_gives_every_sample_once_and_int1_follows_the_watermark() {
    on_bench(numbered(500), async |clock, sensor, driver| {
        start(driver, 400, 2, High).await?;
        let mut expected = 0;
        for _ in 0..20 {
            let (batch, samples) = next(driver).await?;
            assert!((16..=17).contains(&batch.count) && !batch.overrun, "{batch:?}");
            for number in numbers(&samples) {
                assert_eq!(number, expected);
                expected += 1;
            }
            assert!(!sensor.is_ready(), "the line falls with the reading");
            let taken_us = 1_100 + u64::from(expected.unsigned_abs()) * 2_500;
            assert!(batch.last_time.0.abs_diff(taken_us) < 5_000, "{batch:?}");
            assert!(clock.now() - batch.last_time.0 < 6_500);
        }
        Ok(())
    });
}

#[test]
fn a_full_fifo_drops_the_oldest_and_says_so_once() {
    on_bench(numbered(500), async |clock, _, driver| {
        start(driver, 400, 2, High).await?;
        clock.until(clock.now() + 1_100 + 2_500 * 41).await;
        let (batch, samples) = next(driver).await?;
        assert!(batch.overrun);
        // The newest 32, of which the oldest eight are given up, and some may be overwritten meanwhile.
        assert!(matches!(numbers(&samples).next(), Some(17..=22)), "{samples:?}");
        assert!(!next(driver).await?.0.overrun);
        Ok(())
    });
}

#[test]
fn a_byte_read_alone_is_the_last_of_its_sample() {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, numbered(500));
    let mut bus = SimI2c::new(&clock, [Rc::new(sensor) as Rc<_>]);
    let low_bytes = clock.run(async {
        bus.write(0x53, &[0x38, 0x90]).await?;
        bus.write(0x53, &[0x31, 0x04]).await?;
        bus.write(0x53, &[0x2D, 0x08]).await?;
        clock.until(100_000).await;
        let mut bytes = [[0]; 3];
        for byte in &mut bytes {
            bus.write_read(0x53, &[0x32], byte).await?;
        }
        Ok::<_, I2cError>(bytes)
    });
    assert_eq!(low_bytes.unwrap().unwrap(), [[0], [0x40], [0x80]]);
}

#[test]
fn the_oscillator_sets_the_rate() {
    for ppm in [-50_000.0, 50_000.0] {
        let mut physics = at_rest();
        physics.truth.period_error_ppm = ppm;
        on_bench(physics, async |clock, sensor, driver| {
            start(driver, 100, 2, High).await?;
            clock.until(clock.now() + 1_100 + 10_000_000).await;
            let expected = (1000.0 / (1.0 + ppm * 1e-6)) as u64;
            assert_eq!(sensor.samples_taken(), expected);
            Ok(())
        });
    }
}

#[test]
fn each_address_answers_alone() {
    for (address, other) in [(0x53, 0x1D), (0x1D, 0x53)] {
        let clock = VirtualClock::new();
        let sensor = Sensor::adxl345_at(&clock, address, at_rest());
        for (asked, answer) in [(address, Ok(())), (other, Err(SensorFault::NotAnswering))] {
            let mut driver = driver(&clock, &sensor, Adxl345::new(bus(&clock, &sensor, asked)));
            let started = clock.run(start(&mut driver, 100, 2, High)).expect("nothing stalls");
            assert_eq!(started.map(|_| ()), answer, "{asked:#x}");
        }
    }
}

/// At the fastest clock, where the FIFO advances more slowly than a driver can read.
#[test]
fn on_spi_the_fifo_gives_every_sample_once() {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, numbered(500));
    let spi = SpiBus(SimSpi::new(&clock, Rc::new(sensor.clone()), 5_000_000));
    let mut driver = driver(&clock, &sensor, Adxl345::new(spi));
    let outcome = clock.run(async {
        start(&mut driver, 800, 2, High).await?;
        let mut expected = 0;
        for _ in 0..20 {
            for number in numbers(&next(&mut driver).await?.1) {
                assert_eq!(number, expected);
                expected += 1;
            }
        }
        assert!(expected >= 320);
        sensor.set_present(false);
        let absent = start(&mut driver, 800, 2, High).await;
        assert_eq!(absent, Err(SensorFault::NotAnswering));
        Ok::<_, SensorFault>(())
    });
    outcome.expect("nothing stalls").expect("the bus works");
}

#[test]
fn on_spi_a_sample_read_within_5_us_is_the_one_before() {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, numbered(500));
    let mut spi = SimSpi::new(&clock, Rc::new(sensor), 5_000_000);
    let outcome = clock.run(async {
        for register in [[0x38, 0x90], [0x31, 0x04], [0x2D, 0x08]] {
            spi.write(&register).await?;
        }
        clock.until(100_000).await;
        let mut first = [0; 7];
        spi.transfer(&mut first, &[0xF2]).await?;
        let mut again = [0; 7];
        spi.transfer(&mut again, &[0xF2]).await?;
        Ok::<_, std::convert::Infallible>((first, again))
    });
    let (first, again) = outcome.expect("nothing stalls").expect("the bus works");
    assert_eq!(first, again, "the FIFO has not advanced");
}
