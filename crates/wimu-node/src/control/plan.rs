//! Settings that the device supports.

use wimu_link::batch::MAX_BATCH;
use wimu_link::message::{Refusal, Settings, Streams};

use crate::sensor::{Plan, Planner};

/// The plan for `wanted`.
///
/// # Errors
/// The nearest settings that the device supports.
pub(super) fn for_settings(planner: &impl Planner, wanted: &Settings) -> Result<Plan, Settings> {
    let streams = |streams: Streams| Streams {
        batch: streams.batch.clamp(1, MAX_BATCH as u8),
        every: streams.every.max(1),
        corrected: streams.corrected && cfg!(feature = "correction"),
        navigation: streams.navigation && cfg!(feature = "navigation"),
        ..streams
    };
    let possible = Settings {
        gravity_um_s2: wanted.gravity_um_s2.clamp(9_700_000, 9_900_000),
        cable: streams(wanted.cable),
        wireless: streams(wanted.wireless),
        ..*wanted
    };
    planner.plan(&possible).and_then(
        |plan| {
            if possible == *wanted { Ok(plan) } else { Err(possible) }
        },
    )
}

/// The plan for `wanted`, or a refusal that names the nearest settings.
pub(super) fn or_refusal(planner: &impl Planner, wanted: &Settings) -> Result<Plan, Refusal> {
    for_settings(planner, wanted).map_err(|nearest| Refusal::UnsupportedSettings { nearest })
}

/// The plan for the settings nearest to `wanted`.
pub(super) fn nearest(planner: &impl Planner, wanted: &Settings) -> Option<Plan> {
    for_settings(planner, wanted).or_else(|nearest| for_settings(planner, &nearest)).ok()
}
