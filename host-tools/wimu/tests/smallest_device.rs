//! A device that sends and receives nothing, made of `wimu_link::stream` alone, is read by the commands.

use crate::kit;

use std::io::Write;
use std::net::TcpListener;
use std::thread;
use std::time::{Duration, Instant};

use kit::{Background, in_folder, wimu};
use wimu_link::hello::Part;
use wimu_link::stream::{RawStream, Sensor};
use wimu_link::{Hello, LinkRole};
use wimu_model::{Counts, DeviceTimeUs, PeriodNs, Sensitivity};

/// A device at rest, 200 samples a second, that loses 7 of them after the first second; for one host.
fn device() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let link = format!("tcp://{}", listener.local_addr().expect("an address"));
    thread::spawn(move || {
        let (mut host, _) = listener.accept().expect("a host");
        let hello = Hello {
            device_id: 7,
            board: Part::new(0, "breadboard"),
            sensor: Part::new(0, "MPU-6050"),
            ..Hello::new(LinkRole::Cable)
        };
        let sensor = Sensor {
            period: PeriodNs(5_000_000),
            range_g: 2,
            sensitivity: Sensitivity::from_lsb_per_g(16384.0).expect("in range"),
            full_scale: i16::MAX.into(),
            gyroscope: None,
        };
        let mut stream = RawStream::new(hello, sensor);
        let start = Instant::now();
        for k in 0_u64.. {
            if k == 200 {
                stream.gap(7);
            }
            let time = DeviceTimeUs(5_000 * (k + if k < 200 { 0 } else { 7 }));
            let counts = Counts([k as i16 % 9, -3, 16384]);
            if stream.sample(time, counts, |frame| host.write_all(frame)).is_err() {
                return;
            }
            thread::sleep(Duration::from_micros(time.0).saturating_sub(start.elapsed()));
        }
    });
    link
}

#[test]
fn the_smallest_device_is_monitored_and_recorded_with_every_sample() {
    Background::start(&["monitor", &device()]).prints("breadboard", 1);
    let (file, _folder) = in_folder("small.mcap");
    let recorded = wimu(&["record", &device(), "-o", &file, "--for", "3"]).succeeds();
    let raw = &recorded["links"][0]["raw"];
    assert_eq!(raw["missing"], 7, "{recorded}");
    assert!(raw["received"].as_u64() > Some(400), "{recorded}");
    let info = wimu(&["info", &file]).succeeds();
    assert_eq!(info["links"][0]["raw_samples"], raw["received"], "{info}");
    assert_eq!(info["links"][0]["starts"], 1, "{info}");
}
