//! Settings that the device supports.

use wimu_link::batch::MAX_BATCH;
use wimu_link::message::{Refusal, Settings, Streams};

use crate::accelerometer::{Accelerometer, Plan};

/// The plan for `wanted`.
///
/// # Errors
/// The nearest settings that the device supports.
pub(super) fn for_settings<A: Accelerometer>(wanted: &Settings) -> Result<Plan, Settings> {
    let streams = |streams: Streams| Streams {
        batch: streams.batch.clamp(1, MAX_BATCH as u8),
        every: streams.every.max(1),
        ..streams
    };
    let possible = Settings {
        gravity_um_s2: wanted.gravity_um_s2.clamp(9_700_000, 9_900_000),
        cable: streams(wanted.cable),
        wireless: streams(wanted.wireless),
        ..*wanted
    };
    A::plan(&possible).and_then(|plan| {
        if possible == *wanted {
            Ok(plan)
        } else {
            Err(possible)
        }
    })
}

/// The plan for `wanted`, or a refusal that names the nearest settings.
pub(super) fn or_refusal<A: Accelerometer>(wanted: &Settings) -> Result<Plan, Refusal> {
    for_settings::<A>(wanted).map_err(|nearest| Refusal::UnsupportedSettings { nearest })
}

/// The plan for the settings nearest to `wanted`.
pub(super) fn nearest<A: Accelerometer>(wanted: &Settings) -> Option<Plan> {
    for_settings::<A>(wanted)
        .or_else(|nearest| for_settings::<A>(&nearest))
        .ok()
}
