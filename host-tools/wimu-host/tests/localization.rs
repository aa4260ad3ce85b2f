//! Localization with simulated ranges: calibration, ambiguity, and faults of the input.

use std::path::PathBuf;

use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::InertialPath;
use wimu_host::inertial::aids::Aid;
use wimu_host::localization::{
    AnchorPosition, Increment, LocalizationChoice, RangeRecording, Ranged, localize,
};
use wimu_host::series::Ns;
use wimu_host::{Code, Problem, Severity};
use wimu_testkit::{Coverage, Lane, Random, rms_ratio_can_be};

const G: f64 = 9.80665;
/// Anchors of a hall.
const HALL: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.2],
    [9.0, 0.0, 2.5],
    [9.0, 7.0, 0.3],
    [0.0, 7.0, 2.6],
    [4.5, 0.0, 1.4],
    [4.5, 7.0, 1.2],
];

/// Position at a time, m: a loop through the hall.
fn path(t: f64) -> [f64; 3] {
    [4.5 + 3.2 * (0.25 * t).sin(), 3.5 + 2.4 * (0.17 * t).cos(), 1.2 + 0.7 * (0.31 * t).sin()]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// A simulated recording of 60 s at 10 Hz with biases of 0.1 m (1 σ), noise of 3 cm and a correlated error of 6 cm over 1 s.
struct Hall {
    recording: RangeRecording,
    biases_m: Vec<f64>,
}

fn hall(seed: u64, anchors: &[[f64; 3]]) -> Hall {
    let mut random = Random::new(seed);
    let common = 0.07 * random.normal();
    let biases_m: Vec<f64> = anchors.iter().map(|_| common + 0.07 * random.normal()).collect();
    let mut errors: Vec<f64> = anchors.iter().map(|_| 0.06 * random.normal()).collect();
    let decay = (-0.1_f64).exp();
    let mut ranges = Vec::new();
    for k in 0..600 {
        let time_s = f64::from(k) * 0.1;
        for (anchor, place) in anchors.iter().enumerate() {
            errors[anchor] =
                decay * errors[anchor] + 0.06 * (1.0 - decay * decay).sqrt() * random.normal();
            let error = biases_m[anchor] + errors[anchor] + 0.03 * random.normal();
            let range_m = distance(path(time_s), *place) + error;
            ranges.push(Aid::range(time_s, anchor, range_m));
        }
    }
    let named = |(k, position_m): (usize, &[f64; 3])| AnchorPosition {
        id: format!("A{k}"),
        position_m: *position_m,
    };
    let recording = RangeRecording {
        name: "hall".to_owned(),
        anchors: anchors.iter().enumerate().map(named).collect(),
        planar: false,
        ranges,
        increments: Vec::new(),
        motion: None,
        findings: Vec::new(),
    };
    Hall { recording, biases_m }
}

/// What a path shows of its ranges.
fn ranged(found: &InertialPath) -> &Ranged {
    found.ranging.as_ref().unwrap()
}

fn found(recording: &RangeRecording) -> InertialPath {
    localize(recording, &LocalizationChoice::default()).unwrap()
}

/// RMS distance from the true path after 2 s, m.
fn rmse(found: &InertialPath) -> f64 {
    let points = found.points.iter().filter(|p| p.time_s > 2.0);
    let squares: Vec<f64> =
        points.map(|p| distance(p.position_m, path(p.time_s)).powi(2)).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn finding<'a>(found: &'a InertialPath, code: Code, part: &str) -> Option<&'a Problem> {
    let fits = |f: &&Problem| f.code == code && f.text.contains(part);
    found.findings.iter().find(fits)
}

#[test]
fn position_and_biases_are_found_within_their_sigma() {
    let (mut squares, mut count, mut below) = (0.0, 0, Coverage::default());
    for seed in 0..Lane::current().choose([2, 4, 12]) {
        let hall = hall(seed, &HALL);
        let found = found(&hall.recording);
        assert!(rmse(&found) < 0.16, "{}", rmse(&found));
        for (anchor, truth) in ranged(&found).anchors.iter().zip(&hall.biases_m) {
            let bias = anchor.bias_m.unwrap();
            squares += ((bias.value - truth) / bias.sigma).powi(2);
            count += 1;
        }
        // Every 3 s: independent.
        for point in found.points.iter().skip(30).step_by(30) {
            let error = nalgebra::Vector3::from(point.position_m)
                - nalgebra::Vector3::from(path(point.time_s));
            let inverse = nalgebra::Matrix3::from(point.covariance_m2).try_inverse().unwrap();
            below.count(error.dot(&(inverse * error)) < 7.81);
        }
        assert!(finding(&found, Code::Navigation, "contradicted").is_none());
    }
    let rms = f64::sqrt(squares / count as f64);
    println!("rms of the biases over σ {rms:.2}, positions within 95 % {below}");
    assert!(rms_ratio_can_be(rms, count, 0.7..=1.26), "{rms}");
    below.assert_can_be(0.88..=0.99, "positions within 95 %");
}

