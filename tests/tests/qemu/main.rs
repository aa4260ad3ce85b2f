//! The firmware of `firmware/qemu-mps2` on an emulated Cortex-M4F.
//!
//! `cargo xtask test --only qemu` builds it and runs the main job, `cargo xtask release --only heavy` all of these.
//!
//! Most run in lockstep: what they hold does not depend on how fast this computer is.
#![cfg(unix)]

mod comparison;
mod failures;
mod links;
mod storage;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::thread;

use wimu_host::{Code, replay};
use wimu_link::LinkRole;
use wimu_link::message::{EpochReason, Event as DeviceEvent, Settings};
use wimu_model::{Alignment, GyroscopeParameters, ParameterId, ParameterSet, Sensitivity};
use wimu_sim::board::SensorPart;
use wimu_sim::motion;
use wimu_sim::scenario::{Calibration, FirstLight, Host, Outcome};
use wimu_sim::scene::{Scene, Temperature, World};
use wimu_sim::sensor::GyroscopeFault;
use wimu_sim::source::Physics;
use wimu_sim::truth::Gauge;
use wimu_testkit::{Lane, figure};
use wimu_tests::behind_faults::BehindFaults;
use wimu_tests::qemu::{Machine, QemuBoard};

/// A board with an LSM303AGR whose memory and log are in `folder`.
fn machine(folder: &Path) -> Machine {
    machine_with(SensorPart::Lsm303agr, folder)
}

fn machine_with(sensor: SensorPart, folder: &Path) -> Machine {
    let built = "../firmware/qemu-mps2/target/thumbv7em-none-eabihf/release/wimu-qemu-mps2";
    let image = std::env::var_os("WIMU_QEMU_FIRMWARE")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join(built), PathBuf::from);
    Machine {
        memory: Some(memory(folder)),
        log: Some(folder.join("log")),
        ..Machine::new(&image, sensor)
    }
}

fn memory(folder: &Path) -> PathBuf {
    folder.join("memory")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder for temporary files")
}

/// A sensor that is moved as [`motion::named`] says, and where it is.
fn sensor(names: &str, world: World, seed: u64) -> (Physics, Scene) {
    moved(SensorPart::Lsm303agr, names, world, seed)
}

/// The same with another part.
fn moved(part: SensorPart, names: &str, world: World, seed: u64) -> (Physics, Scene) {
    let scene = Scene::new(world);
    scene.play(0.0, motion::named(names, seed).expect("a known motion"));
    let truth = part.random_truth(seed, Gauge::LowerTriangular);
    (Physics::new(truth, scene.clone(), seed), scene)
}

/// What a perfect calibration of the sensor of `seed` finds.
fn parameters(seed: u64) -> ParameterSet {
    parameters_of(SensorPart::Lsm303agr, seed)
}

fn parameters_of(part: SensorPart, seed: u64) -> ParameterSet {
    let lsb_per_g = match part {
        SensorPart::Lsm6dso => 1e6 / 61.0,
        _ => 16384.0,
    };
    let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).expect("the sensor's");
    let truth = part.random_truth(seed, Gauge::LowerTriangular);
    let gyroscope = (part == SensorPart::Lsm6dso).then(|| {
        let rad_s_per_lsb = 0.07_f64.to_radians();
        GyroscopeParameters::new(2000, rad_s_per_lsb, truth.gyroscope.model, None)
            .expect("in range")
    });
    ParameterSet {
        model: truth.model,
        alignment: Alignment::IDENTITY,
        gyroscope,
        ..ParameterSet::uncalibrated(2, sensitivity)
    }
}

