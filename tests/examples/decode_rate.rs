//! How many samples a second a host decodes on one core, against the `mavlink` crate, which decodes
//! the same samples from RAW_IMU messages:
//! `cargo run --release -p wimu-tests --features baselines --example decode_rate`.
//!
//! Both read from memory in pieces of 4096 bytes, check every CRC, and hand out every sample with its
//! time; what comes out is summed up and compared. The best of many short rounds counts, in turn, so that
//! whatever else the machine does hits both, or neither.

use std::error::Error;
use std::f64::consts::TAU;
use std::hint::black_box;
use std::io::Read;
use std::time::Instant;

use mavlink::dialects::common::{MavMessage, RAW_IMU_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};
use wimu_host::decode::{Decoder, Event};
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_testkit::{Random, figure};

const SAMPLES: u32 = 100_000;
const BATCH: u32 = 16;
const PERIOD_US: u64 = 1250;
const PIECE: usize = 4096;
const ROUNDS: u32 = 200;

fn main() -> Result<(), Box<dyn Error>> {
    let mut ratios = [f64::INFINITY; 2];
    let mut slowest_rate = f64::INFINITY;
    println!(
        "{:<32} {:>8} {:>14}   {:<19} {:>8} {:>11} {:>6}",
        "signal", "B/sample", "wimu samples/s", "RAW_IMU holds", "B/sample", "RAW_IMU/s", "ratio"
    );
    for (name, sample) in [
        ("16-bit, rest, 24 LSB rms", rest as fn(u32) -> [i16; 3]),
        ("16-bit, hand motion, 12 LSB rms", motion),
    ] {
        let samples: Vec<[i16; 3]> = (0..SAMPLES).map(sample).collect();
        let expected = samples.iter().map(sum_of).sum::<i64>();
        let ours = wimu_bytes(&samples)?;
        for (ratio, (content, theirs)) in ratios.iter_mut().zip([
            ("all nine axes", mavlink_bytes(&samples, true)),
            ("acceleration alone", mavlink_bytes(&samples, false)),
        ]) {
            let (mut best_ours, mut best_theirs) = (f64::INFINITY, f64::INFINITY);
            for _ in 0..ROUNDS {
                best_ours = best_ours.min(timed(expected, || decode_wimu(&ours)));
                best_theirs = best_theirs.min(timed(expected, || decode_mavlink(&theirs)));
            }
            let rate = |seconds: f64| f64::from(SAMPLES) / seconds;
            println!(
                "{name:<32} {:>8.2} {:>12.1} M   {content:<19} {:>8.2} {:>9.1} M {:>6.1}",
                ours.len() as f64 / f64::from(SAMPLES),
                rate(best_ours) * 1e-6,
                theirs.len() as f64 / f64::from(SAMPLES),
                rate(best_theirs) * 1e-6,
                best_theirs / best_ours,
            );
            *ratio = ratio.min(best_theirs / best_ours);
            slowest_rate = slowest_rate.min(rate(best_ours));
        }
    }
    println!("at least {:.0} million samples/s", slowest_rate * 1e-6);
    for (name, ratio) in ["nine axes", "acceleration alone"].into_iter().zip(ratios) {
        let claim = format!("samples decoded a second over mavlink's RAW_IMU, {name}");
        figure(&claim, format!("{ratio:.1}"), "at least 3", ratio >= 3.0);
    }
    Ok(())
}

fn sum_of(sample: &[i16; 3]) -> i64 {
    sample.iter().map(|&axis| i64::from(axis)).sum()
}

/// Seconds that `decode` takes; it must find all samples.
fn timed(expected: i64, decode: impl FnOnce() -> (u32, i64)) -> f64 {
    let start = Instant::now();
    let found = decode();
    let seconds = start.elapsed().as_secs_f64();
    assert_eq!(found, (SAMPLES, expected));
    seconds
}

fn decode_wimu(bytes: &[u8]) -> (u32, i64) {
    let mut decoder = Decoder::new();
    let (mut count, mut sum, mut latest) = (0, 0, 0);
    for piece in bytes.chunks(PIECE) {
        decoder.push(0, piece, |arrival| {
            if let Event::Samples(samples) = arrival.event {
                for sample in samples.iter() {
                    count += 1;
                    latest = sample.time.0;
                    sum += sample.value.iter().map(|&axis| i64::from(axis)).sum::<i64>();
                }
            }
        });
    }
    black_box(latest);
    (count, sum)
}

