//! Frames that a device sends.

use wimu_link::frame::EncodeError;
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};

/// Sample period, µs.
pub const PERIOD_US: u64 = 10_000;

pub fn framed(encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(&mut frame).unwrap();
    frame[..length].to_vec()
}

pub fn telemetry(message: &Telemetry) -> Vec<u8> {
    framed(|frame| message.encode(frame))
}

pub fn hello(role: LinkRole, boot_count: u32, uptime_us: u64) -> Vec<u8> {
    let hello = Hello { boot_count, uptime_us, ..Hello::new(role) };
    framed(|frame| hello.encode(frame))
}

/// A periodic epoch at 100 Hz and ±2 g.
pub fn epoch(sequence: u32, time_us: u64) -> Epoch {
    Epoch {
        reason: EpochReason::Periodic,
        sequence,
        time_us,
        period_ns: PERIOD_US as u32 * 1000,
        range_g: 2,
        sensitivity_lsb_per_g: 16384.0,
        full_scale: 32752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    }
}

pub fn raw(first: u32, time_us: u64, counts: &[Counts]) -> Vec<u8> {
    framed(|frame| batch::encode(first, DeviceTimeUs(time_us), counts, frame))
}