fn first_light(sensor: SensorPart, seed: u64, calibration: Calibration) -> Outcome {
    let folder = folder();
    FirstLight { seed, sensor, calibration }
        .run_on(|source| QemuBoard::start(machine_with(sensor, folder.path()), source))
        .unwrap_or_else(|error| panic!("{error}"))
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --only qemu"]
fn first_light_on_a_cortex_m() {
    let mut worst = [0.0_f64; 3];
    for (seed, calibration) in [(1, Calibration::TwelvePoses), (2, Calibration::SixPositions)] {
        let outcome = first_light(SensorPart::Lsm303agr, seed, calibration);
        assert_eq!(outcome.hello.board.name.as_str(), "QEMU mps2-an386");
        let [before, after] = outcome.tilts_rms_mps2();
        assert!(
            before >= 0.4 && after < 0.005 && before / after >= 50.0,
            "{before} → {after} m/s² rms"
        );
        let found = [after, outcome.slide.calibrated_m, outcome.slide.zupt_m];
        worst = [0, 1, 2].map(|k| worst[k].max(found[k]));
        assert_eq!(outcome.tilts.len(), 10);
        assert_ne!(outcome.pushed, ParameterId::UNCALIBRATED);
        assert_eq!(outcome.pushed, outcome.after_restart);
        assert_eq!(outcome.boot_counts, [1, 2]);
        for refusal in &outcome.refusals {
            let code = refusal.as_ref().map(|error| error.code);
            assert_eq!(code, Some(Code::KeyNeeded), "{refusal:?}");
        }
        assert!(outcome.slide.uncalibrated_m > 1.0, "{:?}", outcome.slide);
        assert!(outcome.slide.calibrated_m < 0.1, "{:?}", outcome.slide);
        assert!(outcome.slide.zupt_m < 0.02, "{:?}", outcome.slide);
        assert_eq!(outcome.replays.len(), 4, "two links, two starts");
        for replay in &outcome.replays {
            assert!(replay.is_exact() && replay.breaks == 0, "{replay:?}");
            assert!(replay.corrected_compared > 4000 && replay.navigation_compared > 400);
        }
    }
    let [tilts, slide, zupt] = worst.map(|value| value * 1e3);
    figure(
        "first light on a Cortex-M4F in QEMU: |f| − g of tilts, mm/s² rms",
        format!("{tilts:.2}"),
        "below 5",
        tilts < 5.0,
    );
    figure(
        "first light in QEMU: slide of 1 m, without and with ZUPT, mm",
        format!("{slide:.1} / {zupt:.1}"),
        "below 100 / 20",
        slide < 100.0 && zupt < 20.0,
    );
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn first_light_with_six_axes_on_a_cortex_m() {
    let outcome = first_light(SensorPart::Lsm6dso, 1, Calibration::TwelvePoses);
    assert_eq!(outcome.hello.sensor.name.as_str(), "LSM6DSO");
    assert_eq!(outcome.pushed, outcome.after_restart);
    assert!(outcome.parameters.gyroscope.is_some());
    assert_eq!(outcome.replays.len(), 4, "two links, two starts");
    for replay in &outcome.replays {
        assert!(replay.is_exact() && replay.breaks == 0, "{replay:?}");
        assert!(replay.corrected_compared > 4000 && replay.navigation_compared > 400);
    }
    let [calibrated_mm, zupt_mm] =
        [outcome.slide.calibrated_m, outcome.slide.zupt_m].map(|m| m * 1e3);
    let [_, calibrated_deg, zupt_deg] = outcome.attitude_deg.expect("attitudes");
    figure(
        "six axes in QEMU: 1 m with a rotation by 90°, without and with ZUPT",
        format!("{calibrated_mm:.1} mm {calibrated_deg:.2}° / {zupt_mm:.1} mm {zupt_deg:.2}°"),
        "below 150 mm, 0.3°",
        calibrated_mm < 150.0 && zupt_mm < 150.0 && calibrated_deg < 0.3 && zupt_deg < 0.3,
    );
    assert!(calibrated_mm < 150.0 && zupt_mm < 150.0, "{:?}", outcome.slide);
    assert!(calibrated_deg < 0.3 && zupt_deg < 0.3);
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn the_same_seed_gives_the_same_bytes_however_busy_the_computer_is() {
    let part = SensorPart::Lsm303agr;
    let run = || first_light(part, 3, Calibration::TwelvePoses).recording;
    // Two at once are in each other's way.
    let (one, other) = thread::scope(|scope| {
        let other = scope.spawn(run);
        (run(), other.join().expect("a recording"))
    });
    assert!(!one.is_empty() && one == other);
    assert!(one == run());
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn ten_minutes_replay_bit_for_bit_over_gaps_temperature_parameters_and_settings() {
    long_replay(SensorPart::Lsm303agr, 1.0);
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn six_axes_replay_bit_for_bit_over_gaps_temperature_parameters_and_settings() {
    long_replay(SensorPart::Lsm6dso, Lane::current().choose([0.2, 0.2, 1.0]));
}

/// 620 s times `scale` with faults of all kinds.
fn long_replay(part: SensorPart, scale: f64) {
    let folder = folder();
    let world = World {
        temperature: Temperature::Step { before_c: 20.0, after_c: 31.0, at_s: 150.0 * scale },
        ..World::default()
    };
    let (source, scene) = moved(part, "twelve-poses,hand,slide,tilts,hand,slide", world, 4);
    let board = QemuBoard::start(machine_with(part, folder.path()), source);
    let board = RefCell::new(board.unwrap_or_else(|error| panic!("{error}")));
    let mut host = Host::connect(&board, scene.clone()).expect("a board");
    let at = |host: &mut Host<'_, QemuBoard>, end_s: f64| {
        let end_s = scale * end_s;
        // It moves all the time.
        while scene.end_s() < end_s {
            let again = motion::named("hand,rest,slide,tilts", end_s as u64);
            scene.play(scene.end_s(), again.expect("a known motion"));
        }
        host.run_until(end_s).expect("the board goes on");
    };
    at(&mut host, 60.0);
    host.cable.push_parameters(&parameters_of(part, 4)).expect("pushed");
    let wait = |host: &mut Host<'_, QemuBoard>, seconds: f64| {
        let end_s = host.now_s() + seconds;
        host.run_until(end_s).expect("the board goes on");
    };
    at(&mut host, 100.0);
    board.borrow().sensor().set_present(false);
    wait(&mut host, 1.5);
    board.borrow().sensor().set_present(true);
    // The temperature steps meanwhile.
    at(&mut host, 200.0);
    board.borrow().bus_faults().set_stuck(true);
    wait(&mut host, 0.7);
    board.borrow().bus_faults().set_stuck(false);
    at(&mut host, 250.0);
    // Without effect on a sensor without a gyroscope.
    for fault in [GyroscopeFault::Saturates, GyroscopeFault::Stops] {
        board.borrow().sensor().set_gyroscope_fault(fault);
        wait(&mut host, 1.0);
        board.borrow().sensor().set_gyroscope_fault(GyroscopeFault::None);
        wait(&mut host, 3.0);
    }
    at(&mut host, 300.0);
    let settings = host.cable.settings().expect("settings");
    let rates_hz = match part {
        SensorPart::Lsm6dso => [52, 208, 104],
        _ => [50, 200, 100],
    };
    let times_and_ranges = [(400.0, 2), (500.0, 4), (620.0, 2)];
    for ((end_s, range_g), rate_hz) in times_and_ranges.into_iter().zip(rates_hz) {
        let changed = host.cable.set_settings(Settings { rate_hz, range_g, ..settings });
        assert_eq!(changed.expect("changed").rate_hz, rate_hz);
        at(&mut host, end_s);
    }

    let recording = host.recording().expect("a recording");
    for link in recording.links.values() {
        let [boot] = link.boots.as_slice() else {
            panic!("{} starts", link.boots.len());
        };
        let replay = replay::verify(boot, 0);
        println!("{:?}: {replay:?}", link.role);
        figure(
            &format!(
                "replay of {:.0} s of a Cortex-M4F{}, {}: values that differ",
                620.0 * scale,
                if part == SensorPart::Lsm6dso { " with six axes" } else { "" },
                link.role
            ),
            format!("0 of {}", replay.corrected_compared + replay.navigation_compared),
            "none",
            replay.is_exact(),
        );
        assert!(replay.is_exact(), "{replay:?}");
        let least = [60_000.0, 5_500.0].map(|count| (count * scale * 0.9) as u64);
        assert!(replay.corrected_compared > least[0] && replay.navigation_compared > least[1]);
        let compared = boot.corrected().len() as u64 - replay.corrected_compared;
        assert_eq!(compared, 0, "corrected samples not compared");
        let has = |reason| boot.epochs().iter().any(|mark| mark.epoch.reason == reason);
        for reason in [
            EpochReason::Gap,
            EpochReason::Temperature,
            EpochReason::Parameters,
            EpochReason::Settings,
            EpochReason::Stillness,
        ] {
            assert!(has(reason), "no epoch for {reason:?}");
        }
        let lost = |(_, event): &&(_, DeviceEvent)| matches!(event, DeviceEvent::SensorLost(_));
        assert_eq!(boot.events.iter().filter(lost).count(), 2);
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn firmware_that_is_missing_or_does_not_start_is_named() {
    let folder = folder();
    let source = || sensor("rest", World::default(), 1).0;
    let missing = Machine { image: folder.path().join("nothing"), ..machine(folder.path()) };
    let error = QemuBoard::start(missing, source()).err().expect("no image");
    assert!(error.to_string().contains("cargo xtask firmware"), "{error}");

    let unusable =
        Machine { memory: Some(folder.path().join("no/such/folder")), ..machine(folder.path()) };
    let error = QemuBoard::start(unusable, source()).err().expect("no memory");
    assert!(error.to_string().contains("no/such/folder"), "{error}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_bad_wireless_link_makes_no_wrong_sample_and_leaves_the_cable_perfect() {
    let folder = folder();
    let (source, scene) = sensor("rest,hand,slide", World::default(), 8);
    let board = QemuBoard::start(machine(folder.path()), source);
    let board = board.unwrap_or_else(|error| panic!("{error}"));
    let faults = "noisy,stall=3s@10s".parse().expect("faults");
    let board = RefCell::new(BehindFaults::new(board, &faults, 1));
    let mut host = Host::connect(&board, scene).expect("a board");
    host.run_until(60.0).expect("the board goes on");
    let recording = host.recording().expect("a recording");
    let [cable, wireless] = [LinkRole::Cable, LinkRole::Wireless]
        .map(|role| recording.link(Some(role)).expect("both links"));
    let statistics = cable.statistics;
    assert_eq!(statistics.frames_damaged, 0, "{statistics:?}");
    assert_eq!((statistics.raw.missing, statistics.raw.duplicated), (0, 0), "{statistics:?}");
    let (all, some) = (cable.boots[0].raw(), wireless.boots[0].raw());
    assert_eq!((cable.boots.len(), wireless.boots.len()), (1, 1));
    assert!(all.len() > 5500 && some.len() > 3500, "{}", some.len());
    for sample in some {
        let found = all.binary_search_by_key(&sample.sequence, |known| known.sequence);
        let known = all[found.unwrap_or_else(|_| panic!("{sample:?} is invented"))];
        assert_eq!(sample.value, known.value);
    }
    let counted = wireless.statistics.raw;
    let span = some[some.len() - 1].sequence - some[0].sequence + 1;
    assert_eq!(counted.received + counted.missing, u64::from(span));
    assert!(counted.missing > 300, "{counted:?}");
    assert_eq!(counted.duplicated, 0);
    let board = board.borrow();
    let truth = board.channels().to_host.borrow().counts();
    assert!(truth.bytes_lost > 1000 && truth.frames_damaged > 100, "{truth:?}");
}
