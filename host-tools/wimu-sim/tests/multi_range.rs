//! Accelerometers of different full scale: bad input, and two of them on a simulated board.

use std::cell::RefCell;
use std::f64::consts::FRAC_PI_2;

use wimu_host::Code;
use wimu_host::calibration::Calibration;
use wimu_host::capture::{Boot, Capture as Session};
use wimu_host::inertial::{Choice, navigate};
use wimu_host::multi_range::{FullScales, Merge};
use wimu_host::navigation;
use wimu_host::recording::Recording;
use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Event, Settings};
use wimu_model::{ParameterSet, Sensitivity};
use wimu_sim::attitude::Attitude;
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::motion::{self, Impact, Motion};
use wimu_sim::multi_range::MultiRange;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};

fn merge(recording: &Recording) -> Merge {
    let merge = Merge::of(recording, &FullScales::default()).expect("a merge");
    merge.expect("two ranges")
}

fn refusal(recording: &Recording) -> String {
    let error = Merge::of(recording, &FullScales::default()).expect_err("refused");
    assert_eq!(error.code, Code::DataRefused);
    error.text.clone()
}

fn evidence(merge: &Merge, code: Code) -> Vec<&str> {
    let of_code = merge.findings.iter().filter(|finding| finding.code == code);
    of_code.map(|finding| finding.text.as_str()).collect()
}

/// Error of the largest |x| in the pulse, relative.
fn peak_error(simulated: &MultiRange, merge: &Merge) -> f64 {
    let [begin_s, end_s] = simulated.pulse_s();
    let truth = simulated.truth();
    let times = (0..1000).map(|k| begin_s + (end_s - begin_s) * f64::from(k) / 1000.0);
    let expected = times.map(|t| truth(t)[0].abs()).fold(0.0, f64::max);
    let track = merge.recording.tracks().first().expect("a track");
    let scale = 2.0 * wimu_model::STANDARD_GRAVITY_MPS2 / 32768.0;
    let found = track.vectors().map(|(_, [x, ..])| (x * scale).abs());
    found.fold(0.0, f64::max) / expected - 1.0
}

#[test]
fn a_usual_pair_has_no_warning_and_one_line_says_what_was_merged() {
    let simulated = MultiRange::new(1, false);
    let merge = merge(&simulated.record());
    let notes = evidence(&merge, Code::Navigation);
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(notes[0].starts_with("accelerometers 0 (±2 g), 1 (±16 g) merged"));
    let warnings =
        merge.findings.iter().filter(|f| f.severity > wimu_host::problem::Severity::Note);
    assert_eq!(warnings.count(), 0, "{:?}", merge.findings);
}

#[test]
fn a_unit_turned_in_its_mount_is_found_and_corrected() {
    for (angle, says) in [(FRAC_PI_2, "rotated by 9"), (0.5, "rotated by 2"), (0.05, "")] {
        let mut simulated = MultiRange::new(2, false);
        simulated.sensors[1].mount = Attitude::from_rotation_vector([0.0, 0.0, angle]);
        let merge = merge(&simulated.record());
        let found = evidence(&merge, Code::Axes);
        assert_eq!(found.len(), usize::from(!says.is_empty()), "{angle}: {found:?}");
        assert!(found.iter().all(|text| text.contains(says)), "{found:?}");
        assert!(peak_error(&simulated, &merge).abs() < 0.02);
    }
}

#[test]
fn a_turned_unit_that_only_rested_is_refused() {
    let mut simulated = MultiRange::new(3, false);
    simulated.waved = false;
    simulated.impact = Impact { speed_mps: 0.0, peak_mps2: 0.0, ..simulated.impact };
    // Mounted alike, it is merged, and its scale factors are known from the datasheet only.
    let alike = merge(&simulated.record());
    assert_eq!(evidence(&alike, Code::NotObserved).len(), 1);
    simulated.sensors[1].mount = Attitude::from_rotation_vector([FRAC_PI_2, 0.0, 0.0]);
    assert!(refusal(&simulated.record()).contains("does not determine the rotation"));
}

