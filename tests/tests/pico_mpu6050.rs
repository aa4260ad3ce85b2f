//! The Pico's image for an MPU-6050 on the emulated RP2040: `cargo xtask release --only pico`.

use wimu_link::hello::Capabilities;
use wimu_testkit::figure;
use wimu_tests::{ROLES, assert_replays, gaps, who_are_you};

use crate::pico::run::{CABLE, WIRELESS, happens, run_with, send};

#[test]
#[ignore = "cargo xtask release --only pico"]
fn six_axes_stream_with_the_times_of_their_data_ready_edges() {
    let script = [send(800, CABLE, &who_are_you()), send(900, WIRELESS, &who_are_you())];
    let run = run_with("mpu6050", 9.0, &script);
    assert_eq!(run.report["overruns"], 0);
    let taken = run.taken_us();
    for role in ROLES {
        let link = run.link(role);
        link.assert_perfect();
        let boot = &run.boots(role)[0];
        let hello = boot.hello.expect("it was asked");
        assert_eq!(hello.sensor.name.as_str(), "MPU-6050");
        assert!(
            hello.capabilities.contains(Capabilities::GYROSCOPE.with(Capabilities::DATA_READY))
        );
        assert_eq!(gaps(boot.raw()), []);
        assert!(boot.raw().len() > 700, "{}", boot.raw().len());
        let settled = &boot.raw()[boot.raw().len() - 300..];
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for sample in settled {
            let [_, _, z] = sample.value;
            assert!((7_800..8_300).contains(&(z >> 1)), "1 g at ± 2 g");
            let time = sample.time.0 as f64;
            let nearest = taken.iter().map(|taken| time - taken);
            let late = nearest.min_by(|a, b| a.abs().total_cmp(&b.abs())).expect("a sample");
            (least, most) = (least.min(late), most.max(late));
        }
        figure(
            &format!("Pico with MPU-6050, 100 Hz, {role}: sample times after the sensor's, µs"),
            format!("{least:.1} to {most:.1}"),
            "± 25 of a constant",
            most - least <= 50.0,
        );
        assert!(most - least <= 50.0 && least >= -25.0, "{least} to {most} µs");
        assert_replays(boot);
    }
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_sensor_that_was_unplugged_streams_again() {
    let script = [happens(3_000, "unplug"), happens(4_000, "plug")];
    let run = run_with("mpu6050", 8.0, &script);
    for role in ROLES {
        let boot = &run.boots(role)[0];
        let last = boot.raw().last().expect("samples").time.to_seconds();
        assert!(last > 7.5, "the last at {last} s");
    }
}
