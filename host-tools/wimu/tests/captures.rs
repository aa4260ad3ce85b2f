//! Captures of the MIMU4444's stream that are damaged: what is whole is read, the rest is counted, and a
//! file without a packet is refused.

use crate::kit;

use std::fs;
use std::path::Path;

use kit::{folder, wimu};
use wimu_host::mimu4444::Capture;

const PACKET: usize = 106;
const UNITS: usize = 8;

/// So many packets behind an acknowledgement, as the unit sends them.
fn capture(packets: u16) -> Vec<u8> {
    let mut bytes = vec![0xA0, 0x31, 0x00, 0xD1];
    for number in 0..packets {
        let start = bytes.len();
        bytes.push(0xAA);
        bytes.extend(number.to_be_bytes());
        bytes.push(100);
        bytes.extend((u32::from(number) * 1_024_000).to_be_bytes());
        for value in 0..6 * UNITS as i16 {
            bytes.extend((value * 300 - number as i16).to_be_bytes());
        }
        let sum = bytes[start..]
            .iter()
            .fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        bytes.extend(sum.to_be_bytes());
    }
    bytes
}

/// The real capture, or where that is absent a made one.
fn whole() -> Vec<u8> {
    let real = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/array/mimu4444_run1_bluetooth.bin");
    match fs::read(&real) {
        // Ten seconds are enough.
        Ok(bytes) => bytes[..4 + 625 * PACKET].to_vec(),
        Err(_) => {
            println!("{} is absent: a made capture serves", real.display());
            capture(625)
        }
    }
}

fn info(path: &Path) -> kit::Ran {
    wimu(&["info", path.to_str().unwrap(), "--format", "mimu4444"])
}

#[test]
fn a_capture_that_is_cut_off_gives_its_whole_packets() {
    let folder = folder();
    let path = folder.path().join("cut.bin");
    let bytes = whole();
    for (length, packets) in [
        (bytes.len(), 625),
        (bytes.len() - 1, 624),
        (4 + 3 * PACKET + 50, 3),
    ] {
        fs::write(&path, &bytes[..length]).unwrap();
        let found = info(&path).succeeds();
        assert_eq!(
            (&found["packets"], &found["lost"]),
            (&packets.into(), &0.into())
        );
    }
    for length in [0, 3, 50] {
        fs::write(&path, &bytes[..length]).unwrap();
        info(&path).fails(2, "no_rows");
        let table = folder.path().join("a.csv");
        let [input, output] = [&path, &table].map(|path| path.to_str().unwrap());
        wimu(&["export", input, "--format", "mimu4444", "-o", output]).fails(2, "no_rows");
        assert!(!table.exists());
    }
}

#[test]
fn flipped_bytes_cost_the_packets_that_they_are_in_and_are_counted() {
    let bytes = whole();
    let mut random = 1_u64;
    let mut draw = |below: usize| {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (random >> 33) as usize % below
    };
    for _ in 0..200 {
        let mut damaged = bytes.clone();
        let hits: Vec<usize> = (0..1 + draw(5))
            .map(|_| 4 + PACKET + draw(623 * PACKET))
            .collect();
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
    let folder = folder();
    let path = folder.path().join("flipped.bin");
    let mut damaged = bytes;
    damaged[4 + 10 * PACKET + 40] ^= 0x10;
    fs::write(&path, &damaged).unwrap();
    let found = info(&path).succeeds();
    assert_eq!(
        (&found["packets"], &found["lost"]),
        (&624.into(), &1.into())
    );
    assert_eq!(
        found["damaged"].as_u64().map(|damaged| damaged >= 1),
        Some(true)
    );
}