#[test]
fn another_clock_and_a_delay_are_found_and_corrected() {
    for (clock_ppm, delay_s) in [(400.0, 0.0), (-400.0, 0.02), (0.0, 0.3)] {
        let mut simulated = MultiRange::new(4, false);
        simulated.sensors[1].clock_ppm = clock_ppm;
        simulated.sensors[1].delay_s = delay_s;
        let merge = merge(&simulated.record());
        let says = evidence(&merge, Code::Clock).join(" ");
        assert_eq!(says.contains("400 ppm") || says.contains("ppm"), clock_ppm != 0.0, "{says}");
        assert!(peak_error(&simulated, &merge).abs() < 0.02);
    }
}

#[test]
fn a_slower_unit_is_merged_with_a_warning() {
    let mut simulated = MultiRange::new(5, false);
    simulated.sensors[1].rate_hz = 100.0;
    let merge = merge(&simulated.record());
    let found = evidence(&merge, Code::Rate);
    assert_eq!(found.len(), 1);
    assert!(found[0].contains("100 Hz") && found[0].contains("40 ms"), "{found:?}");
}

#[test]
fn two_bodies_are_refused() {
    let of = |seed, sensor: usize| {
        let mut simulated = MultiRange::new(seed, false);
        simulated.sensors = vec![simulated.sensors[sensor]];
        simulated.record()
    };
    let mut apart = of(6, 0);
    apart.add_accelerometer(&of(7, 1)).expect("one accelerometer");
    assert!(refusal(&apart).contains("do not measure one motion"), "{}", refusal(&apart));
    let mut together = of(6, 0);
    together.add_accelerometer(&of(6, 1)).expect("one accelerometer");
    merge(&together);
}

#[test]
fn what_exceeds_the_widest_is_no_number_and_is_said() {
    let mut simulated = MultiRange::new(8, false);
    simulated.impact.peak_mps2 = 400.0;
    let merge = merge(&simulated.record());
    assert_eq!(evidence(&merge, Code::Saturated).len(), 1);
    let track = merge.recording.tracks().first().expect("a track");
    let lost = track.mask().iter().filter(|valid| !**valid).count();
    assert!((5..20).contains(&lost), "{lost}");
}

#[test]
fn equal_ranges_are_not_merged_unless_asked_and_wrong_numbers_are_refused() {
    let mut simulated = MultiRange::new(9, false);
    simulated.sensors[1].full_scale_g = 2.0;
    let recording = simulated.record();
    let of = |scales: &[f64]| {
        let scales = FullScales::of(scales)?;
        Merge::of(&recording, &scales)
    };
    assert!(of(&[]).expect("no error").is_none());
    assert!(of(&[2.0, 2.0]).expect("asked").is_some());
    for wrong in [&[2.0][..], &[2.0, 16.0, 200.0], &[2.0, -16.0], &[2.0, f64::NAN], &[1.0; 4]] {
        assert_eq!(of(wrong).expect_err("wrong").code, Code::Usage, "{wrong:?}");
    }
}

/// A board with both, and its host.
fn with_pair(
    seed: u64,
    names: &str,
    then: impl FnOnce(&mut Host<Board>, &RefCell<Board>, f64),
) -> (Session, SensorTruth, Scene) {
    let scene = Scene::new(World::default());
    let truth = SensorTruth::random(seed, Gauge::LowerTriangular);
    let other = SensorTruth::random_adxl345(seed + 1, Gauge::Full);
    let config = BoardConfig { cable: LinkConfig::default(), ..BoardConfig::default() };
    let coarse = Physics::new(other, scene.clone(), seed + 1);
    let board = Board::start_pair(
        config,
        Physics::new(truth, scene.clone(), seed),
        (SensorPart::Adxl345, coarse),
    );
    let board = RefCell::new(board);
    let session = {
        let mut host = Host::connect(&board, scene.clone()).expect("a board");
        let motion = motion::named(names, seed).expect("known motions");
        let duration_s = motion.duration();
        let begin_s = scene.play(host.now_s(), motion);
        then(&mut host, &board, begin_s + duration_s);
        host.recording().expect("a recording")
    };
    (session, truth, scene)
}

fn cable(session: &Session) -> &Boot {
    &session.link(Some(LinkRole::Cable)).expect("the cable").boots[0]
}

