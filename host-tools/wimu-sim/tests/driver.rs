//! The stock `lsm303agr` driver on the simulated sensor, in virtual time.

use std::rc::Rc;

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::i2c::{Error as _, ErrorKind, I2c, NoAcknowledgeSource};
use lsm303agr::interface::I2cInterface;
use lsm303agr::{
    AccelMode, AccelOutputDataRate, AccelScale, Error, Interrupt, MagMode, MagOutputDataRate, mode,
};
use wimu_model::Counts;
use wimu_sim::attitude::Attitude;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{Faults, I2cError, SimI2c};
use wimu_sim::lsm303agr::ACCELEROMETER_ADDRESS;
use wimu_sim::motion::{Poses, Rest};
use wimu_sim::scene::{Scene, Temperature, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::{Physics, Replay, Source};
use wimu_sim::truth::{Gauge, SensorTruth};

type Driver = lsm303agr::Lsm303agr<I2cInterface<SimI2c>, mode::MagOneShot>;

/// The driver's accelerometer set-up blocks while the sensor turns on; the tests wait on the
/// virtual clock instead.
struct NoDelay;

impl embedded_hal::delay::DelayNs for NoDelay {
    fn delay_ns(&mut self, _ns: u32) {}
}

struct Bench {
    clock: VirtualClock,
    sensor: Sensor,
    driver: Driver,
    faults: Faults,
}

fn bus(clock: &VirtualClock, sensor: &Sensor) -> SimI2c {
    SimI2c::new(clock, [Rc::new(sensor.clone()) as Rc<_>])
}

fn bench(source: impl Source + 'static) -> Bench {
    let clock = VirtualClock::new();
    let sensor = Sensor::lsm303agr(&clock, source);
    let bus = bus(&clock, &sensor);
    Bench { faults: bus.faults(), driver: Driver::new_with_i2c(bus), clock, sensor }
}

fn ideal(world: World) -> Physics {
    Physics::new(SensorTruth::ideal(), Scene::new(world), 1)
}

impl Bench {
    fn run<F: Future>(&self, future: F) -> F::Output {
        self.clock.run(future).expect("the simulation goes on")
    }
}

/// Runs what uses the driver, which is part of the bench.
macro_rules! run {
    ($bench:ident, $future:expr) => {{
        let clock = $bench.clock.clone();
        clock.run($future).expect("the simulation goes on")
    }};
}

async fn start(driver: &mut Driver, mode: AccelMode, rate: AccelOutputDataRate) {
    driver.init().await.unwrap();
    driver.set_accel_mode_and_odr(&mut NoDelay, mode, rate).await.unwrap();
    driver.acc_enable_interrupt(Interrupt::DataReady1).await.unwrap();
}

async fn read_counts(driver: &mut Driver) -> [i16; 3] {
    let (x, y, z) = driver.acceleration().await.unwrap().xyz_raw();
    [x as i16, y as i16, z as i16]
}

#[test]
fn both_sensors_identify_themselves() {
    let mut bench = bench(ideal(World::default()));
    let (accelerometer, magnetometer) = run!(bench, async {
        let ids = (
            bench.driver.accelerometer_id().await.unwrap(),
            bench.driver.magnetometer_id().await.unwrap(),
        );
        (ids.0.raw(), ids.1.raw())
    });
    assert_eq!((accelerometer, magnetometer), (0x33, 0x40));
}

#[test]
fn every_mode_and_range_reads_one_g_upward() {
    let modes =
        [(AccelMode::LowPower, 16.0), (AccelMode::Normal, 4.0), (AccelMode::HighResolution, 1.0)];
    let ranges = [
        (AccelScale::G2, 1.0),
        (AccelScale::G4, 2.0),
        (AccelScale::G8, 4.0),
        (AccelScale::G16, 12.0),
    ];
    for (mode, mode_digit) in modes {
        for (range, range_digit) in ranges {
            let mut bench = bench(ideal(World::default()));
            let (counts, unscaled, mg) = run!(bench, async {
                start(&mut bench.driver, mode, AccelOutputDataRate::Hz100).await;
                bench.driver.set_accel_scale(range).await.unwrap();
                bench.sensor.ready().await;
                let read = bench.driver.acceleration().await.unwrap();
                (read.z_raw() as i16, read.z_unscaled(), read.z_mg())
            });
            let digit_g = mode_digit * range_digit / 1024.0;
            let bits = match mode {
                AccelMode::LowPower => 8,
                AccelMode::Normal => 10,
                _ => 12,
            };
            assert_eq!(f64::from(unscaled), f64::round(1.0 / digit_g), "{mode:?} {range:?}");
            assert_eq!(counts, unscaled << (16 - bits));
            // The driver takes a digit for a whole number of mg, at ±16 g for 8 mg instead of 12.
            if range != AccelScale::G16 {
                assert!((f64::from(mg) / 1000.0 - 1.0).abs() < 0.03, "{mg} mg");
            }
        }
    }
}

#[test]
fn every_rate_gives_its_samples_a_second() {
    use AccelOutputDataRate::*;
    let rates = [
        (Hz1, 1.0),
        (Hz10, 10.0),
        (Hz25, 25.0),
        (Hz50, 50.0),
        (Hz100, 100.0),
        (Hz200, 200.0),
        (Hz400, 400.0),
        (Khz1_344, 1344.0),
        (Khz1_620LowPower, 1620.0),
        (Khz5_376LowPower, 5376.0),
    ];
    for (rate, hz) in rates {
        let truth = SensorTruth { period_error_ppm: 2500.0, ..SensorTruth::ideal() };
        let mut bench = bench(Physics::new(truth, Scene::new(World::default()), 1));
        let mode = if hz > 1344.0 { AccelMode::LowPower } else { AccelMode::Normal };
        let taken = run!(bench, async {
            start(&mut bench.driver, mode, rate).await;
            let (before, now) = (bench.sensor.samples_taken(), bench.clock.now());
            bench.clock.until(now + 40_000_000).await;
            bench.sensor.samples_taken() - before
        });
        let expected = 40.0 * hz / 1.0025;
        assert!((taken as f64 - expected).abs() <= 1.0, "{taken} of {expected}");
    }
}

#[test]
fn data_ready_rises_at_each_sample_and_falls_when_it_is_read() {
    let truth = SensorTruth { period_error_ppm: -1000.0, ..SensorTruth::ideal() };
    let mut bench = bench(Physics::new(truth, Scene::new(World::default()), 1));
    let rises = run!(bench, async {
        start(&mut bench.driver, AccelMode::HighResolution, AccelOutputDataRate::Hz100).await;
        let mut rises = Vec::new();
        for _ in 0..1001 {
            bench.sensor.ready().await;
            rises.push(bench.clock.now());
            read_counts(&mut bench.driver).await;
            assert!(!bench.sensor.is_ready());
        }
        rises
    });
    assert_eq!(rises[1000] - rises[0], 9_990_000);
    assert!(rises.windows(2).all(|pair| (9_989..=9_991).contains(&(pair[1] - pair[0]))));
}

#[test]
fn a_sample_not_read_in_time_is_an_overrun_and_lost() {
    let samples = (1..=5).map(|n| Counts([n * 16; 3]));
    let mut bench = bench(Replay::new(samples));
    run!(bench, async {
        start(&mut bench.driver, AccelMode::HighResolution, AccelOutputDataRate::Hz10).await;
        let begin = bench.clock.now();
        bench.clock.until(begin + 150_000).await;
        let status = bench.driver.accel_status().await.unwrap();
        assert!(status.xyz_new_data() && !status.xyz_overrun());
        bench.clock.until(begin + 250_000).await;
        let status = bench.driver.accel_status().await.unwrap();
        assert!(status.xyz_new_data() && status.xyz_overrun() && status.y_overrun());
        assert_eq!(read_counts(&mut bench.driver).await, [32; 3]);
        let status = bench.driver.accel_status().await.unwrap();
        assert!(!status.xyz_new_data() && !status.xyz_overrun() && !status.y_overrun());
    });
}

#[test]
fn a_sub_address_without_bit_7_stays_where_it_is() {
    let bench = bench(ideal(World::default()));
    let mut bus = bus(&bench.clock, &bench.sensor);
    let mut twice = [0; 2];
    bench.run(bus.write_read(ACCELEROMETER_ADDRESS, &[0x0F], &mut twice)).unwrap();
    assert_eq!(twice, [0x33; 2]);
}

#[test]
fn a_burst_of_six_bytes_takes_its_time_at_400_khz() {
    let bench = bench(ideal(World::default()));
    let mut bus = bus(&bench.clock, &bench.sensor);
    bench.run(bus.write_read(ACCELEROMETER_ADDRESS, &[0xA8], &mut [0; 6])).unwrap();
    // Three conditions, two addresses, seven bytes.
    assert_eq!(bench.clock.now(), (3 * 2_500 + 9 * 22_500_u64).div_ceil(1000));
}

#[test]
fn temperature_reads_true_to_a_quarter_degree_and_to_one_at_low_power() {
    for (mode, step) in [(AccelMode::HighResolution, 0.25), (AccelMode::LowPower, 1.0)] {
        let world = World {
            temperature: Temperature::Ramp { from_c: 25.0, to_c: -5.3, start_s: 0.0, end_s: 1.0 },
            ..World::default()
        };
        let mut bench = bench(ideal(world));
        let celsius = run!(bench, async {
            start(&mut bench.driver, mode, AccelOutputDataRate::Hz100).await;
            assert!(!bench.driver.temperature_status().await.unwrap().new_data());
            bench.clock.until(2_005_000).await;
            let status = bench.driver.temperature_status().await.unwrap();
            assert!(status.new_data() && status.overrun());
            let temperature = bench.driver.temperature().await.unwrap();
            let status = bench.driver.temperature_status().await.unwrap();
            assert!(!status.new_data() && !status.overrun());
            f64::from(temperature.degrees_celsius())
        });
        assert_eq!(celsius, (-5.3_f64 / step).round() * step);
    }
}

#[test]
fn the_magnetometer_measures_at_its_rate_in_continuous_mode() {
    let scene = Scene::new(World::default());
    let attitude = Attitude::with_up([1.0, 0.0, 0.0]);
    let seconds = 10.0;
    scene.play(0.0, Rc::new(Rest { attitude, seconds }));
    let truth = SensorTruth::random(3, Gauge::Full);
    let bench = bench(Physics::new(truth, scene, 3));
    let (mut driver, mut delay) = (bench.driver, bench.clock.clone());
    let (mean, count) = bench
        .clock
        .run(async {
            driver.init().await.unwrap();
            driver
                .set_mag_mode_and_odr(&mut delay, MagMode::HighResolution, MagOutputDataRate::Hz50)
                .await
                .unwrap();
            let mut driver = driver.into_mag_continuous().await.ok().unwrap();
            let begin = bench.clock.now();
            let (mut sum, mut count) = ([0.0; 3], 0);
            while bench.clock.now() < begin + 5_000_000 {
                if driver.mag_status().await.unwrap().xyz_new_data() {
                    let field = driver.magnetic_field().await.unwrap();
                    let (x, y, z) = field.xyz_nt();
                    for (sum, value) in sum.iter_mut().zip([x, y, z]) {
                        *sum += f64::from(value);
                    }
                    count += 1;
                }
                delay.delay_ms(1).await;
            }
            (sum.map(|sum| sum / f64::from(count)), count)
        })
        .unwrap();
    assert!((248..=251).contains(&count), "{count}");
    // With x up: the field's vertical part lies along x, its north along y.
    let iron = truth.magnetometer;
    for axis in 0..3 {
        let row = iron.soft_iron[axis];
        let expected = row[0] * -44_000.0 + row[1] * 20_000.0 + iron.hard_iron_nt[axis];
        assert!((mean[axis] - expected).abs() < 100.0, "{mean:?} {expected}");
    }
}

#[test]
fn a_replay_passes_its_counts_bit_for_bit_and_then_falls_silent() {
    let samples: Vec<Counts> = (0..500)
        .map(|i: i32| Counts([(i * 131) as i16, (i * -77 + 5) as i16, i16::MIN + i as i16]))
        .collect();
    for source in [Replay::new(samples.clone()), Replay::new(samples.clone()).waiting_for_reader()]
    {
        let mut bench = bench(source);
        let read = run!(bench, async {
            start(&mut bench.driver, AccelMode::LowPower, AccelOutputDataRate::Hz400).await;
            let mut read = Vec::new();
            while !bench.sensor.finished() {
                bench.sensor.ready().await;
                read.push(Counts(read_counts(&mut bench.driver).await));
            }
            read
        });
        assert_eq!(read, samples);
        assert!(bench.clock.run(bench.sensor.ready()).is_err(), "nothing is left to wait for");
    }
}

#[test]
fn the_same_seed_gives_the_same_samples_and_another_does_not() {
    let record = |seed: u64| {
        let scene = Scene::new(World::default());
        scene.play(0.0, Rc::new(Poses::tilts(seed, 0.2)));
        let truth = SensorTruth::random(seed, Gauge::Full);
        let mut bench = bench(Physics::new(truth, scene, seed));
        run!(bench, async {
            start(&mut bench.driver, AccelMode::HighResolution, AccelOutputDataRate::Hz200).await;
            let mut read = Vec::new();
            for _ in 0..1000 {
                bench.sensor.ready().await;
                read.push((bench.clock.now(), read_counts(&mut bench.driver).await));
            }
            read
        })
    };
    assert_eq!(record(4), record(4));
    assert_ne!(record(4), record(5));
}

#[test]
fn an_absent_sensor_acknowledges_nothing_and_comes_back_without_its_settings() {
    let mut bench = bench(ideal(World::default()));
    run!(bench, async {
        start(&mut bench.driver, AccelMode::Normal, AccelOutputDataRate::Hz100).await;
        bench.sensor.set_present(false);
        let error = bench.driver.accelerometer_id().await.unwrap_err();
        let Error::Comm(error) = error else { panic!("{error:?}") };
        let address = NoAcknowledgeSource::Address;
        assert_eq!(error.kind(), ErrorKind::NoAcknowledge(address));
        assert_eq!(error.to_string(), "no device acknowledges address 0x19");
        bench.sensor.set_present(true);
        let taken = bench.sensor.samples_taken();
        bench.clock.until(bench.clock.now() + 1_000_000).await;
        assert_eq!(bench.sensor.samples_taken(), taken);
        start(&mut bench.driver, AccelMode::Normal, AccelOutputDataRate::Hz100).await;
        bench.sensor.ready().await;
    });
}

#[test]
fn a_waiting_pin_learns_that_the_sensor_was_started_later() {
    let mut bench = bench(ideal(World::default()));
    run!(bench, async {
        join(
            async {
                bench.sensor.ready().await;
            },
            async {
                bench.clock.until(500_000).await;
                start(&mut bench.driver, AccelMode::Normal, AccelOutputDataRate::Hz100).await;
            },
        )
        .await
    });
    assert!((510_000..512_000).contains(&bench.clock.now()));
}

#[test]
fn another_chip_shows_its_own_identity() {
    let mut bench = bench(ideal(World::default()));
    bench.sensor.set_who_am_i(0x44);
    let id = run!(bench, bench.driver.accelerometer_id()).unwrap();
    assert_eq!((id.raw(), id.is_correct()), (0x44, false));
}

#[test]
fn bus_faults_begin_and_end_while_the_bus_runs() {
    let mut bench = bench(ideal(World::default()));
    run!(bench, async {
        bench.driver.init().await.unwrap();
        bench.faults.set_stuck(true);
        let end = bench.clock.until(bench.clock.now() + 1_000_000);
        let held = select(bench.driver.accel_status(), end).await;
        assert!(matches!(held, Either::Second(())), "it waits");
        bench.faults.clear();
        bench.driver.accel_status().await.unwrap();

        bench.faults.refuse_after(2);
        bench.driver.accel_status().await.unwrap();
        bench.driver.mag_status().await.unwrap();
        for _ in 0..2 {
            let refused = bench.driver.accel_status().await;
            let expected = I2cError::NoAcknowledge { address: 0x19 };
            assert!(matches!(refused, Err(Error::Comm(error)) if error == expected));
        }
        bench.faults.clear();
        bench.driver.accel_status().await.unwrap();
    });
}

#[test]
fn an_address_that_nobody_has_is_not_acknowledged() {
    let bench = bench(ideal(World::default()));
    let mut bus = bus(&bench.clock, &bench.sensor);
    for address in (0..128).filter(|address| ![0x19, 0x1E].contains(address)) {
        let read = bench.run(bus.read(address, &mut [0]));
        assert_eq!(read, Err(I2cError::NoAcknowledge { address }));
    }
}
