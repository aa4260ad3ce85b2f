//! What tests share.

use std::path::Path;

use wimu_host::array::{Array, ArrayUnit};
use wimu_host::formats::{ReadOptions, load};
use wimu_host::imu::{Imu, ImuOptions};
use wimu_host::series::{Flags, Ns};
pub use wimu_testkit::Random;

/// The samples of a file of one unit.
pub fn read(file: &Path) -> wimu_host::Result<Imu> {
    Imu::of(&load(file, &ReadOptions::default())?, &ImuOptions::default())
}

/// Adds a sample of each sensor, m/s², to an array.
pub fn push(array: &mut Array, time_s: f64, outputs: impl IntoIterator<Item = [f64; 3]>) {
    for (sensor, output) in outputs.into_iter().enumerate() {
        if array.units.len() == sensor {
            array.units.push(ArrayUnit::default());
        }
        array.units[sensor].force.push(Ns::from_s(time_s), output.into(), Flags::NONE);
    }
}

/// Adds where the body of an array truly was: position, m, quaternion, and angular rate, rad/s.
pub fn push_truth(array: &mut Array, time_s: f64, truth: ([f64; 3], [f64; 4], [f64; 3])) {
    let (time, of) = (Ns::from_s(time_s), &mut array.reference);
    of.position_m.push(time, truth.0.into(), Flags::NONE);
    of.quaternion.push(time, truth.1.into(), Flags::NONE);
    of.rate_rad_s.push(time, truth.2.into(), Flags::NONE);
}

/// a × b.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub mod frames;
pub mod public;
