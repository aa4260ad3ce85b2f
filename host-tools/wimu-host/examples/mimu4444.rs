//! Captures of the MIMU4444's Bluetooth stream: eight accelerometers and gyroscopes of another
//! maker, whose packets carry a number and a time as wimu's do.
//!
//! After a 4-byte acknowledgement, packets of 106 bytes, high byte first: 0xAA, number u16, length
//! of the payload (100), time u32 in ticks of 64 MHz, 8 × (accelerometer X Y Z, gyroscope X Y Z)
//! i16, and the sum of the 104 bytes before it, u16. Both counters wrap.
//!
//! ```text
//! cargo run --release -p wimu-host --example mimu4444 -- CAPTURE.bin [TABLE.csv]
//! ```
//!
//! Prints what was received and lost, and writes the table, which `wimu calibrate TABLE.csv
//! --accelerometer 0` and `wimu navigate` read.

use std::path::Path;
use std::process::ExitCode;

use wimu_host::csv::{self, CsvWriter};
use wimu_host::{ErrorCode, HostError, OutputFile, Result};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (capture, table) = match arguments.as_slice() {
        [capture] => (capture, None),
        [capture, table] => (capture, Some(table)),
        _ => {
            eprintln!("usage: mimu4444 CAPTURE.bin [TABLE.csv]");
            return ExitCode::from(2);
        }
    };
    let read = Capture::read(Path::new(capture)).and_then(|capture| {
        println!("{:#?}", capture.summary);
        if let Some(table) = table {
            println!("{table}: {} rows", capture.write_csv(Path::new(table))?);
        }
        Ok(())
    });
    match read {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Bytes of a packet, and of it before the sum.
const PACKET: usize = 106;
const SUMMED: usize = PACKET - 2;
const START: u8 = 0xAA;
const PAYLOAD: u8 = 100;
const UNITS: usize = 8;
/// The clock's nominal rate.
const TICKS_PER_S: f64 = 64e6;
/// From one packet to the next, nominally.
const NOMINAL_TICKS: i64 = 1_024_000;
/// The sensors' nominal rate: 1 kHz divided by 16, Hz.
const NOMINAL_RATE_HZ: f64 = 62.5;

/// One packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Packet {
    /// Its number, continued over the wraps.
    number: u64,
    /// Ticks of 64 MHz, continued over the wraps.
    ticks: u64,
    /// Whether nothing tells how long after the one before it came.
    after_restart: bool,
    /// Both as they were sent.
    short_number: u16,
    short_ticks: u32,
    /// Accelerometers, 2048 LSB/g, then gyroscopes, 16.4 LSB/(deg/s), of each unit, all in the axes
    /// of the array: 32768 is a −32768 that is turned over.
    units: [[[i32; 3]; 2]; UNITS],
}

impl Packet {
    /// Seconds of the unit's clock.
    fn time_s(&self) -> f64 {
        self.ticks as f64 / TICKS_PER_S
    }
}

/// A capture.
#[derive(Clone, Debug)]
struct Capture {
    /// The packets, in order.
    packets: Vec<Packet>,
    /// What was lost.
    summary: Summary,
}

/// A capture in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Summary {
    /// Whole packets.
    packets: u64,
    /// Packets whose numbers are missing.
    lost: u64,
    /// Packets that arrived again.
    duplicated: u64,
    /// Packets that arrived after later ones, and were put in their places.
    late: u64,
    /// Times that the unit began its numbers anew, or was silent for more than eight minutes: nothing
    /// tells for how long. Times go on as if the next packet had come at once.
    restarts: u64,
    /// Places that begin as a packet and whose sum is wrong.
    damaged: u64,
    /// Bytes that belong to no packet, the acknowledgement and a packet cut off at the end included.
    other_bytes: u64,
    /// By the unit's clock, s.
    duration_s: f64,
    /// Mean rate by the unit's clock, Hz, over what is between restarts.
    rate_hz: f64,
    /// How much faster than the nominal 62.5 Hz that is, ppm: the difference of the sensors' clock and
    /// the unit's. Against a host's clock nothing can be said: the capture has no times of arrival.
    rate_ppm: f64,
    /// Standard deviation of the time from one packet to the next, µs.
    jitter_us: f64,
}

