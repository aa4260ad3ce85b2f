//! What the simulated LSM6DSO puts out, in virtual time. Its registers are tested in `wimu-lsm6dso`, a board with it in
//! `wimu-tests`.

use std::rc::Rc;

use embedded_hal_async::i2c::I2c;
use wimu_lsm6dso::{
    AccelerationRange, Address, AngularRateRange, Batch, Bus, Error, I2cBus, Lsm6dso, Power, Rate,
    Sample, Setup, SpiBus,
};
use wimu_model::{Counts, STANDARD_GRAVITY_MPS2};
use wimu_sim::attitude::Attitude;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{I2cError, SimI2c};
use wimu_sim::motion::{Motion, Pose};
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::{Physics, Source};
use wimu_sim::spi::SimSpi;
use wimu_sim::truth::{Gauge, SensorTruth};

const RANGES_G: [AccelerationRange; 4] =
    [AccelerationRange::G2, AccelerationRange::G4, AccelerationRange::G8, AccelerationRange::G16];
const RANGES_DPS: [(AngularRateRange, f64); 5] = [
    (AngularRateRange::Dps125, 125.0),
    (AngularRateRange::Dps250, 250.0),
    (AngularRateRange::Dps500, 500.0),
    (AngularRateRange::Dps1000, 1000.0),
    (AngularRateRange::Dps2000, 2000.0),
];
const SETUP: Setup = Setup {
    acceleration: AccelerationRange::G4,
    angular_rate: AngularRateRange::Dps500,
    rate: Rate::Hz208,
    power: Power::High,
    watermark: 8,
};
/// 10 MHz.
const SPI_HZ: u32 = 10_000_000;

/// What a test holds beside the driver.
struct Bench {
    clock: VirtualClock,
    sensor: Sensor,
}

impl Bench {
    fn new(address: u8, source: impl Source + 'static) -> Self {
        let clock = VirtualClock::new();
        let sensor = Sensor::lsm6dso(&clock, address, source);
        Self { clock, sensor }
    }

    fn i2c(&self) -> SimI2c {
        SimI2c::new(&self.clock, [Rc::new(self.sensor.clone()) as Rc<_>])
    }

    /// Runs `use_it` with a driver on I²C.
    fn on_i2c(
        &self,
        use_it: impl AsyncFnOnce(&mut Lsm6dso<I2cBus<SimI2c>>) -> Result<(), Error<I2cError>>,
    ) {
        let i2c = self.i2c();
        let address = Address::Low;
        let mut driver = Lsm6dso::new(I2cBus { i2c, address });
        let outcome = self.clock.run(use_it(&mut driver));
        outcome.expect("nothing stalls").expect("the bus works");
    }

    /// Runs `use_it` with a driver on SPI.
    fn on_spi<R>(&self, use_it: impl AsyncFnOnce(&mut Lsm6dso<SpiBus<SimSpi>>) -> R) -> R {
        let spi = SimSpi::new(&self.clock, Rc::new(self.sensor.clone()), SPI_HZ);
        let mut driver = Lsm6dso::new(SpiBus(spi));
        let outcome = self.clock.run(use_it(&mut driver));
        outcome.expect("nothing stalls")
    }

    /// Lets time pass.
    async fn wait_us(&self, time_us: u64) {
        self.clock.until(self.clock.now() + time_us).await;
    }
}

/// A level body that rotates at a constant rate about one body axis for an hour.
#[derive(Debug)]
struct Spin([f64; 3]);

impl Motion for Spin {
    fn pose(&self, t: f64) -> Pose {
        let angle = self.0.map(|dps| dps.to_radians() * t);
        Pose {
            angular_rate_radps: self.0.map(f64::to_radians),
            ..Pose::resting(Attitude::from_rotation_vector(angle))
        }
    }

    fn duration(&self) -> f64 {
        3600.0
    }
}

fn spinning(dps: [f64; 3]) -> Scene {
    let scene = Scene::new(World::default());
    scene.play(0.0, Rc::new(Spin(dps)));
    scene
}

/// An ideal sensor in `scene`.
fn ideal(scene: Scene) -> Bench {
    Bench::new(0x6A, Physics::new(SensorTruth::ideal(), scene, 1))
}

/// Samples that tell their number on every axis of both sensors.
#[derive(Debug)]
struct Numbered;

impl Source for Numbered {
    fn acceleration(&mut self, conversion: &wimu_sim::source::Conversion) -> Option<Counts> {
        Some(Counts([conversion.index as i16; 3]))
    }
    fn angular_rate(&mut self, index: u64, _: f64, _: f64, _: f64) -> Counts {
        // The gyroscope's samples during its turn-on time come from the model itself.
        Counts([index as i16; 3])
    }
    fn magnetic_field_nt(&mut self, _index: u64, _time_s: f64) -> [f64; 3] {
        [0.0; 3]
    }
    fn temperature_c(&mut self, _time_s: f64) -> f64 {
        25.0
    }
}

fn numbered() -> Bench {
    Bench::new(0x6A, Numbered)
}

/// Reads the FIFO until it holds less than a sample, or for 40 bursts on a bus that hardly keeps up.
async fn drain<B: Bus>(
    driver: &mut Lsm6dso<B>,
) -> Result<(Vec<Batch>, Vec<Sample>), Error<B::Error>> {
    let (mut batches, mut all) = (Vec::new(), Vec::new());
    for _ in 0..40 {
        let mut samples = [Sample::default(); 16];
        let batch = driver.read(&mut samples).await?;
        batches.push(batch);
        all.extend_from_slice(&samples[..batch.count]);
        if batch.samples_left < 1 {
            break;
        }
    }
    Ok((batches, all))
}