#[test]
fn a_bias_that_the_data_do_not_show_stays_at_its_prior_and_is_reported() {
    // Without motion only three of six are determined, and the position is not.
    let mut hall = hall(1, &HALL[..3]);
    hall.recording.ranges.retain(|r| r.time_s < 5.0);
    let found = found(&hall.recording);
    let hidden = finding(&found, Code::NotObserved, "bias of anchor").unwrap();
    assert!(hidden.text.contains("0 ± 0.1"), "{hidden}");
    for anchor in ranged(&found).anchors.iter().filter(|a| hidden.text.contains(&a.id)) {
        let bias = anchor.bias_m.unwrap();
        assert!((0.07..0.101).contains(&bias.sigma) && bias.value.abs() < 0.15, "{bias:?}");
    }
    let other = found_all();
    assert!(finding(&other, Code::NotObserved, "bias").is_none(), "{:?}", other.findings);
}

fn found_all() -> InertialPath {
    found(&hall(1, &HALL).recording)
}

#[test]
fn anchors_in_a_plane_leave_two_paths_and_both_are_named() {
    let plane = HALL.map(|[e, n, _]| [e, n, 0.0]);
    let hall = hall(2, &plane);
    let found = found(&hall.recording);
    let mirror = finding(&found, Code::NotObserved, "equally probable").expect("a mirror image");
    assert_eq!(mirror.severity, Severity::Warning);
    assert!(mirror.text.contains("in a plane"), "{mirror}");
    // σ of the upper one reaches the lower one.
    let point = &found.points[100];
    let [.., up_sd] = point.sigma_m();
    assert!(point.position_m[2] > 0.0 && (1.0..2.0).contains(&(2.0 * point.position_m[2] / up_sd)));
    let is_far = |point: &&wimu_host::inertial::PathPoint| point.position_m[2] > 0.8;
    assert!(found.points.iter().filter(is_far).all(|point| !point.valid));
    // Anchors at different heights have one path.
    assert!(finding(&found_all(), Code::NotObserved, "equally").is_none());
}

#[test]
fn a_path_that_is_not_determined_is_refused_with_its_cause() {
    let refused = |recording: &RangeRecording| {
        let error = localize(recording, &LocalizationChoice::default()).unwrap_err();
        error.to_string()
    };
    // Around a line all positions are equal.
    let line = [0.0, 3.0, 6.0, 9.0].map(|e| [e, 0.0, 1.0]);
    let text = refused(&hall(2, &line).recording);
    assert!(text.contains("on a line") && text.contains("at best"), "{text}");
    let mut millimetres = hall(2, &HALL).recording;
    for range in &mut millimetres.ranges {
        range.value[0] *= 1e3;
    }
    let text = refused(&millimetres);
    assert!(text.contains("check the units") && !text.contains("line"), "{text}");
}

#[test]
fn a_moved_anchor_is_named_with_its_time() {
    for moved_m in [1.0, -1.0] {
        let mut hall = hall(3, &HALL);
        for range in hall.recording.ranges.iter_mut().filter(|r| r.source == 2 && r.time_s > 30.0) {
            range.value[0] += moved_m;
        }
        let found = found(&hall.recording);
        let moved = finding(&found, Code::Residuals, "anchor A2 from ");
        let moved = moved.unwrap_or_else(|| panic!("{:?}", found.findings));
        let (_, from) = moved.text.split_once("A2 from ").unwrap();
        let from_s: f64 = from.split(' ').next().unwrap().parse().unwrap();
        assert!((30.0..36.0).contains(&from_s), "{moved}");
        assert!(rmse(&found) < 0.2, "{}", rmse(&found));
    }
    assert!(finding(&found_all(), Code::Residuals, "").is_none());
}