impl Capture {
    /// Reads a file.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`; `no_rows` when no packet is in it.
    fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|error| HostError::file(&name, "read", &error))?;
        Self::parse(&bytes, &name)
    }

    /// Finds the packets in `bytes`, which errors call `name`.
    ///
    /// # Errors
    /// `no_rows` when there is none.
    fn parse(bytes: &[u8], name: &str) -> Result<Self> {
        let mut summary = Summary::default();
        let mut packets: Vec<Packet> = Vec::new();
        let mut at = 0;
        while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
            let begins = rest[0] == START && rest.get(3) == Some(&PAYLOAD);
            let Some(packet) = rest.first_chunk::<PACKET>().filter(|_| begins) else {
                summary.other_bytes += 1;
                at += 1;
                continue;
            };
            let sum =
                packet[..SUMMED].iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
            if sum != u16::from_be_bytes([packet[SUMMED], packet[SUMMED + 1]]) {
                summary.damaged += 1;
                summary.other_bytes += 1;
                at += 1;
                continue;
            }
            at += PACKET;
            place(decode(packet), &mut packets, &mut summary);
        }
        let [first, .., last] = packets.as_slice() else {
            return Err(HostError::new(
                ErrorCode::NoRows,
                "there are fewer than two packets in it",
                "give a capture of a MIMU4444's Bluetooth stream",
            )
            .at(name));
        };
        summary.packets = packets.len() as u64;
        summary.duration_s = last.time_s() - first.time_s();
        let steps = || {
            let pairs = packets.windows(2).filter(|pair| !pair[1].after_restart);
            pairs.map(|pair| {
                let numbers = (pair[1].number - pair[0].number) as f64;
                (numbers, pair[1].time_s() - pair[0].time_s())
            })
        };
        let (numbers, seconds) = steps().fold((0.0, 0.0), |(n, s), (m, t)| (n + m, s + t));
        summary.lost = numbers as u64 - steps().count() as u64;
        summary.rate_hz = numbers / seconds;
        summary.rate_ppm = (summary.rate_hz / NOMINAL_RATE_HZ - 1.0) * 1e6;
        let squares: f64 = steps()
            .map(|(numbers, seconds)| (seconds / numbers - 1.0 / summary.rate_hz).powi(2))
            .sum();
        summary.jitter_us = (squares / steps().count() as f64).sqrt() * 1e6;
        Ok(Self { packets, summary })
    }

    /// Writes all accelerometers and gyroscopes as a CSV file, LSB, by the unit's clock from the first
    /// packet on; returns the number of rows.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    fn write_csv(&self, path: &Path) -> Result<usize> {
        let (output, file) = OutputFile::create(path)?;
        let sensors = |name: &'static str| {
            (0..UNITS).flat_map(move |unit| csv::axes(&format!("{name} {unit}"), "LSB"))
        };
        let columns: Vec<String> = (std::iter::once(csv::TIME.to_owned()))
            .chain(sensors("Accelerometer"))
            .chain(sensors("Gyroscope"))
            .collect();
        let mut writer = CsvWriter::new(std::io::BufWriter::new(file), output.name(), &columns)?;
        let start = self.packets.first().map_or(0, |packet| packet.ticks);
        for packet in &self.packets {
            // 64 ticks are 1000 ns.
            writer.time(Some(((packet.ticks - start) * 125 / 8) as i64));
            for kind in 0..2 {
                for unit in &packet.units {
                    writer.vector(Some(unit[kind].map(f64::from)));
                }
            }
            writer.end_row()?;
        }
        writer.finish()?;
        output.finish()?;
        Ok(self.packets.len())
    }
}

/// Ticks from one packet to another, of which the short counters tell `apart` and that are about
/// `numbers` packets apart.
fn ticks_apart(apart: u32, numbers: i64) -> i64 {
    let foretold = numbers * NOMINAL_TICKS;
    let wraps = (foretold - i64::from(apart) + (1 << 31)).div_euclid(1 << 32);
    i64::from(apart) + (wraps << 32)
}

/// Puts the next packet in its place among `packets`, or counts it.
fn place(next: Packet, packets: &mut Vec<Packet>, summary: &mut Summary) {
    let Some(last) = packets.last().copied() else {
        packets.push(next);
        return;
    };
    // Back by less than half of what 16 bits count is back; anything else is ahead.
    let ahead = i64::from(next.short_number.wrapping_sub(last.short_number) as i16);
    let passed = ticks_apart(next.short_ticks.wrapping_sub(last.short_ticks), ahead);
    let completed = Packet {
        number: last.number.wrapping_add_signed(ahead),
        ticks: last.ticks.wrapping_add_signed(passed),
        ..next
    };
    if ahead > 0 {
        packets.push(completed);
        return;
    }
    let at = packets.partition_point(|packet| packet.number < completed.number);
    let known = packets.get(at);
    if known.is_some_and(|known| known.units == next.units && known.number == completed.number) {
        summary.duplicated += 1;
        return;
    }
    let is_missing = known.is_some_and(|known| known.number != completed.number);
    let foretold = ahead * NOMINAL_TICKS;
    if is_missing && at > 0 && passed.abs_diff(foretold) < NOMINAL_TICKS as u64 {
        summary.late += 1;
        packets.insert(at, completed);
        return;
    }
    summary.restarts += 1;
    packets.push(Packet {
        number: last.number + 1,
        ticks: last.ticks + NOMINAL_TICKS as u64,
        after_restart: true,
        ..next
    });
}

