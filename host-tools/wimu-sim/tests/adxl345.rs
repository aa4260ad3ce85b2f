//! The `wimu-adxl345` driver on the simulated sensor, in virtual time.

use std::rc::Rc;

use embedded_hal_async::i2c::I2c;
use embedded_hal_async::spi::SpiDevice;
use wimu_adxl345::{
    Address, Adxl345, Bus, DataFormat, Error, Fifo, I2cBus, Interrupts, Justify, Range, Rate,
    Resolution, Setup, SpiBus,
};
use wimu_model::Counts;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{I2cError, SimI2c};
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::{Physics, Replay, Source};
use wimu_sim::spi::SimSpi;
use wimu_sim::truth::SensorTruth;

type Outcome = Result<(), Error<I2cError>>;

/// Runs `use_it` with a driver on a bus with a sensor that takes its samples from `source`.
fn on_bench(
    source: impl Source + 'static,
    use_it: impl AsyncFnOnce(&VirtualClock, &Sensor, &mut Adxl345<I2cBus<SimI2c>>) -> Outcome,
) {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, source);
    let i2c = SimI2c::new(&clock, [Rc::new(sensor.clone()) as Rc<_>]);
    let address = Address::Low;
    let mut driver = Adxl345::new(I2cBus { i2c, address });
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

const SETUP: Setup = Setup {
    format: DataFormat { range: Range::G2, resolution: Resolution::Full, justify: Justify::Left },
    rate: Rate::Hz100,
    low_power: false,
    fifo: Fifo::Bypass,
    interrupts: Interrupts::WATERMARK,
    on_int2: Interrupts::NONE,
};

async fn start<B: Bus>(
    driver: &mut Adxl345<B>,
    rate: Rate,
    fifo: Fifo,
) -> Result<(), Error<B::Error>> {
    driver.check_identity().await?;
    driver.start(&Setup { rate, fifo, ..SETUP }).await
}

async fn number<B: Bus>(driver: &mut Adxl345<B>) -> Result<i16, Error<B::Error>> {
    Ok(driver.sample().await?[0] >> 6)
}

#[test]
fn every_format_reads_one_g_upward() {
    for range in [Range::G2, Range::G4, Range::G8, Range::G16] {
        for resolution in [Resolution::TenBits, Resolution::Full] {
            for justify in [Justify::Right, Justify::Left] {
                let format = DataFormat { range, resolution, justify };
                on_bench(at_rest(), async |clock, _, driver| {
                    driver.start(&Setup { format, ..SETUP }).await?;
                    clock.until(30_000).await;
                    let [x, y, z] = driver.sample().await?;
                    assert_eq!([x, y], [0, 0]);
                    let g = f64::from(z) / f64::from(format.lsb_per_g());
                    // Local gravity, to half a step.
                    let step = f64::from(range as u8 + 1) * 0.04;
                    assert!((g - 1.0).abs() < step, "{format:?}: {g} g");
                    Ok(())
                });
            }
        }
    }
}

#[test]
fn the_fifo_gives_every_sample_once_and_int1_follows_the_watermark() {
    on_bench(numbered(500), async |clock, sensor, driver| {
        start(driver, Rate::Hz400, Fifo::Stream { watermark: 8 }).await?;
        let (mut expected, mut rose_us) = (0, 0);
        for _ in 0..20 {
            rose_us = sensor.ready().await;
            assert_eq!(rose_us, clock.now(), "the line rises with the sample");
            let waiting = driver.fifo_level().await?.samples;
            assert!((8..=9).contains(&waiting), "{waiting}");
            for _ in 0..waiting {
                assert_eq!(number(driver).await?, expected);
                expected += 1;
            }
            assert!(!sensor.is_ready(), "the line falls with the reading");
        }
        let period = (rose_us - 1_100) as f64 / f64::from(expected);
        assert!((period - 2_500.0).abs() < 60.0, "{period} µs");
        Ok(())
    });
}

#[test]
fn a_full_fifo_drops_the_oldest_and_says_so_until_data_are_read() {
    on_bench(numbered(500), async |clock, _, driver| {
        start(driver, Rate::Hz400, Fifo::Stream { watermark: 16 }).await?;
        clock.until(clock.now() + 1_100 + 2_500 * 41).await;
        assert_eq!(driver.fifo_level().await?.samples, 32);
        assert!(driver.interrupts().await?.contains(Interrupts::OVERRUN));
        assert_eq!(number(driver).await?, 41 - 32);
        assert!(!driver.interrupts().await?.contains(Interrupts::OVERRUN));
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
            start(driver, Rate::Hz100, Fifo::Stream { watermark: 1 }).await?;
            clock.until(clock.now() + 1_100 + 10_000_000).await;
            let expected = (1000.0 / (1.0 + ppm * 1e-6)) as u64;
            assert_eq!(sensor.samples_taken(), expected);
            Ok(())
        });
    }
}

#[test]
fn each_address_answers_alone() {
    for (address, other) in [(Address::Low, Address::High), (Address::High, Address::Low)] {
        let clock = VirtualClock::new();
        let sensor = Sensor::adxl345_at(&clock, address as u8, at_rest());
        for (asked, answer) in [(address, Ok(())), (other, Err(Error::NotAnswering))] {
            let i2c = SimI2c::new(&clock, [Rc::new(sensor.clone()) as Rc<_>]);
            let mut driver = Adxl345::new(I2cBus { i2c, address: asked });
            let checked = clock.run(driver.check_identity());
            assert_eq!(checked.expect("nothing stalls"), answer, "{asked:?}");
        }
    }
}

/// At the fastest clock, where the FIFO advances more slowly than a driver can read.
#[test]
fn on_spi_the_fifo_gives_every_sample_once() {
    let clock = VirtualClock::new();
    let sensor = Sensor::adxl345(&clock, numbered(500));
    let mut driver = Adxl345::new(SpiBus(SimSpi::new(&clock, Rc::new(sensor.clone()), 5_000_000)));
    let outcome = clock.run(async {
        start(&mut driver, Rate::Hz3200, Fifo::Stream { watermark: 16 }).await?;
        let mut expected = 0;
        for _ in 0..20 {
            sensor.ready().await;
            for _ in 0..driver.fifo_level().await?.samples {
                // At this rate the lowest bit is 0.
                assert_eq!(number(&mut driver).await?, expected & !1);
                expected += 1;
            }
        }
        assert!(expected >= 320);
        sensor.set_present(false);
        assert_eq!(driver.check_identity().await, Err(Error::NotAnswering));
        Ok::<_, Error<_>>(())
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