fn decode_mavlink(bytes: &[u8]) -> (u32, i64) {
    let mut reader = mavlink::MavlinkReader::new(Pieces(bytes));
    let (mut count, mut sum, mut latest) = (0, 0, 0);
    while let Ok((_, message)) = reader.read_message::<MavMessage>(MavlinkVersion::V2) {
        if let MavMessage::RAW_IMU(imu) = message {
            count += 1;
            latest = imu.time_usec;
            sum += sum_of(&[imu.xacc, imu.yacc, imu.zacc]);
        }
    }
    black_box(latest);
    (count, sum)
}

/// Reads at most 4096 bytes at once, as from a serial port.
struct Pieces<'a>(&'a [u8]);

impl Read for Pieces<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let most = buffer.len().min(PIECE);
        self.0.read(&mut buffer[..most])
    }
}

/// Batches, and an epoch every second.
fn wimu_bytes(samples: &[[i16; 3]]) -> Result<Vec<u8>, Box<dyn Error>> {
    let mut bytes = Vec::new();
    let mut frame = [0; MAX_FRAME];
    for (chunk, first) in samples.chunks(BATCH as usize).zip((0_u32..).step_by(BATCH as usize)) {
        let time_us = 1_000_000 + u64::from(first) * PERIOD_US;
        if first.is_multiple_of(50 * BATCH) {
            let epoch = <Telemetry>::Epoch(Epoch {
                reason: EpochReason::Periodic,
                number: (first / (50 * BATCH)) as u8,
                sequence: first,
                time_us,
                period_ns: PERIOD_US as u32 * 1000,
                range_g: 2,
                sensitivity_lsb_per_g: 16_384.0,
                full_scale: 32_752,
                parameters: 0,
                temperature_centi_c: Some(2500),
                ..Epoch::default()
            });
            let length = epoch.encode(&mut frame)?;
            bytes.extend_from_slice(&frame[..length]);
        }
        let counts: Vec<Counts> = chunk.iter().copied().map(Counts).collect();
        let length = batch::encode(first, DeviceTimeUs(time_us), &counts, &mut frame)?;
        bytes.extend_from_slice(&frame[..length]);
    }
    Ok(bytes)
}

/// One RAW_IMU message a sample, MAVLink 2: with gyroscope and magnetometer, as its senders fill it,
/// or with zeros there, which at the end of a message are not sent.
fn mavlink_bytes(samples: &[[i16; 3]], all_axes: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (index, [xacc, yacc, zacc]) in samples.iter().copied().enumerate() {
        let header = MavHeader { sequence: index as u8, ..MavHeader::default() };
        let other = |value: i16| {
            if all_axes { value + index as i16 % 7 } else { 0 }
        };
        let message = MavMessage::RAW_IMU(RAW_IMU_DATA {
            time_usec: 1_000_000 + index as u64 * PERIOD_US,
            xacc,
            yacc,
            zacc,
            xgyro: other(100),
            ygyro: other(-200),
            zgyro: other(300),
            xmag: other(-210),
            ymag: other(35),
            zmag: other(420),
        });
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, &message);
        assert_eq!(raw.message_id(), message.message_id());
        bytes.extend_from_slice(raw.raw_bytes());
    }
    bytes
}

/// Noise of a standard deviation of 1, the same in every run.
fn noise(number: u32, axis: usize) -> f64 {
    Random::new(u64::from(number) * 3 + axis as u64).normal()
}

fn rest(number: u32) -> [i16; 3] {
    [(0, 120.0), (1, -340.0), (2, 16_384.0)]
        .map(|(axis, mean)| (mean + 24.0 * noise(number, axis)).round() as i16)
}

fn motion(number: u32) -> [i16; 3] {
    let t = f64::from(number) * PERIOD_US as f64 * 1e-6;
    [(0, 0.7, 9000.0), (1, 1.1, 7000.0), (2, 1.7, 12_000.0)].map(|(axis, hz, lsb)| {
        (lsb * (TAU * hz * t).sin() + 12.0 * noise(number, axis)).round() as i16
    })
}
