//! Velocity by another system.

use nalgebra::Vector3;
use wimu_nav::sensor::Velocity;

use super::Kind;
use crate::formats::table::SPEED;

/// Velocity of an antenna. Usual σ: the Doppler shift of GNSS.
pub static VELOCITY: Kind = Kind {
    name: "velocity",
    one: "velocity fix",
    columns: &[&["Velocity E"], &["Velocity N"], &["Velocity U"]],
    unit: SPEED,
    usual_sd: Some(0.2),
    needs: "beside positions a vehicle does not use them: a receiver filters its velocity more than its position",
    update: |aid, to| {
        // A receiver filters its velocity more than its position: 0.1 s later on the drive of a car (docs/reference/validation.md, car).
        if to.with_position && to.navigator.vehicle().is_some() {
            return None;
        }
        let deviation_mps = aid.sd.into();
        let turning_mps = to.navigator.angular_rate().cross(&Vector3::from(aid.lever_arm_m));
        let velocity_mps = aid.value.into();
        to.with(Velocity { velocity_mps, deviation_mps, turning_mps, offset: None })
    },
    ..Kind::DEFAULT
};