#[test]
fn ranges_without_line_of_sight_have_little_weight() {
    let clean = rmse(&found(&hall(4, &HALL).recording));
    for seed in 0..Lane::current().choose([1, 2, 5]) {
        let mut hall = hall(4, &HALL);
        let mut random = Random::new(100 + seed);
        for range in &mut hall.recording.ranges {
            if random.uniform() < 0.5 {
                range.value[0] += 0.3 + 2.7 * random.uniform();
            }
        }
        let found = found(&hall.recording);
        assert!(rmse(&found) < 2.0 * clean, "{} and {clean}", rmse(&found));
        assert!((0.35..0.65).contains(&ranged(&found).noise.blocked), "{:?}", ranged(&found).noise);
    }
}

#[test]
fn a_position_that_jumps_is_reported_and_found_again() {
    let mut hall = hall(5, &HALL);
    // The unit is carried to another place while the radio is off.
    for range in hall.recording.ranges.iter_mut().filter(|r| r.time_s > 30.0) {
        let [e, n, u] = path(range.time_s);
        range.value[0] +=
            distance([e - 4.0, n, u], HALL[range.source]) - distance([e, n, u], HALL[range.source]);
    }
    let found = found(&hall.recording);
    let jump = finding(&found, Code::Navigation, "it jumps").expect("reported");
    assert!((29.0..33.0).contains(&jump.place.span_s.unwrap()[0]), "{jump}");
    let last = found.points.last().unwrap();
    let [e, n, u] = path(last.time_s);
    assert!(distance(last.position_m, [e - 4.0, n, u]) < 0.3);
}

#[test]
fn survey_finds_anchors_that_are_known_roughly() {
    let mut hall = hall(6, &HALL);
    hall.recording.ranges.retain(|range| range.time_s < 40.0);
    let mut random = Random::new(60);
    // Three anchors are exact: they define the frame.
    for anchor in &mut hall.recording.anchors {
        anchor.position_m = anchor.position_m.map(|p| p + 0.2 * random.normal());
    }
    let choice = LocalizationChoice { survey_m: Some(0.2), ..LocalizationChoice::default() };
    let found = localize(&hall.recording, &choice).unwrap();
    // Distances between anchors do not depend on the frame.
    let (mut before, mut after) = (0.0, 0.0);
    for i in 0..HALL.len() {
        for j in 0..i {
            let truth = distance(HALL[i], HALL[j]);
            let given = distance(
                hall.recording.anchors[i].position_m,
                hall.recording.anchors[j].position_m,
            );
            let estimated = distance(
                ranged(&found).anchors[i].position_m,
                ranged(&found).anchors[j].position_m,
            );
            before += (given - truth).powi(2);
            after += (estimated - truth).powi(2);
        }
    }
    println!("distances between anchors: {:.3} of the given error", (after / before).sqrt());
    assert!(after < 0.36 * before, "{after} and {before}");
    let sd = ranged(&found).anchors[0].position_sd_m.unwrap();
    assert!(sd.iter().all(|s| (0.01..0.2).contains(s)), "{sd:?}");
}

/// Increments of distance, m, and heading, rad, of a vehicle in 0.1 s.
fn increment(k: u32) -> [f64; 2] {
    let k = f64::from(k);
    let distance_m = 0.1 * (1.0 + 0.8 * (k * 0.04).sin());
    [distance_m, 0.03 * (k * 0.011).sin()]
}

/// Its positions, m, every 0.1 s.
fn vehicle_path() -> Vec<[f64; 2]> {
    let ([mut e, mut n], mut heading): ([f64; 2], f64) = ([0.0; 2], 0.4);
    let mut path = vec![[e, n]];
    for k in 1..=3000 {
        let [d, rotation] = increment(k);
        heading += rotation;
        (e, n) = (e + d * heading.cos(), n + d * heading.sin());
        path.push([e, n]);
    }
    path
}

/// A vehicle that turns on a plane, with its odometry, and ranges whose clock is late.
fn vehicle(late_s: f64) -> RangeRecording {
    let mut random = Random::new(7);
    let anchors = [[-20.0, -10.0, 0.0], [25.0, -5.0, 0.0], [0.0, 30.0, 0.0]];
    let mut hall = hall(7, &anchors);
    let truth = vehicle_path();
    for k in 1..=3000 {
        let [d, rotation] = increment(k);
        let distance_m = d * (1.0 + 0.02 * random.normal());
        hall.recording.increments.push(Increment {
            time_s: f64::from(k) * 0.1,
            interval_s: 0.1,
            distance_m,
            rotation_rad: rotation + 0.001 * random.normal(),
        });
    }
    hall.recording.planar = true;
    hall.recording.ranges = (1..600_usize)
        .map(|k| {
            let anchor = k % 3;
            let at = [truth[5 * k][0], truth[5 * k][1], 0.0];
            let range_m = distance(at, anchors[anchor]) * 1.05 + 0.3 * random.normal();
            Aid::range(0.5 * k as f64 + late_s, anchor, range_m)
        })
        .collect();
    hall.recording
}