/// A packet with its short counters alone.
fn decode(packet: &[u8; PACKET]) -> Packet {
    let word = |at: usize| u16::from_be_bytes([packet[at], packet[at + 1]]);
    let short_number = word(1);
    let short_ticks = u32::from_be_bytes([packet[4], packet[5], packet[6], packet[7]]);
    let mut units = [[[0; 3]; 2]; UNITS];
    for (index, value) in units.iter_mut().flatten().flatten().enumerate() {
        *value = i32::from(word(8 + 2 * index) as i16);
    }
    // Every second unit is mounted turned over.
    for unit in units.iter_mut().skip(1).step_by(2).flatten() {
        let [x, y, z] = *unit;
        *unit = [-y, -x, -z];
    }
    Packet {
        number: short_number.into(),
        ticks: short_ticks.into(),
        short_number,
        short_ticks,
        after_restart: false,
        units,
    }
}

#[cfg(test)]
mod tests {
    use wimu_testkit::Random;

    use super::*;

    fn packet(number: u16, ticks: u32) -> Vec<u8> {
        let mut bytes = vec![START];
        bytes.extend(number.to_be_bytes());
        bytes.push(PAYLOAD);
        bytes.extend(ticks.to_be_bytes());
        for value in 0..48_i16 {
            bytes.extend((value * 100 - 2000).to_be_bytes());
        }
        let sum = bytes.iter().fold(0_u16, |s, b| s.wrapping_add((*b).into()));
        bytes.extend(sum.to_be_bytes());
        bytes
    }

    #[test]
    fn counters_wrap_and_losses_are_counted() {
        let mut bytes = vec![0xA0, 0x28, 0x00, 0xC8];
        for k in 0..10_u32 {
            if k == 4 {
                continue;
            }
            let ticks = (u32::MAX - 3_000_000).wrapping_add(k * 1_024_000);
            bytes.extend(packet((0xFFFC + k) as u16, ticks));
            if k == 6 {
                // Again, and one with a bit flipped.
                bytes.extend(packet((0xFFFC + k) as u16, ticks));
                let mut damaged = packet(0, 0);
                damaged[50] ^= 4;
                bytes.extend(damaged);
            }
        }
        bytes.extend(&packet(6, 0)[..40]);
        let capture = Capture::parse(&bytes, "a.bin").unwrap();
        let found = capture.summary;
        assert_eq!((found.packets, found.lost, found.duplicated), (9, 1, 1));
        assert_eq!((found.damaged, found.other_bytes), (1, 4 + 106 + 40));
        assert!(found.rate_ppm.abs() < 1e-6 && (found.duration_s - 0.144).abs() < 1e-12);
        assert_eq!(capture.packets[0].units[0][0], [-2000, -1900, -1800]);
        // The second is turned over.
        assert_eq!(capture.packets[0].units[1][0], [1300, 1400, 1200]);
        assert!(Capture::parse(b"nothing of the kind", "b.bin").is_err());
        assert!(Capture::parse(&[], "c.bin").is_err());
    }

