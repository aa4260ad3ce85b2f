//! The simulated MPU-6050 and LSM6DS3TR-C through their drivers. Boards with them are in `tests/`.

use std::rc::Rc;

use wimu_lsm6dso::{AngularRateRange as Rates, Lsm6dso, Model as Lsm, Power, Rate};
use wimu_mpu6050::{AccelerationRange, Address, AngularRateRange, Error, I2cBus, Model, Mpu6050};
use wimu_mpu6050::{Sample, Setup};
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{SimI2c, Target};
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::Sensor;
use wimu_sim::source::Physics;
use wimu_sim::truth::SensorTruth;

struct Delay(VirtualClock);

impl embedded_hal_async::delay::DelayNs for Delay {
    async fn delay_ns(&mut self, ns: u32) {
        self.0.until(self.0.now() + u64::from(ns.div_ceil(1000))).await;
    }
}

/// A sensor without errors that lies still, z up.
fn source() -> Physics {
    let scene = Scene::new(World::default());
    scene.play(0.0, motion::named("rest", 1).expect("a motion"));
    Physics::new(SensorTruth::ideal(), scene, 1)
}

fn mpu6050(clock: &VirtualClock, who_am_i: u8) -> Mpu6050<I2cBus<SimI2c>> {
    let sensor = Sensor::mpu6050(clock, who_am_i, source());
    let i2c = SimI2c::new(clock, [Rc::new(sensor) as Rc<dyn Target>]);
    Mpu6050::new(I2cBus { i2c, address: Address::Low })
}

const SETUP: Setup = Setup {
    acceleration: AccelerationRange::G4,
    angular_rate: AngularRateRange::Dps2000,
    divider: 4,
};

#[test]
fn every_member_of_the_mpu_family_is_identified_and_measures_gravity() {
    for (who_am_i, model) in
        [(0x68, Model::Mpu6050), (0x70, Model::Mpu6500), (0x98, Model::Mpu6500)]
    {
        let clock = VirtualClock::new();
        let mut chip = mpu6050(&clock, who_am_i);
        let done = clock.run(async {
            chip.start(&SETUP, &mut Delay(clock.clone())).await?;
            assert_eq!(chip.model(), model);
            clock.until(clock.now() + 100_000).await;
            let level = chip.level().await?;
            // 200 Hz.
            assert!((19..=21).contains(&level.samples) && !level.full, "{level:?}");
            let mut samples = [Sample::default(); 19];
            chip.read(&mut samples).await?;
            for sample in samples {
                assert_eq!(sample.acceleration, [0, 0, 8192]);
                assert_eq!(sample.angular_rate, [0; 3]);
            }
            let centi = chip.temperature().await?;
            assert!((2_490..=2_510).contains(&centi), "{centi}");
            Ok::<_, Error<_>>(())
        });
        done.expect("time goes on").expect("the bus works");
    }
}

#[test]
fn another_chip_is_refused_by_its_number() {
    let clock = VirtualClock::new();
    let mut chip = mpu6050(&clock, 0xEA);
    let found = clock.run(chip.identify()).expect("time goes on");
    assert_eq!(found, Err(Error::WrongIdentity { expected: 0x68, found: 0xEA }));
}

#[test]
fn a_full_fifo_of_the_mpu_is_reported_and_emptied() {
    for who_am_i in [0x68, 0x71] {
        let clock = VirtualClock::new();
        let mut chip = mpu6050(&clock, who_am_i);
        let done = clock.run(async {
            chip.start(&SETUP, &mut Delay(clock.clone())).await?;
            clock.until(clock.now() + 1_000_000).await;
            assert!(chip.level().await?.full);
            assert!(chip.clear_interrupt().await?);
            chip.reset_fifo().await?;
            assert_eq!(chip.level().await?.samples, 0);
            assert!(!chip.clear_interrupt().await?);
            Ok::<_, Error<_>>(())
        });
        done.expect("time goes on").expect("the bus works");
    }
}

#[test]
fn the_lsm6ds3tr_c_is_aligned_again_after_an_overrun() {
    let clock = VirtualClock::new();
    let sensor = Sensor::lsm6ds3tr_c(&clock, 0x6A, source());
    let i2c = SimI2c::new(&clock, [Rc::new(sensor) as Rc<dyn Target>]);
    let address = wimu_lsm6dso::Address::Low;
    let mut chip = Lsm6dso::of_model(wimu_lsm6dso::I2cBus { i2c, address }, Lsm::Lsm6ds3trC);
    let setup = wimu_lsm6dso::Setup {
        acceleration: wimu_lsm6dso::AccelerationRange::G2,
        angular_rate: Rates::Dps2000,
        rate: Rate::Hz833,
        power: Power::High,
        watermark: 16,
    };
    let done = clock.run(async {
        chip.check_identity().await?;
        chip.start(&setup, &mut Delay(clock.clone())).await?;
        let mut gaps = Vec::new();
        // 341 samples fill the FIFO in 0.41 s. A read of 16 takes 4.4 ms on the bus, in which 4 come.
        for wait_us in [20_000, 1_000_000].into_iter().chain([100; 60]) {
            clock.until(clock.now() + wait_us).await;
            let mut samples = [wimu_lsm6dso::Sample::default(); 16];
            let batch = chip.read(&mut samples).await?;
            gaps.push(batch.gap);
            for sample in &samples[..batch.count] {
                let [x, y, z] = sample.acceleration;
                assert!(x.abs() <= 1 && y.abs() <= 1 && (z - 16_383).abs() < 20, "{sample:?}");
                assert_eq!(sample.angular_rate, [0; 3]);
            }
        }
        assert!(!gaps[0] && gaps[1] && gaps[50..] == [false; 12], "{gaps:?}");
        Ok::<_, wimu_lsm6dso::Error<_>>(())
    });
    done.expect("time goes on").expect("the bus works");
}