#[test]
fn a_pair_streams_both_accelerometers_without_a_gap() {
    for rate_hz in [100, 400] {
        let (session, ..) = with_pair(1, "rest,slide", |host, _, end_s| {
            let settings = host.cable.settings().expect("an answer");
            let settings = Settings { rate_hz, ..settings };
            host.cable.set_settings(settings).expect("a change");
            host.run_until(end_s).expect("a board");
        });
        let boot = cable(&session);
        let second = boot.of(1, Stream::Raw);
        let usual_us = 1_000_000 / u64::from(rate_hz);
        for samples in [boot.raw(), second] {
            let samples = &samples[samples.len() / 4..];
            assert!(samples.len() > 10 * usize::from(rate_hz), "{}", samples.len());
            assert!(samples.windows(2).all(|w| w[1].sequence == w[0].sequence + 1));
            let steps = samples.windows(2).map(|w| w[1].time.0 - w[0].time.0);
            let allowed = 8 * usual_us / 10..12 * usual_us / 10;
            let odd = steps.clone().filter(|us| !allowed.contains(us)).count();
            println!(
                "{rate_hz} Hz: steps {:?} to {:?}, {odd} odd",
                steps.clone().min(),
                steps.max()
            );
            // The data-ready edges of both coincide now and then: most often at 400 Hz, where a read takes long.
            assert!(10 * odd <= samples.len(), "{odd} of {}", samples.len());
        }
        let epoch = boot.epochs_of(1).last().expect("epochs").epoch;
        assert_eq!((epoch.range_g, epoch.sensor), (16, 1));
        assert_eq!(u64::from(epoch.period_ns), usual_us * 1000);
    }
}

#[test]
fn the_first_goes_on_without_the_second_which_comes_back() {
    let (session, ..) = with_pair(2, "rest", |host, board, _| {
        host.run_until(4.0).expect("a board");
        board.borrow().second().expect("a pair").set_present(false);
        host.run_until(9.0).expect("a board");
        board.borrow().second().expect("a pair").set_present(true);
        host.run_until(20.0).expect("a board");
    });
    let boot = cable(&session);
    let lost = boot.events.iter().filter(|(_, event)| matches!(event, Event::SensorLost(_)));
    assert_eq!(lost.count(), 1, "{:?}", boot.events);
    let span = |samples: &[wimu_host::decode::TimedSample], from_s: f64, to_s: f64| {
        let within =
            |s: &&wimu_host::decode::TimedSample| (from_s..to_s).contains(&s.time.to_seconds());
        samples.iter().filter(within).count()
    };
    let second = boot.of(1, Stream::Raw);
    assert!(span(boot.raw(), 5.0, 9.0) > 390);
    assert_eq!(span(second, 5.0, 9.0), 0);
    assert!(span(second, 16.0, 19.0) > 280);
}

#[test]
fn navigation_through_an_impact_needs_the_coarse_one() {
    let (session, truth, scene) = with_pair(3, "twelve-poses,impact", |host, _, end_s| {
        host.run_until(end_s).expect("a board");
    });
    let boot = cable(&session);
    let sensitivity = Sensitivity::from_lsb_per_g(16384.0).expect("in range");
    let set = ParameterSet { model: truth.model, ..ParameterSet::uncalibrated(2, sensitivity) };
    let calibration = Calibration::held(&set);
    let mut alone = boot.clone();
    alone.samples.retain(|(sensor, _), _| *sensor == 0);
    let run = Impact::default();
    let expected_m = run.pose(run.duration()).position_m.iter().map(|p| p * p).sum::<f64>().sqrt();
    assert!(scene.end_s() > 60.0);
    let error_m = |boot: &Boot| {
        let motion = navigation::motion("a board", boot, Some(calibration.sensor()));
        let motion = motion.expect("samples");
        let path = navigate(&motion, &Choice::default()).expect("a path");
        let last = path.moves.iter().max_by(|a, b| a.from_s.total_cmp(&b.from_s));
        let last = last.expect("the run");
        (last.length_m - expected_m).abs()
    };
    let [merged_m, alone_m] = [error_m(boot), error_m(&alone)];
    println!("run of {expected_m:.2} m: {merged_m:.3} m off, ±2 g alone {alone_m:.3} m");
    assert!(merged_m < 0.15 && merged_m < 0.3 * alone_m, "{merged_m} {alone_m}");
}
