//! Rotation between two units of a simulated joint, against the truth.

use nalgebra::Vector3;
use wimu_host::imu::Imu;
use wimu_host::relative::{
    Body, LiveRelative, RelativeChoice, RelativePath, RelativePoint, relative,
};

use crate::rig::Rig;
use wimu_host::{Code, Result};
use wimu_testkit::{Coverage, Lane, Random};

fn run(rig: &Rig, choice: &RelativeChoice) -> Result<RelativePath> {
    let [a, b] = rig.record();
    relative([&a, &b], choice)
}

fn found(rig: &Rig) -> RelativePath {
    run(rig, &RelativeChoice::default()).unwrap()
}

/// Errors of the rotation about the axis and their standard deviations at each second from 5 s on, rad.
fn errors(rig: &Rig, found: &RelativePath) -> Vec<(f64, f64)> {
    let axis = rig.axes()[0];
    let mut next_s = 5.0;
    let mut errors = Vec::new();
    for point in found.points.iter().filter(|point| point.valid) {
        if point.time_s < next_s {
            continue;
        }
        next_s += 1.0;
        let [w, x, y, z] = point.quaternion;
        let attitude =
            nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        let error = attitude.to_rotation_matrix() * rig.truth(point.time_s).inverse();
        errors.push((error.scaled_axis().dot(&axis), point.sigma_rad));
    }
    errors
}

fn rms_deg(errors: &[(f64, f64)]) -> f64 {
    let squares: f64 = errors.iter().map(|(e, _)| e * e).sum();
    (squares / errors.len() as f64).sqrt().to_degrees()
}

fn has(found: &RelativePath, code: Code, text: &str) -> bool {
    let finding = |f: &wimu_host::problem::Problem| f.code == code && f.text.contains(text);
    found.findings.iter().any(finding)
}

#[test]
fn the_angle_of_a_hinge_has_its_stated_standard_deviation() {
    let (mut angle, mut axes) = (Coverage::default(), Coverage::default());
    let (mut squares, mut count, mut worst_deg) = (0.0, 0.0, 0.0_f64);
    for seed in 0..Lane::current().choose([3, 6, 24]) {
        let rig = Rig::knee(seed);
        let found = found(&rig);
        assert!(found.is_accurate(), "{seed}: {:?}", found.findings);
        let errors = errors(&rig, &found);
        worst_deg = worst_deg.max(rms_deg(&errors));
        for (error, sigma) in errors {
            angle.count(error.abs() <= 2.0 * sigma);
            squares += (error / sigma).powi(2);
            count += 1.0;
        }
        for (k, axis) in rig.axes().iter().enumerate() {
            let off = Vector3::from(found.hinge.axes[k]).cross(axis).norm();
            axes.count(off <= 2.0 * found.hinge.sd_rad[k]);
        }
    }
    let ratio = f64::sqrt(squares / count);
    println!(
        "angle within 2 σ: {angle}; error over σ {ratio:.2}; axes within 2 σ: {axes}; worst {worst_deg:.2}°"
    );
    assert!(worst_deg < 2.0, "{worst_deg}");
    assert!(angle.can_be(0.9..=0.995), "{angle}");
    assert!((0.5..1.2).contains(&ratio), "{ratio}");
    // Two components: 86.5 % are expected.
    assert!(axes.can_be(0.75..=0.97), "{axes}");
}

#[test]
fn a_given_axis_is_used_as_it_is_and_a_wrong_one_is_seen_in_the_error() {
    let aligned = Rig { mounts: [nalgebra::Rotation3::identity(); 2], ..Rig::knee(3) };
    let with = |hinge| {
        let choice = RelativeChoice { hinge: Some(hinge) };
        let found = run(&aligned, &choice).unwrap();
        assert!(found.hinge.given && found.hinge.axes[0] == hinge);
        rms_deg(&errors(&aligned, &found))
    };
    assert!(with([0.0, 0.0, 1.0]) < 1.5);
    assert!(with([1.0, 0.0, 0.0]) > 3.0);
    // The angle of units that are mounted alike is absolute.
    let choice = RelativeChoice { hinge: Some([0.0, 0.0, 2.0]) };
    let found = run(&aligned, &choice).unwrap();
    let last = found.points.last().unwrap();
    let truth = aligned.truth(last.time_s).scaled_axis().z;
    assert!((last.angle_rad - truth).abs() < 4.0 * last.sigma_rad.max(0.005));
}

#[test]
fn clocks_that_differ_are_aligned() {
    // Shaken together: the correlation of the angular rates finds seconds.
    let shaken = Rig { shake_rad: 0.6, ..Rig::knee(5) };
    let knee = Rig::knee(5);
    let cases = [(0.05, &knee), (-0.04, &knee), (3.7, &shaken), (100.0, &shaken)];
    for (behind_s, rig) in cases {
        let rig = Rig { behind_s, rates_hz: [100.0, 50.0], ..rig.clone() };
        let found = found(&rig);
        let off_s = found.clock.offset_s - behind_s;
        assert!(off_s.abs() < 0.01, "{behind_s}: {:?}", found.clock);
        assert!(off_s.abs() < 4.0 * found.clock.sd_s, "{behind_s}: {:?}", found.clock);
        assert!(has(&found, Code::Clock, "behind"), "{:?}", found.findings);
        assert!(rms_deg(&errors(&rig, &found)) < 2.0);
    }
    let apart = found(&Rig { behind_s: 3.7, ..Rig::knee(5) });
    println!("NIS of the joint with a wrong clock: {}", apart.joint_nis);
    assert!(!apart.is_accurate() && has(&apart, Code::Residuals, "common joint"));
    let found = found(&Rig::knee(5));
    println!("NIS of the joint: {}", found.joint_nis);
    assert_eq!(found.clock.offset_s, 0.0);
    assert!(!has(&found, Code::Clock, "behind"));
}

