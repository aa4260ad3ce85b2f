//! What the simulated LSM6DSO puts out, in virtual time. Its registers are tested in `wimu-sensors`, a board with it in
//! `wimu-tests`.

use std::rc::Rc;

use embedded_hal_async::i2c::I2c;
use wimu_link::message::Resolution::High;
use wimu_model::{Counts, STANDARD_GRAVITY_MPS2};
use wimu_node::sensor::SensorFault;
use wimu_sensors::{Lsm6dso, SpiBus};
use wimu_sim::attitude::Attitude;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{I2cError, SimI2c};
use wimu_sim::motion::{Motion, Pose};
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::{Physics, Source};
use wimu_sim::spi::SimSpi;
use wimu_sim::truth::{Gauge, SensorTruth};

use crate::fifo_bench::{OnClock, bus, driver, next, start};

/// 10 MHz.
const SPI_HZ: u32 = 10_000_000;
/// LSB of the gyroscope at ±2000 °/s, °/s.
const DPS_PER_LSB: f64 = 0.07;

/// What a test holds beside the driver.
struct Bench {
    clock: VirtualClock,
    sensor: Sensor,
}

impl Bench {
    fn new(source: impl Source + 'static) -> Self {
        let clock = VirtualClock::new();
        let sensor = Sensor::lsm6dso(&clock, 0x6A, source);
        Self { clock, sensor }
    }

    /// Runs `use_it` with a driver on SPI.
    fn on_spi(
        &self,
        use_it: impl AsyncFnOnce(&mut OnClock<Lsm6dso<SpiBus<SimSpi>>>) -> Result<(), SensorFault>,
    ) {
        let spi = SimSpi::new(&self.clock, Rc::new(self.sensor.clone()), SPI_HZ);
        let mut driver = driver(&self.clock, &self.sensor, Lsm6dso::new(SpiBus(spi)));
        let outcome = self.clock.run(use_it(&mut driver));
        outcome.expect("nothing stalls").expect("SPI works");
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
    Bench::new(Physics::new(SensorTruth::ideal(), scene, 1))
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

fn near(counts: i16, lsb: f64, expected: f64) {
    let found = f64::from(counts) * lsb;
    assert!((found - expected).abs() <= 0.51 * lsb, "{found}, expected {expected}");
}

#[test]
fn every_range_reads_gravity_and_a_constant_rate() {
    for range_g in [2, 4, 8, 16] {
        // Half of the range about the vertical.
        let bench = ideal(spinning([0.0, 0.0, -1000.0]));
        bench.on_spi(async |driver| {
            let plan = start(driver, 208, range_g, High).await?;
            let (_, samples) = next(driver).await?;
            assert_eq!(samples.len(), 8);
            for (acceleration, angular_rate) in samples {
                let g = 1.0 / plan.sensor.accelerometer.sensitivity().lsb_per_g();
                let [x, y, z] = acceleration.0;
                near(x, g, 0.0);
                near(y, g, 0.0);
                near(z, g, 1.0);
                assert_eq!(angular_rate.0[..2], [0, 0]);
                near(angular_rate.0[2], DPS_PER_LSB, -1000.0);
            }
            Ok(())
        });
    }
}

#[test]
fn no_sample_of_the_turn_on_time_is_delivered() {
    for rate_hz in [13, 26, 52, 104, 208, 416, 833, 1666] {
        let bench = ideal(Scene::new(World::default()));
        bench.on_spi(async |driver| {
            start(driver, rate_hz, 4, High).await?;
            for _ in 0..20 {
                for (_, angular_rate) in next(driver).await?.1 {
                    assert_eq!(angular_rate, Counts([0; 3]), "{rate_hz} Hz");
                }
            }
            Ok(())
        });
    }
}

#[test]
fn output_registers_keep_the_bytes_of_a_value_together() {
    let bench = Bench::new(Numbered);
    let mut i2c = bus(&bench.clock, &bench.sensor, 0x6A).i2c;
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
    let bench = Bench::new(physics);
    bench.on_spi(async |driver| {
        start(driver, 208, 4, High).await?;
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
    let bench = Bench::new(Physics::new(truth, scene, 7));
    let (truth, terms) = (truth.gyroscope, truth.gyroscope.model.terms());
    bench.on_spi(async |driver| {
        start(driver, 208, 4, High).await?;
        let mut rates = Vec::new();
        while rates.len() < 8_000 {
            let samples = next(driver).await?.1;
            rates.extend(samples.into_iter().map(|(_, angular_rate)| angular_rate.0));
        }
        let n = rates.len() as f64;
        for axis in 0..3 {
            let dps: Vec<f64> =
                rates.iter().map(|rate| f64::from(rate[axis]) * DPS_PER_LSB).collect();
            let mean = dps.iter().sum::<f64>() / n;
            let g_sensitivity = terms.g_sensitivity[axis][2] * STANDARD_GRAVITY_MPS2;
            let expected = (terms.bias_rad_s[axis] + g_sensitivity).to_degrees();
            assert!((mean - expected).abs() < 3e-3, "{mean}");
            let sd = (dps.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / n).sqrt();
            let density = truth.noise_radps_per_rthz.to_degrees();
            let noise = density * (1e9 / 4_800_000.0 / 2.0_f64).sqrt();
            let expected = noise.hypot(DPS_PER_LSB / 12_f64.sqrt());
            assert!((sd / expected - 1.0).abs() < 0.05, "{sd}, expected {expected}");
        }
        Ok(())
    });
}
