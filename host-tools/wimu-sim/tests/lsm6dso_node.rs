//! The node's LSM6DSO on the simulated sensor, on I²C and on SPI, in virtual time.

use std::rc::Rc;

use embedded_hal_async::digital::Wait;
use wimu_link::message::{Resolution, Settings};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_node::sensor::{Batch, Plan, SensorFault};
use wimu_node::wimu_lsm6dso::{Address, Bus, I2cBus, SpiBus};
use wimu_node::{DataReady, InertialSensor, Lsm6dso, Timer};
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::SimI2c;
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::{DataReadyPin, Sensor};
use wimu_sim::source::{Conversion, Physics, Source};
use wimu_sim::spi::SimSpi;
use wimu_sim::truth::SensorTruth;

#[derive(Clone)]
struct Clock(VirtualClock);

impl Timer for Clock {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(self.0.now())
    }

    async fn until(&self, moment: DeviceTimeUs) {
        self.0.until(moment.0).await;
    }
}

/// INT1 with the time of its edge.
struct Line(DataReadyPin);

impl DataReady for Line {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        let _ = self.0.wait_for_high().await;
        Some(DeviceTimeUs(self.0.rose_us()))
    }
}

/// Samples of both sensors that tell their number.
#[derive(Debug)]
struct Numbered;

impl Source for Numbered {
    fn acceleration(&mut self, conversion: &Conversion) -> Option<Counts> {
        let k = conversion.index as i16;
        Some(Counts([k, -k, 0]))
    }

    fn angular_rate(&mut self, index: u64, _: f64, _: f64, _: f64) -> Counts {
        Counts([index as i16, 0, 0])
    }

    fn magnetic_field_nt(&mut self, _: u64, _: f64) -> [f64; 3] {
        [0.0; 3]
    }

    fn temperature_c(&mut self, _: f64) -> f64 {
        25.0
    }
}

/// A chip, and what a test holds beside the driver.
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

    fn driver<B: Bus>(&self, bus: B) -> Lsm6dso<B, Line, Clock> {
        let line = Line(self.sensor.data_ready());
        Lsm6dso::new(bus, line, Clock(self.clock.clone()))
    }

    fn on_i2c(&self) -> Lsm6dso<I2cBus<SimI2c>, Line, Clock> {
        let i2c = SimI2c::new(&self.clock, [Rc::new(self.sensor.clone()) as Rc<_>]);
        let address = Address::Low;
        self.driver(I2cBus { i2c, address })
    }

    fn on_spi(&self) -> Lsm6dso<SpiBus<SimSpi>, Line, Clock> {
        let spi = SimSpi::new(&self.clock, Rc::new(self.sensor.clone()), 10_000_000);
        self.driver(SpiBus(spi))
    }

    fn run<R>(&self, future: impl Future<Output = R>) -> R {
        self.clock.run(future).expect("nothing stalls")
    }
}

fn plan(driver: &impl InertialSensor, range_g: u8, rate_hz: u16) -> Plan {
    use wimu_node::sensor::Planner;
    let settings = Settings { range_g, rate_hz, ..Settings::default() };
    driver.planner().plan(&settings).expect("supported")
}

type Read = (Batch, Vec<(Counts, Counts)>);

async fn next<B: Bus>(driver: &mut Lsm6dso<B, Line, Clock>) -> Result<Read, SensorFault> {
    let mut samples = [Default::default(); 32];
    let batch = driver.next(&mut samples).await?;
    Ok((batch, samples[..batch.count].to_vec()))
}

#[test]
fn every_pair_comes_once_with_its_time_on_either_bus() {
    async fn read<B: Bus>(bench: &Bench, mut driver: Lsm6dso<B, Line, Clock>) {
        let plan = plan(&driver, 4, 833);
        driver.configure(&plan).await.expect("it works");
        let mut last: Option<(i16, u64)> = None;
        for round in 0..40 {
            // Late now and then, by 50 samples: several reads fetch them.
            let late_us = if round % 8 == 7 { 60_000 } else { 0 };
            bench.clock.until(bench.clock.now() + late_us).await;
            let (batch, read) = next(&mut driver).await.expect("it works");
            assert!(batch.queued && !batch.overrun);
            let first = read[0].0.0[0];
            let newest = read[batch.count - 1].0.0[0];
            for (force, rate) in &read {
                let [x, y, _] = force.0;
                assert_eq!(y, -x, "torn");
                // The gyroscope's number differs by its samples before the start: constantly.
                assert_eq!(rate.0[0] - x, read[0].1.0[0] - first, "not of one instant");
            }
            assert_eq!(newest - first + 1, batch.count as i16);
            if let Some((number, time)) = last {
                assert_eq!(first, number + 1);
                let elapsed_us = 1200.0 * f64::from(newest - number);
                let found_us = (batch.last_time.0 - time) as f64;
                // The time of the edge is exact; without it, within a period.
                assert!((found_us - elapsed_us).abs() <= 1300.0, "{found_us} µs for {elapsed_us}");
            }
            last = Some((newest, batch.last_time.0));
        }
    }
    let bench = Bench::new(Numbered);
    bench.run(read(&bench, bench.on_i2c()));
    let bench = Bench::new(Numbered);
    bench.run(read(&bench, bench.on_spi()));
}

#[test]
fn pairs_that_the_fifo_dropped_are_reported() {
    let bench = Bench::new(Numbered);
    let mut driver = bench.on_i2c();
    let plan = plan(&driver, 2, 1666);
    bench.run(async {
        driver.configure(&plan).await.expect("it works");
        // 256 pairs are 154 ms.
        bench.clock.until(bench.clock.now() + 400_000).await;
        let (batch, _) = next(&mut driver).await.expect("it works");
        assert!(batch.overrun);
        let (batch, _) = next(&mut driver).await.expect("it works");
        assert!(!batch.overrun);
    });
}

#[test]
fn it_measures_temperature_and_no_field() {
    let physics = Physics::new(SensorTruth::ideal(), Scene::new(World::default()), 1);
    let bench = Bench::new(physics);
    let mut driver = bench.on_i2c();
    let plan = plan(&driver, 2, 104);
    let read = bench.run(async {
        driver.configure(&plan).await?;
        driver.surroundings().await
    });
    let read = read.expect("it works");
    assert_eq!(read.magnetic_field, None);
    let celsius = read.temperature.expect("it has a thermometer").to_celsius();
    let truth = Scene::new(World::default()).state(0.0).temperature_c;
    assert!((celsius - truth).abs() < 0.02, "{celsius} °C, not {truth}");
}

#[test]
fn other_settings_get_the_nearest() {
    type Driver = Lsm6dso<(), (), ()>;
    let settings = |range_g, rate_hz, resolution| Settings {
        range_g,
        rate_hz,
        resolution,
        ..Settings::default()
    };
    for (wanted, nearest) in [
        (settings(3, 100, Resolution::High), settings(2, 104, Resolution::High)),
        (settings(200, 6000, Resolution::High), settings(16, 1666, Resolution::High)),
        (settings(2, 833, Resolution::LowPower), settings(2, 208, Resolution::LowPower)),
        (settings(2, 1, Resolution::Normal), settings(2, 13, Resolution::Normal)),
    ] {
        assert_eq!(Driver::plan(&wanted), Err(nearest));
        assert!(Driver::plan(&nearest).is_ok());
    }
}