#[test]
fn different_rates_and_repeated_rows_give_the_same_angle() {
    let plain = rms_deg(&errors(&Rig::knee(7), &found(&Rig::knee(7))));
    for (rates_hz, rows) in [([100.0, 41.0], 1), ([50.0, 50.0], 3)] {
        let rig = Rig { rates_hz, rows, ..Rig::knee(7) };
        let rms = rms_deg(&errors(&rig, &found(&rig)));
        assert!(rms < plain + 1.0, "{rates_hz:?} {rows}: {rms} and {plain}");
    }
}

#[test]
fn a_gap_is_not_valid_and_the_angle_is_found_again() {
    let rig = Rig::knee(8);
    let [a, mut b] = rig.record();
    let after = |time_s: f64| b.samples.t.partition_point(|t| t.s() < time_s);
    let gap = after(9.0)..after(11.0);
    b.samples.t.drain(gap.clone());
    b.samples.v.drain(gap);
    let found = relative([&a, &b], &RelativeChoice::default()).unwrap();
    let lost = found.points.iter().filter(|p| !p.valid);
    assert!(lost.clone().count() > 90 && lost.clone().all(|p| (8.9..11.1).contains(&p.time_s)));
    assert!(has(&found, Code::Rate, "gap"));
    let late: Vec<_> = errors(&rig, &found).split_off(8);
    assert!(late.iter().all(|(e, sigma)| e.abs() < 4.0 * sigma.max(0.005)), "{late:?}");
}

#[test]
fn what_the_data_do_not_show_is_refused_or_reported() {
    let refused = |result: Result<RelativePath>, text: &str| {
        let error = result.unwrap_err();
        assert_eq!(error.code, Code::DataRefused);
        assert!(error.to_string().contains(text), "{error}");
    };
    let stiff = Rig { swing_rad: [0.0; 3], ..Rig::knee(9) };
    refused(run(&stiff, &RelativeChoice::default()), "hardly moves");
    let [a, mut b] = stiff.record();
    refused(relative([&a, &a.clone()], &RelativeChoice::default()), "same samples");
    b.samples.v.iter_mut().for_each(|sample| sample.rate_rad_s = None);
    refused(relative([&a, &b], &RelativeChoice::default()), "no angular rates");
    let resting = Rig { base: [0.0; 2], behind_s: 1000.0, ..stiff };
    refused(run(&resting, &RelativeChoice::default()), "in common");
    let ball = Rig { swing_rad: [0.6, 0.6, 0.7], ..Rig::knee(9) };
    let ball = found(&ball);
    assert!(has(&ball, Code::NotObserved, "more than one axis") && !ball.is_accurate());
}

/// The points of a stream, and the stream. Messages take 5 to 25 ms, those of the second unit 40 ms more.
fn live(rig: &Rig, choice: RelativeChoice) -> (Vec<RelativePoint>, LiveRelative) {
    let mut random = Random::new(rig.seed);
    let mut arrivals = Vec::new();
    for (body, recording) in [Body::A, Body::B].into_iter().zip(rig.record()) {
        let (ahead_s, delay_s) = match body {
            Body::A => (0.0, 0.005),
            Body::B => (rig.behind_s, 0.045),
        };
        let mut arrived_s = 0.0_f64;
        for (time, sample) in recording.samples.t.iter().zip(recording.samples.v) {
            let time_s = time.s();
            let sent_s = time_s + ahead_s;
            arrived_s = arrived_s.max(sent_s + delay_s + 0.02 * random.uniform());
            arrivals.push((arrived_s, body, time_s, sample));
        }
    }
    arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
    let of = ["A", "B"].map(Imu::new);
    let mut live = LiveRelative::new(choice, of);
    let mut points = Vec::new();
    for (arrived_s, body, time_s, sample) in arrivals {
        live.push(body, time_s, arrived_s, sample);
        points.extend(live.take());
    }
    (points, live)
}

#[test]
fn a_stream_has_the_angle_of_the_recording() {
    for seed in 0..Lane::current().choose([1, 2, 6]) {
        let rig =
            Rig { seconds: 40.0, behind_s: 1000.0, rates_hz: [100.0, 50.0], ..Rig::knee(seed) };
        let (points, live) = live(&rig, RelativeChoice::default());
        assert!(live.is_accurate(), "{:?}", live.lacks());
        let path = live.path(points).expect("a search had a result");
        let first_s = path.points[0].time_s;
        let of_stream = rms_deg(&errors(&rig, &path));
        let known = Rig { behind_s: 0.0, ..rig };
        let of_recording = rms_deg(&errors(&known, &found(&known)));
        println!(
            "stream {of_stream:.2}°, recording {of_recording:.2}°, clock {:.4} ± {:.4} s, from {first_s:.1} s on",
            path.clock.offset_s, path.clock.sd_s
        );
        assert!(first_s < 12.0);
        assert!((path.clock.offset_s - 1000.0).abs() < 0.01);
        assert!(of_stream < of_recording + 0.5, "{of_stream} {of_recording}");
    }
}