#[test]
fn odometry_finds_start_heading_and_the_scale_of_the_ranges() {
    let found = found(&vehicle(0.0));
    let scale = ranged(&found).anchors[0].scale.unwrap();
    assert!((scale.value - 0.05).abs() < 3.0 * scale.sigma && scale.sigma < 0.02, "{scale:?}");
    assert!(scale.is_observed());
    // A minute after the unknown start.
    let point = found.points.iter().find(|p| p.time_s > 60.0).unwrap();
    let truth = vehicle_path()[(point.time_s * 10.0).round() as usize];
    assert!(distance(point.position_m, [truth[0], truth[1], 0.0]) < 0.5, "{point:?}");
    assert!(finding(&found, Code::Clock, "").is_none());
}

#[test]
fn a_clock_that_is_off_by_seconds_is_corrected_and_reported() {
    let truth = vehicle_path();
    // RMS error after a minute, m.
    let error = |found: &InertialPath| {
        let points = found.points.iter().filter(|p| p.time_s > 60.0);
        let squares = points.filter_map(|p| {
            let [e, n] = *truth.get((p.time_s * 10.0).round() as usize)?;
            Some(distance(p.position_m, [e, n, 0.0]).powi(2))
        });
        let squares: Vec<f64> = squares.collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let right = error(&found(&vehicle(0.0)));
    for late_s in [-1.3, 6.5] {
        let found = found(&vehicle(late_s));
        let clock = finding(&found, Code::Clock, "corrected").expect("reported");
        let named: f64 = clock.remedy.split(' ').nth(1).unwrap().parse().unwrap();
        println!("{late_s} s: {clock}, {} m, {right} m", error(&found));
        assert!((named + late_s).abs() < 0.1, "{clock}");
        assert!(error(&found) < 1.2 * right, "{} and {right}", error(&found));
    }
}

#[test]
fn a_clock_that_is_off_by_more_than_the_search_is_refused_or_reported() {
    let refused = |recording: &RangeRecording| {
        let error = localize(recording, &LocalizationChoice::default()).unwrap_err();
        error.to_string()
    };
    let text = refused(&vehicle(-15.0));
    assert!(text.contains("off by -12 s or more"), "{text}");
    assert!(text.contains("give both the times of one clock"), "{text}");
    let found = found(&vehicle(20.0));
    let unfit = finding(&found, Code::Clock, "at any clock offset within ± 12 s");
    assert!(unfit.is_some(), "{:?}", found.findings);
    assert!(finding(&found, Code::Clock, "corrected").is_none());
    let text = refused(&vehicle(400.0));
    assert!(text.contains("none of the ranges is within the time of the odometry"), "{text}");
    let text = refused(&vehicle(1.7e9));
    assert!(text.contains("the ranges have Unix times"), "{text}");
}

#[test]
fn a_gyroscope_does_not_make_the_path_worse() {
    let hall = hall(8, &HALL);
    let alone = rmse(&found(&hall.recording));
    let mut random = Random::new(80);
    let (mut motion, step) = (Imu::new("imu"), 0.01);
    for k in 0..6000 {
        let t = f64::from(k) * step;
        // The body turns about the vertical; the body is at 1 rad at the start.
        let heading = 1.0 + 0.2 * t;
        let second = |axis: usize| {
            (path(t + 0.01)[axis] - 2.0 * path(t)[axis] + path(t - 0.01)[axis]) / 1e-4
        };
        let [e, n] = [second(0), second(1)];
        let (s, c) = heading.sin_cos();
        let force = [c * e + s * n, c * n - s * e, second(2) + G];
        let force = force.map(|f| f + 0.03 + 0.05 * random.normal());
        let rate = [0.002, -0.003, 0.2 + 0.004].map(|w| w + 0.003 * random.normal());
        let sample =
            Sample { force_mps2: force.into(), rate_rad_s: Some(rate.into()), ..Sample::default() };
        motion.push(Ns::from_s(t), sample);
    }
    let recording = RangeRecording { motion: Some(motion), ..hall.recording };
    let found = found(&recording);
    assert!(rmse(&found) < 1.05 * alone, "{} and {alone}", rmse(&found));
    let [w, _, _, z] = found.points[3000].quaternion;
    let heading = 2.0 * z.atan2(w);
    let expected = 1.0 + 0.2 * found.points[3000].time_s;
    let off = (heading - expected).sin().atan2((heading - expected).cos());
    assert!(off.abs() < 0.2, "{off}");
}

/// Two files in a folder of their own.
fn files(ranges: &str, anchors: &str) -> (tempfile::TempDir, [PathBuf; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let paths = [folder.path().join("ranges.csv"), folder.path().join("anchors.csv")];
    std::fs::write(&paths[0], ranges).unwrap();
    std::fs::write(&paths[1], anchors).unwrap();
    (folder, paths)
}

const ANCHORS: &str = "Anchor,Position E (m),Position N (m)\na,0,0\nb,5,0\nc,0,500e-2\n";

#[test]
fn unknown_anchors_and_negative_ranges_are_left_out_and_counted() {
    let ranges = "Time (s),Anchor,Range (m)\n0,a,2\n0,x,2\n0.1,b,-1\n0.1,c,nan\n0.05,b,400e-2\n";
    let (_folder, [ranges, anchors]) = files(ranges, ANCHORS);
    let recording = RangeRecording::read(&ranges, &anchors).unwrap();
    assert_eq!(recording.ranges.len(), 2);
    assert!(recording.planar);
    let text: Vec<String> = recording.findings.iter().map(ToString::to_string).collect();
    assert!(text.iter().any(|t| t.contains("1 range left out: anchor x is not in")), "{text:?}");
    assert!(text.iter().any(|t| t.contains("zero or negative")), "{text:?}");
    assert!(
        text.iter().any(|t| t.contains("sorted"))
            || recording.ranges.is_sorted_by(|a, b| a.time_s <= b.time_s)
    );
    // Too few to localize.
    let error = localize(&recording, &LocalizationChoice::default()).unwrap_err();
    assert_eq!(error.exit_code(), 3);
}

#[test]
fn columns_of_ranges_and_other_units_are_read() {
    let ranges = "Time (ms),Range a (mm),Range b (mm)\n0,2000,3000\n100,2100,\n";
    let (_folder, [ranges, anchors]) = files(ranges, ANCHORS);
    let recording = RangeRecording::read(&ranges, &anchors).unwrap();
    let read: Vec<(f64, usize, f64)> =
        recording.ranges.iter().map(|r| (r.time_s, r.source, r.value[0])).collect();
    assert_eq!(read, [(0.0, 0, 2.0), (0.0, 1, 3.0), (0.1, 0, 2.1)]);
}

#[test]
fn files_that_are_no_ranges_are_refused_with_what_is_missing() {
    for (ranges, anchors, message) in [
        ("Time (s),Anchor\n0,a\n", ANCHORS, "Range (m)"),
        ("Time,Anchor,Range (m)\n0,a,1\n", ANCHORS, "Time (s)"),
        ("Time (s),Anchor,Range (m)\n0,a,one\n", ANCHORS, "not a number"),
        ("Time (s),Anchor,Range (m)\n0,q,1\n", ANCHORS, "no range to a known anchor"),
        ("Time (s),Anchor,Range (m)\n0,a,1\n", "Anchor,Position E (m)\na,0\n", "Position N (m)"),
        ("Time (s),Anchor,Range (m)\n0,a,1\n", "Anchor,X (m),Y (m)\na,0,0\na,1,1\n", "twice"),
    ] {
        let (_folder, [ranges, anchors]) = files(ranges, anchors);
        let error = RangeRecording::read(&ranges, &anchors).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
        assert_eq!(error.exit_code(), 2);
    }
}

#[test]
fn too_many_anchors_are_refused() {
    let anchor = |k: u32| format!("{k},{k},{}\n", k * k % 7);
    let many = "Anchor,X (m),Y (m)\n".to_owned() + &(0..65).map(anchor).collect::<String>();
    let (_folder, [ranges, anchors]) = files("Time (s),Anchor,Range (m)\n0,1,1\n", &many);
    let error = RangeRecording::read(&ranges, &anchors).unwrap_err();
    assert!(error.to_string().contains("65 anchors are too many"), "{error}");
    assert_eq!(error.exit_code(), 3);
}
