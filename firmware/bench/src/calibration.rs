//! Cost of a calibration on a processor with a floating-point unit.

use core::hint::black_box;

use cortex_m_semihosting::hprintln;
use wimu_calib::{Gravity, Model, Pose, multi_position};
use wimu_model::{ErrorModel, SpecificForceMps2};

use crate::counter::Counter;

const POSES: usize = 38;
const G: f64 = 9.80665;

/// Poses in all directions of a sensor with errors, with 3 mm/s² rms of noise.
fn poses(truth: &ErrorModel) -> [Pose; POSES] {
    let mut state = 1_u32;
    core::array::from_fn(|k| {
        let z = 1.0 - (2 * k + 1) as f64 / POSES as f64;
        let radius = libm::sqrt(1.0 - z * z);
        let angle = 2.4 * k as f64;
        let up = [radius * libm::cos(angle), radius * libm::sin(angle), z];
        let output = truth.distort(SpecificForceMps2(up.map(|c| c * G)), None).0;
        Pose::from_mean(output.map(|y| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            y + 0.01 * (f64::from(state >> 8) / f64::from(1 << 24) - 0.5)
        }))
    })
}

/// Nine parameters of 38 poses with covariance and leave-one-out.
pub fn measure(counter: &mut Counter) -> Result<(), &'static str> {
    let parameters = crate::parameters().ok_or("the parameters are refused")?;
    let poses = black_box(poses(&parameters.model));
    let gravity = Gravity::new(G, 0.0).map_err(|_| "no gravity")?;
    let mut result = None;
    let cost = counter.count_long(|| {
        result = black_box(multi_position(&poses, gravity, Model::Full9)).ok();
    });
    if result.is_none_or(|estimate| estimate.rms_mps2 >= 0.005) {
        return Err("the residual of the fit is too large");
    }
    hprintln!("fit {}.0 {}", cost, cost);
    Ok(())
}
