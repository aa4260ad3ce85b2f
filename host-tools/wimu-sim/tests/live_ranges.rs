//! A walk with ranges that arrive while it goes on, beside the filter of its recording.

use nalgebra::{Matrix3, Vector3};
use wimu_host::imu::Imu;
use wimu_host::inertial::aids::{Aid, Mounting};
use wimu_host::inertial::{Aids, Choice, Live, PathPoint, Profile};
use wimu_host::localization::{LocalizationChoice, RangePrior, RangeRecording, Ranging, localize};
use wimu_host::{Code, Problem, Severity};
use wimu_sim::motion::Motion as _;
use wimu_sim::walk::{HALL_M, RangeWalk, Strides, distance_m, sensed};
use wimu_testkit::{Coverage, Lane};

/// A walk on foot through the hall: the unit's samples, and ranges of which a part has no line of sight.
fn walked(seed: u64, blocked: f64) -> (Strides, Imu, RangeWalk) {
    let corner = [[1.5, 1.0], [7.5, 1.5], [7.0, 6.0], [2.0, 5.5]];
    let corners: Vec<[f64; 2]> = corner.into_iter().cycle().take(7).collect();
    let strides = Strides::along(&corners);
    let motion = sensed(&strides, 100.0, seed);
    let until_s = strides.duration();
    let ranges = RangeWalk::along(seed, &HALL_M, until_s, blocked, |t| strides.pose(t).position_m);
    (strides, motion, ranges)
}

fn live(anchors: &RangeRecording, profile: Profile) -> Live {
    let prior = RangePrior::ULTRA_WIDEBAND;
    let ranging = Ranging::new("hall", anchors.anchors.clone(), anchors.planar, &prior);
    let aids = Aids { ranging: Some(ranging), ..Aids::default() };
    let choice = Choice { profile, aids, ..Choice::default() };
    Live::new(choice, Imu::default(), 0.5)
}

/// The answers to a stream whose ranges arrive `late_s` after their time.
fn streamed(
    live: &mut Live,
    motion: &Imu,
    ranges: &[Aid],
    late_s: impl Fn(usize) -> f64,
) -> Vec<PathPoint> {
    let arrivals = ranges.iter().enumerate();
    let mut arrivals: Vec<_> = arrivals.map(|(k, r)| (r.time_s + late_s(k), *r)).collect();
    arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut arrivals = arrivals.into_iter().peekable();
    let mut points = Vec::new();
    for (k, sample) in motion.samples.v.iter().enumerate() {
        let time_s = motion.samples.t[k].s();
        while let Some((_, range)) = arrivals.next_if(|(arrived_s, _)| *arrived_s <= time_s) {
            live.aid(range.mounted(&Mounting::default()));
        }
        live.push(time_s, *sample).unwrap();
        if k % 50 == 49 {
            points.extend(live.now());
        }
    }
    points
}

/// RMS error of valid points after a time, s, and their fraction.
fn error_m(strides: &Strides, points: &[PathPoint], from_s: f64) -> (f64, f64) {
    let late: Vec<_> = points.iter().filter(|p| p.time_s > from_s).collect();
    let valid: Vec<_> = late.iter().filter(|p| p.valid).collect();
    let square =
        |p: &&&PathPoint| distance_m(p.position_m, strides.pose(p.time_s).position_m).powi(2);
    let mean = valid.iter().map(square).sum::<f64>() / valid.len() as f64;
    (mean.sqrt(), valid.len() as f64 / late.len() as f64)
}

/// RMS error of the filter of the recording after 8 s, m.
fn recorded_m(strides: &Strides, motion: &Imu, ranges: &RangeRecording) -> f64 {
    let recording = RangeRecording { motion: Some(motion.clone()), ..ranges.clone() };
    let choice = LocalizationChoice { smooth: false, ..LocalizationChoice::default() };
    error_m(strides, &localize(&recording, &choice).unwrap().points, 8.0).0
}