    #[test]
    fn a_restart_a_long_gap_and_packets_out_of_order_are_told_apart() {
        // Each with other values: the number twice, and which start it is of.
        let sent = |start: u8, number: u32| {
            let mut bytes = packet(number as u16, number.wrapping_mul(1_024_000));
            bytes[20] = start;
            bytes.truncate(SUMMED);
            let sum = bytes.iter().fold(0_u16, |s, b| s.wrapping_add((*b).into()));
            bytes.extend(sum.to_be_bytes());
            bytes
        };
        let mut order: Vec<(u8, u32)> = (0..200).map(|k| (0, k)).collect();
        // Two change places, one comes again.
        order.swap(50, 51);
        order.insert(120, (0, 90));
        // 72 s are missing, then the unit starts anew.
        order.extend((4700..4800).map(|k| (0, k)));
        order.extend((0..300).map(|k| (1, k)));
        let bytes: Vec<u8> = order.into_iter().flat_map(|(s, k)| sent(s, k)).collect();
        let capture = Capture::parse(&bytes, "a.bin").unwrap();
        let found = capture.summary;
        assert_eq!((found.packets, found.lost), (600, 4500), "{found:?}");
        assert_eq!((found.duplicated, found.late, found.restarts), (1, 1, 1));
        assert!(found.rate_ppm.abs() < 1e-6, "{found:?}");
        assert!(capture.packets.is_sorted_by_key(|packet| packet.ticks));
        let pairs = capture.packets.windows(2);
        let gaps = pairs.filter(|p| p[1].number != p[0].number + 1 || p[1].after_restart);
        assert_eq!(gaps.count(), 2);
        let span = capture.packets[599].time_s() - capture.packets[0].time_s();
        assert!((span - 0.016 * 5099.0).abs() < 1e-9, "{span}");
    }

    #[test]
    fn the_real_capture_has_lost_nothing_and_says_what_its_table_says() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/array/");
        let path = format!("{folder}mimu4444_run1_bluetooth.bin");
        if !Path::new(&path).exists() {
            println!("skipped: {path} is absent");
            return;
        }
        let capture = Capture::read(Path::new(&path)).unwrap();
        let found = capture.summary;
        println!("{found:?}");
        assert_eq!((found.lost, found.duplicated, found.damaged), (0, 0, 0));
        let table = format!("{folder}mimu4444_run1.csv");
        let options = wimu_host::formats::ReadOptions::default();
        let table = wimu_host::formats::load(Path::new(&table), &options).unwrap();
        let tracks = |quantity| table.of(quantity).map(|track| track.vectors());
        let forces = tracks(wimu_host::recording::Quantity::SpecificForce);
        let rates = tracks(wimu_host::recording::Quantity::AngularRate);
        for (which, tracks) in [forces.collect::<Vec<_>>(), rates.collect()].into_iter().enumerate()
        {
            assert_eq!(tracks.len(), capture.packets[0].units.len());
            for (unit, track) in tracks.into_iter().enumerate() {
                let sent = capture.packets.iter().map(|packet| packet.units[unit][which]);
                let sent = sent.map(|counts| counts.map(f64::from));
                assert!(track.map(|(_, counts)| counts).eq(sent));
            }
        }
    }

    /// Ten seconds as the unit sends them.
    fn whole() -> Vec<u8> {
        let acknowledgement = [0xA0, 0x31, 0x00, 0xD1];
        let packets = (0..625_u16).flat_map(|k| packet(k, u32::from(k) * 1_024_000));
        acknowledgement.into_iter().chain(packets).collect()
    }

    #[test]
    fn a_capture_that_is_cut_off_gives_its_whole_packets() {
        let bytes = whole();
        for (length, packets) in
            [(bytes.len(), 625), (bytes.len() - 1, 624), (4 + 3 * PACKET + 50, 3)]
        {
            let found = Capture::parse(&bytes[..length], "cut").unwrap().summary;
            assert_eq!((found.packets, found.lost), (packets, 0));
        }
        for length in [0, 3, 50] {
            let error = Capture::parse(&bytes[..length], "cut").unwrap_err();
            assert_eq!(error.code(), ErrorCode::NoRows);
        }
    }

    #[test]
    fn flipped_bytes_cost_the_packets_that_they_are_in_and_are_counted() {
        let bytes = whole();
        let mut random = Random::new(1);
        let mut draw = |below: usize| random.below(below);
        for _ in 0..200 {
            let mut damaged = bytes.clone();
            let hits: Vec<usize> =
                (0..1 + draw(5)).map(|_| 4 + PACKET + draw(623 * PACKET)).collect();
            for hit in &hits {
                damaged[*hit] ^= 1 << draw(8);
            }
            let found = Capture::parse(&damaged, "damaged").unwrap().summary;
            let mut hit: Vec<usize> = hits.iter().map(|at| (at - 4) / PACKET).collect();
            hit.sort_unstable();
            hit.dedup();
            // A byte flipped twice may be whole again.
            assert!(found.packets >= 625 - hit.len() as u64, "{found:?}");
            assert_eq!(found.packets + found.lost, 625, "{found:?}");
        }
        let mut damaged = bytes;
        damaged[4 + 10 * PACKET + 40] ^= 0x10;
        let found = Capture::parse(&damaged, "flipped").unwrap().summary;
        assert_eq!((found.packets, found.lost), (624, 1));
        assert!(found.damaged >= 1, "{found:?}");
    }
}
