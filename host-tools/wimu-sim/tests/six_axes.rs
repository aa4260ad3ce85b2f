//! The simulated MPU-6050 and LSM6DS3TR-C through their drivers. Boards with them are in `tests/`.

use wimu_link::message::Resolution::High;
use wimu_model::Counts;
use wimu_node::InertialSensor as _;
use wimu_node::sensor::SensorFault;
use wimu_sensors::{Lsm6ds3trC, Mpu6050};
use wimu_sim::clock::VirtualClock;
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::Physics;
use wimu_sim::truth::SensorTruth;

use crate::fifo_bench::{bus, driver, next, start};

/// A sensor without errors that lies still, z up.
fn source() -> Physics {
    let scene = Scene::new(World::default());
    scene.play(0.0, motion::named("rest", 1).expect("a motion"));
    Physics::new(SensorTruth::ideal(), scene, 1)
}

/// Of both register layouts; a full FIFO, which is reported and emptied, is 83 and 42 samples.
#[test]
fn every_member_of_the_mpu_family_measures_gravity_also_after_an_overrun() {
    for who_am_i in [0x68, 0x70, 0x71, 0x98] {
        let clock = VirtualClock::new();
        let sensor = Sensor::mpu6050(&clock, who_am_i, source());
        let mut driver = driver(&clock, &sensor, Mpu6050::new(bus(&clock, &sensor, 0x68)));
        let done = clock.run(async {
            start(&mut driver, 200, 4, High).await?;
            let mut overruns = Vec::new();
            for wait_us in [0, 0, 1_000_000, 0] {
                clock.until(clock.now() + wait_us).await;
                let (batch, samples) = next(&mut driver).await?;
                assert!((8..=9).contains(&batch.count), "{batch:?}");
                overruns.push(batch.overrun);
                for sample in samples {
                    assert_eq!(sample, (Counts([0, 0, 8192]), Counts([0; 3])));
                }
            }
            assert_eq!(overruns, [false, false, true, false]);
            let temperature = driver.surroundings().await?.temperature.map(|t| t.0);
            assert!(matches!(temperature, Some(2_490..=2_510)), "{temperature:?}");
            Ok::<_, SensorFault>(())
        });
        done.expect("time goes on").expect("the bus works");
    }
}

#[test]
fn another_chip_is_refused_by_its_number() {
    let clock = VirtualClock::new();
    let sensor = Sensor::mpu6050(&clock, 0xEA, source());
    let mut driver = driver(&clock, &sensor, Mpu6050::new(bus(&clock, &sensor, 0x68)));
    let found = clock.run(start(&mut driver, 200, 4, High)).expect("time goes on");
    assert_eq!(found, Err(SensorFault::WrongIdentity { expected: 0x68, found: 0xEA }));
}

#[test]
fn the_lsm6ds3tr_c_is_aligned_again_after_an_overrun() {
    let clock = VirtualClock::new();
    let sensor = Sensor::lsm6ds3tr_c(&clock, 0x6A, source());
    let mut driver = driver(&clock, &sensor, Lsm6ds3trC::new(bus(&clock, &sensor, 0x6A)));
    let done = clock.run(async {
        start(&mut driver, 833, 2, High).await?;
        let mut gaps = Vec::new();
        // 341 samples fill the FIFO in 0.41 s. A read of 16 takes 4.4 ms on the bus, in which 4 come.
        for wait_us in [0, 1_000_000].into_iter().chain([0; 60]) {
            clock.until(clock.now() + wait_us).await;
            let (batch, samples) = next(&mut driver).await?;
            gaps.push(batch.overrun);
            for (acceleration, angular_rate) in samples {
                let [x, y, z] = acceleration.0;
                assert!(x.abs() <= 1 && y.abs() <= 1 && (z - 16_383).abs() < 20, "{x} {y} {z}");
                assert_eq!(angular_rate, Counts([0; 3]));
            }
        }
        assert!(!gaps[0] && gaps[1] && gaps[50..] == [false; 12], "{gaps:?}");
        Ok::<_, SensorFault>(())
    });
    done.expect("time goes on").expect("the bus works");
}
