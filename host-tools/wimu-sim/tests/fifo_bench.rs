//! A driver on the simulated chip, in virtual time.

use std::rc::Rc;

use wimu_link::message::{Resolution, Settings};
use wimu_model::DeviceTimeUs;
use wimu_node::sensor::{Batch, Plan, Planner as _, SensorFault};
use wimu_node::{DataReady, FifoChip, FifoSensor, InertialSensor};
use wimu_sensors::I2cBus;
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::SimI2c;
use wimu_sim::sensor::Sensor;

/// INT1 of the chip.
pub struct Int1(Sensor);

impl DataReady for Int1 {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        Some(DeviceTimeUs(self.0.ready().await))
    }
}

pub type OnClock<C> = FifoSensor<C, Int1, VirtualClock>;

/// The driver `chip` of `sensor`.
pub fn driver<C: FifoChip>(clock: &VirtualClock, sensor: &Sensor, chip: C) -> OnClock<C> {
    FifoSensor::new(chip, Int1(sensor.clone()), clock.clone())
}

/// A bus with the chip `sensor`, for a driver of one at `address`.
pub fn bus(clock: &VirtualClock, sensor: &Sensor, address: u8) -> I2cBus<SimI2c> {
    I2cBus { i2c: SimI2c::new(clock, [Rc::new(sensor.clone()) as Rc<_>]), address }
}

/// Starts the sensor with the nearest settings.
pub async fn start(
    sensor: &mut impl InertialSensor,
    rate_hz: u16,
    range_g: u8,
    resolution: Resolution,
) -> Result<Plan, SensorFault> {
    let settings = Settings { rate_hz, range_g, resolution, ..Settings::default() };
    let plan = sensor.planner().plan(&settings).expect("the sensor supports it");
    sensor.configure(&plan).await?;
    Ok(plan)
}

/// The next read.
pub async fn next<S: InertialSensor>(
    sensor: &mut S,
) -> Result<(Batch, Vec<S::Sample>), SensorFault> {
    let mut samples = [S::Sample::default(); 32];
    let batch = sensor.next(&mut samples).await?;
    Ok((batch, samples[..batch.count].to_vec()))
}