fn near(counts: i16, lsb: f64, expected: f64) {
    let found = f64::from(counts) * lsb;
    assert!((found - expected).abs() <= 0.51 * lsb, "{found}, expected {expected}");
}

#[test]
fn every_range_reads_gravity_and_a_constant_rate() {
    for range in RANGES_G {
        for (angular_range, dps) in RANGES_DPS {
            // Half of the range about the vertical.
            let bench = ideal(spinning([0.0, 0.0, -dps / 2.0]));
            bench.on_i2c(async |driver| {
                let setup = Setup { acceleration: range, angular_rate: angular_range, ..SETUP };
                driver.start(&setup, &mut bench.clock.clone()).await?;
                bench.wait_us(50_000).await;
                let (_, samples) = drain(driver).await?;
                assert!(samples.len() >= 9);
                for sample in samples {
                    let g = f64::from(range.ug_per_lsb()) * 1e-6;
                    let [x, y, z] = sample.acceleration;
                    near(x, g, 0.0);
                    near(y, g, 0.0);
                    near(z, g, 1.0);
                    let lsb = f64::from(angular_range.udps_per_lsb()) * 1e-6;
                    assert_eq!(sample.angular_rate[..2], [0, 0]);
                    near(sample.angular_rate[2], lsb, -dps / 2.0);
                }
                Ok(())
            });
        }
    }
}

#[test]
fn no_sample_of_the_turn_on_time_is_delivered() {
    for rate in Rate::ALL {
        let bench = ideal(Scene::new(World::default()));
        bench.on_spi(async |driver| {
            let setup = Setup { rate, ..SETUP };
            let clock = &bench.clock;
            driver.start(&setup, &mut clock.clone()).await.expect("the bus works");
            bench.wait_us(20 * u64::from(rate.period_ns()) / 1000).await;
            let (_, samples) = drain(driver).await.expect("the bus works");
            assert!(samples.len() >= 19, "{rate:?}");
            assert!(samples.iter().all(|sample| sample.angular_rate == [0; 3]), "{rate:?}");
        });
    }
}

#[test]
fn output_registers_keep_the_bytes_of_a_value_together() {
    let bench = numbered();
    let mut i2c = bench.i2c();
    let value = async |i2c: &mut SimI2c, control: u8| {
        i2c.write(0x6A, &[0x12, control]).await?;
        let (mut low, mut high) = ([0], [0]);
        i2c.write_read(0x6A, &[0x28], &mut low).await?;
        // 256 samples later.
        bench.wait_us(256 * 150).await;
        i2c.write_read(0x6A, &[0x29], &mut high).await?;
        let after = bench.sensor.samples_taken() - 1;
        Ok::<_, I2cError>((u16::from_le_bytes([low[0], high[0]]), after as u16))
    };
    let outcome = bench.clock.run(async {
        i2c.write(0x6A, &[0x10, 0xA0]).await?;
        bench.wait_us(150_000).await;
        let (held, after) = value(&mut i2c, 0x44).await?;
        assert!((after - held).abs_diff(258) <= 2, "{held}, {after}");
        let (torn, after) = value(&mut i2c, 0x04).await?;
        assert!((after - torn) < 5, "{torn}, {after}");
        Ok::<_, I2cError>(())
    });
    outcome.expect("nothing stalls").expect("the bus works");
}

#[test]
fn the_oscillator_sets_the_rate() {
    let scene = Scene::new(World::default());
    let mut physics = Physics::new(SensorTruth::ideal(), scene, 1);
    physics.truth.period_error_ppm = -15_000.0;
    let bench = Bench::new(0x6A, physics);
    bench.on_i2c(async |driver| {
        driver.start(&SETUP, &mut bench.clock.clone()).await?;
        let before = bench.sensor.samples_taken();
        bench.wait_us(4_800_000).await;
        let taken = bench.sensor.samples_taken() - before;
        assert!(taken.abs_diff(1015) <= 1, "{taken}");
        Ok(())
    });
}

#[test]
fn hidden_errors_and_noise_appear_in_the_counts() {
    let scene = Scene::new(World::default());
    let truth = SensorTruth::random_lsm6dso(7, Gauge::Full);
    let bench = Bench::new(0x6A, Physics::new(truth, scene, 7));
    let (truth, terms) = (truth.gyroscope, truth.gyroscope.model.terms());
    bench.on_spi(async |driver| {
        let setup = Setup { angular_rate: AngularRateRange::Dps125, ..SETUP };
        let started = driver.start(&setup, &mut bench.clock.clone()).await;
        started.expect("SPI works");
        let mut rates = Vec::new();
        for _ in 0..100 {
            bench.wait_us(400_000).await;
            let (_, samples) = drain(driver).await.expect("SPI works");
            rates.extend(samples.iter().map(|sample| sample.angular_rate));
        }
        let n = rates.len() as f64;
        for axis in 0..3 {
            let dps: Vec<f64> = rates.iter().map(|rate| f64::from(rate[axis]) * 4.375e-3).collect();
            let mean = dps.iter().sum::<f64>() / n;
            let g_sensitivity = terms.g_sensitivity[axis][2] * STANDARD_GRAVITY_MPS2;
            let expected = (terms.bias_rad_s[axis] + g_sensitivity).to_degrees();
            assert!((mean - expected).abs() < 3e-3, "{mean}");
            let sd = (dps.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / n).sqrt();
            let density = truth.noise_radps_per_rthz.to_degrees();
            let expected = density * (1e9 / 4_800_000.0 / 2.0_f64).sqrt();
            assert!((sd / expected - 1.0).abs() < 0.05, "{sd}, expected {expected}");
        }
    });
}