#[test]
fn a_stream_with_ranges_is_as_good_as_the_filter_of_its_recording() {
    let mut below = Coverage::default();
    let walks = [(1, Profile::Foot), (2, Profile::Hand), (3, Profile::Foot)];
    for (seed, profile) in walks.into_iter().take(Lane::current().choose([1, 2, 3])) {
        let (strides, motion, ranges) = walked(seed, 0.1);
        let filtered = recorded_m(&strides, &motion, &ranges.recording);
        let mut live = live(&ranges.recording, profile);
        let points = streamed(&mut live, &motion, &ranges.recording.ranges, |_| 0.0);
        let (found, valid) = error_m(&strides, &points, 8.0);
        println!("{profile:?}: {found:.3} m, recording {filtered:.3} m");
        assert!((0.03..1.1 * filtered).contains(&found), "{found} {filtered}");
        assert_eq!(valid, 1.0);
        for point in points.iter().filter(|p| p.time_s > 8.0).step_by(4) {
            let truth = Vector3::from(strides.pose(point.time_s).position_m);
            let error = Vector3::from(point.position_m) - truth;
            let inverse = Matrix3::from(point.covariance_m2).try_inverse().unwrap();
            below.count(error.dot(&(inverse * error)) < 7.81);
        }
        let found = live.findings();
        assert!(!found.iter().any(|f| f.severity > Severity::Note), "{found:?}");
    }
    println!("NEES below its 95 % point at {below} positions");
    below.assert_can_be(0.85..=1.0, "NEES below its 95 % point");
}

#[test]
fn late_and_blocked_ranges_are_counted_and_not_believed() {
    let (strides, motion, ranges) = walked(4, 0.3);
    let all = &ranges.recording.ranges;
    let is_late = |k: usize| k % 10 == 3 && all[k].time_s > 5.0;
    let mut live = live(&ranges.recording, Profile::Hand);
    let points = streamed(&mut live, &motion, all, |k| if is_late(k) { 1.5 } else { 0.0 });
    let aided = live.aids()["range"];
    println!("{aided:?}");
    let until_s = motion.samples.t[motion.samples.len() - 1].s();
    let arrived = |k: &usize| is_late(*k) && all[*k].time_s + 1.5 <= until_s;
    assert_eq!(aided.late, (0..all.len()).filter(arrived).count());
    let blocked = ranges.blocked.iter().filter(|blocked| **blocked).count() as f64;
    let rejected = aided.rejected as f64 / (0.9 * blocked);
    assert!((0.8..1.2).contains(&rejected), "{rejected}");
    let (found, valid) = error_m(&strides, &points, 8.0);
    println!("{found}");
    assert!(found < 0.3 && valid > 0.99, "{found} {valid}");
    let text = format!("{} ranges arrived later than the filter waits", aided.late);
    let said = live.findings();
    assert!(said.iter().any(|f| f.text.contains(&text)), "{said:?}");
}

#[test]
fn an_anchor_that_was_moved_is_named() {
    let (strides, motion, mut ranges) = walked(5, 0.0);
    for range in &mut ranges.recording.ranges {
        if range.source == 2 && range.time_s > 15.0 {
            range.value[0] += 2.0;
        }
    }
    let mut live = live(&ranges.recording, Profile::Foot);
    let points = streamed(&mut live, &motion, &ranges.recording.ranges, |_| 0.0);
    let said = live.findings();
    let named = |f: &&Problem| f.code == Code::Residuals;
    let named: Vec<_> = said.iter().filter(named).collect();
    assert_eq!(named.len(), 1, "{said:?}");
    assert!(named[0].text.contains("anchor A3 from 1"), "{}", named[0]);
    let (found, _) = error_m(&strides, &points, 8.0);
    assert!(found < 0.3, "{found}");
}

#[test]
fn anchors_without_heights_are_in_the_plane_of_the_unit() {
    let (strides, motion, _) = walked(7, 0.1);
    let level = HALL_M.map(|[e, n, _]| [e, n, 0.0]);
    let at = |t: f64| strides.pose(t).position_m;
    let mut ranges = RangeWalk::along(7, &level, strides.duration(), 0.1, at);
    ranges.recording.planar = true;
    let mut live = live(&ranges.recording, Profile::Foot);
    let points = streamed(&mut live, &motion, &ranges.recording.ranges, |_| 0.0);
    let (found, valid) = error_m(&strides, &points, 8.0);
    println!("{found} {valid}");
    assert!(found < 0.4 && valid > 0.9, "{found} {valid}");
}

#[test]
fn a_unit_without_a_gyroscope_is_refused() {
    let (_, mut motion, ranges) = walked(6, 0.0);
    let refused = |ranges: &RangeRecording, motion: &Imu| {
        let mut live = live(ranges, Profile::Hand);
        let mut pairs = motion.samples.t.iter().zip(&motion.samples.v);
        let refused = pairs.find_map(|(time, sample)| live.push(time.s(), *sample).err());
        refused.unwrap().to_string()
    };
    for sample in &mut motion.samples.v {
        sample.rate_rad_s = None;
    }
    let text = refused(&ranges.recording, &motion);
    assert!(text.contains("needs a gyroscope"), "{text}");
}
