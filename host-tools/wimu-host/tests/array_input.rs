//! What is claimed of arrays that are given something wrong: constant rotations, sensors that fail on the way,
//! limits nobody declared, geometries of another array, starts in motion.

use crate::array_journeys;

use array_journeys::{Case, Part, Places};
use wimu_calib::Gravity;
use wimu_host::array::{Array, ArrayCalibration, ArrayGeometry};
use wimu_host::inertial::{Choice, InertialPath, Zupt, navigate_array};
use wimu_host::series::Ns;
use wimu_host::{Code, Problem};
use wimu_testkit::figure;

const G: f64 = 9.80665;
const RATE_HZ: f64 = 100.0;

/// An octahedron on these parts of a motion.
fn simulated(arm_m: f64, parts: &[Part], seed: u64) -> (Array, ArrayGeometry) {
    let places = Places::Octahedron(arm_m);
    Case { places, rate_hz: RATE_HZ, noise: 0.01, ..Case::default() }.recording_of(parts, seed)
}

/// The rate about the vertical, rad/s, that is reached in a time, s.
fn about_z(seconds: f64, spin: f64) -> Part {
    Part { seconds, spin, ..Part::default() }
}

fn rates(recording: &Array) -> Vec<[f64; 3]> {
    recording.beside(&recording.reference.rate_rad_s).into_iter().flatten().collect()
}

/// Judged, arranged, calibrated and navigated, as the command does.
fn path(
    recording: &Array,
    geometry: &ArrayGeometry,
    zupt: bool,
) -> Result<(InertialPath, ArrayCalibration), Problem> {
    let arranged = recording.clone().judged().arranged(geometry)?;
    let calibration = ArrayCalibration::of(&arranged, geometry, Gravity::UNKNOWN_PLACE)?;
    let choice = Choice { zupt: if zupt { Zupt::Stated } else { Zupt::Off }, ..Choice::default() };
    Ok((navigate_array(&arranged, geometry, &calibration, &choice)?, calibration))
}

fn says(path: &InertialPath, what: &str) -> bool {
    path.findings.iter().any(|f| f.text.contains(what))
}

fn rate_rms(path: &InertialPath, rates: &[[f64; 3]]) -> f64 {
    let squares = path.points.iter().zip(rates).map(|(point, rate)| {
        let d: [f64; 3] = std::array::from_fn(|i| point.rate_rad_s[i] - rate[i]);
        d.iter().map(|v| v * v).sum::<f64>()
    });
    (squares.sum::<f64>() / rates.len() as f64).sqrt()
}

fn end_error(path: &InertialPath, recording: &Array) -> f64 {
    let last = path.points[path.points.len() - 1].position_m;
    let truth = recording.truth();
    let truth = truth[truth.len() - 1].unwrap().position_m;
    (0..3).map(|i| (last[i] - truth[i]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn an_even_turn_about_the_vertical_is_no_rest() {
    let long = |rate: f64| {
        vec![
            about_z(3.0, 0.0),
            about_z(0.5, rate),
            about_z(5.0, rate),
            about_z(0.5, 0.0),
            about_z(3.0, 0.0),
        ]
    };
    let mut plateaus = vec![about_z(3.0, 0.0)];
    for rate in [8.0, -8.0, 5.0, -12.0, 12.0] {
        plateaus.extend([about_z(0.3, rate), about_z(0.5, rate)]);
    }
    plateaus.extend([about_z(0.3, 0.0), about_z(2.0, 0.0)]);
    // Begun in the middle of a turn: the first stretch is no rest for being the first.
    // From nothing to the turn in one sample.
    let mut begun = vec![about_z(1.0 / RATE_HZ, 20.0), about_z(2.0, 20.0)];
    begun.extend([about_z(0.5, 0.0), about_z(3.0, 0.0)]);
    for (arm, name, parts, most) in [
        (0.01, "20 rad/s for 5 s, 1 cm", long(20.0), 0.3),
        (0.03, "20 rad/s for 5 s, 3 cm", long(20.0), 0.1),
        (0.03, "3 rad/s for 5 s, 3 cm", long(3.0), 0.3),
        (0.01, "plateaus of 0.5 s, 1 cm", plateaus, 0.3),
        (0.03, "begun in a turn", begun, f64::INFINITY),
    ] {
        let (recording, geometry) = simulated(arm, &parts, 5);
        let rates = rates(&recording);
        let (path, calibration) = path(&recording, &geometry, true).unwrap();
        for (first, count) in &calibration.rests {
            let fastest = rates[*first..first + count].iter().map(|r| r[2].abs());
            let fastest = fastest.fold(0.0, f64::max);
            assert!(fastest < 0.8, "{name}: a rest at {fastest} rad/s");
        }
        let rms = rate_rms(&path, &rates);
        println!("{name}: angular rate off by {rms:.3} rad/s rms");
        if most.is_finite() {
            let claim = format!("octahedron about the vertical, {name}: rate, rad/s rms");
            let target = format!("below {most}");
            figure(&claim, format!("{rms:.3}"), &target, rms < most);
        }
        assert!(rms < most, "{name}: {rms} {:?}", path.findings);
        assert!(
            says(&path, "constant angular rate") && says(&path, "cannot be excluded"),
            "{:?}",
            path.findings
        );
    }
    // Nothing but a constant rotation, faster than biases explain: there is no rest.
    let turn = [about_z(1.0 / RATE_HZ, 20.0), about_z(5.0, 20.0)];
    let (recording, geometry) = simulated(0.03, &turn, 6);
    let error = path(&recording, &geometry, true).unwrap_err();
    assert!(error.code == Code::DataRefused && error.to_string().contains("constant rate"));
}

/// Rests with moves and turns between.
fn carried() -> Vec<Part> {
    let mut parts = vec![about_z(3.0, 0.0)];
    let moves = [
        ([0.3, -0.2, 0.1], [3.0, 1.8, 4.2]),
        ([-0.2, 0.3, 0.2], [-2.4, 4.8, -1.8]),
        ([0.1, 0.4, -0.3], [1.8, -4.2, 3.0]),
        ([-0.3, -0.1, 0.2], [-4.8, 1.8, -2.4]),
    ];
    for (shift, turn) in moves {
        parts.extend([Part { seconds: 1.2, shift, turn, ..Part::default() }, about_z(2.0, 0.0)]);
    }
    parts
}

#[test]
fn a_sensor_that_fails_on_the_way_leaves_the_others_as_they_were() {
    let (recording, geometry) = simulated(0.03, &carried(), 7);
    let (sound, _) = path(&recording, &geometry, true).unwrap();
    let without = end_error(&sound, &recording);
    let rates = rates(&recording);
    println!("sound: end off by {without:.3} m, {:?}", sound.consistency());
    type Fail = fn(&mut [f64; 3]);
    let fails: [(&str, Fail); 4] = [
        ("one axis stuck", |v| v[0] = 9.0),
        ("all axes zero", |v| *v = [0.0; 3]),
        ("at 16 g", |v| *v = [156.9; 3]),
        ("no number", |v| *v = [f64::NAN; 3]),
    ];
    for (name, fail) in fails {
        let mut recording = recording.clone();
        for output in &mut recording.units[2].force.v[400..] {
            fail(&mut output.data.0[0]);
        }
        let (path, calibration) = path(&recording, &geometry, true).unwrap();
        let error = end_error(&path, &recording);
        let last = path.points[path.points.len() - 1].sd_m();
        let (median, share) = path.consistency().unwrap();
        let rms = rate_rms(&path, &rates);
        println!(
            "{name}: end off by {error:.3} ± {last:.3} m, NEES median {median:.2}, {share:.2} below 7.81, \
             rate off by {rms:.3}, rests {}",
            calibration.rests.len()
        );
        assert!(error < 4.0 * last && last < 0.5, "{name}");
        assert!(median < 9.0 && rms < 0.2, "{name}");
        assert!(
            says(&path, "sensor 2 (from 0)") || says(&path, "of sensor 2"),
            "{name}: {:?}",
            path.findings
        );
    }
}

/// The outputs of all sensors.
fn values(array: &mut Array) -> impl Iterator<Item = &mut nalgebra::Vector3<f64>> {
    array.units.iter_mut().flat_map(|unit| &mut unit.force.v)
}

#[test]
fn outputs_in_g_are_refused_and_those_of_coarse_steps_are_all_used() {
    let (recording, geometry) = simulated(0.03, &carried(), 8);
    // In g under the name of m/s²: said, not navigated.
    let mut in_g = recording.clone();
    for output in values(&mut in_g) {
        *output /= G;
    }
    let error = path(&in_g, &geometry, true).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("which is not gravity"), "{error}");
    let mut coarse = recording.clone();
    for output in values(&mut coarse) {
        *output = output.map(|axis| (axis / 0.15).round() * 0.15);
    }
    let mut coarse = coarse.judged();
    let is_marked = |k: usize| (0..coarse.sensors()).any(|sensor| coarse.is_saturated(k, sensor));
    assert!(!(0..coarse.len()).any(is_marked), "{:?}", coarse.remarks);
    assert!(values(&mut coarse).all(|output| output.iter().all(|axis| axis.is_finite())));
}

#[test]
fn samples_at_a_full_scale_are_marked() {
    let (mut recording, _) = simulated(0.03, &carried(), 8);
    for output in &mut recording.units[1].force.v[320..330] {
        output[2] = 2.0 * G;
    }
    let marked = recording.judged();
    let count = (0..marked.len()).filter(|k| marked.is_saturated(*k, 1)).count();
    assert_eq!(count, 10, "{:?}", marked.remarks);
    assert!(
        marked.remarks[0].contains("sensors [1] (from 0) are at their full scale in 10 samples")
    );
}

#[test]
fn a_start_in_motion_is_said_and_its_velocity_unknown() {
    let (mut recording, geometry) = simulated(0.03, &carried(), 10);
    // From the middle of the first move on.
    let from = (3.3 * RATE_HZ) as usize;
    for unit in &mut recording.units {
        unit.force.forget_before(Ns::from_s(from as f64 / RATE_HZ), 0);
    }
    let (path, _) = path(&recording, &geometry, true).unwrap();
    let (median, share) = path.consistency().unwrap();
    println!("begun in motion: NEES median {median:.2}, {share:.2} below 7.81");
    assert!(says(&path, "where the position begins"), "{:?}", path.findings);
    let first = path.points.iter().position(|p| p.valid).unwrap();
    // The move ends 0.9 s after; half a second shows the rest.
    let seconds = first as f64 / RATE_HZ;
    assert!((1.0..2.5).contains(&seconds), "first valid after {seconds} s");
    assert!(path.points[first - 10].sd_m() > 1.0);
    assert!(median < 7.81, "{median}");
}

#[test]
fn the_smoothed_rate_of_an_array_is_closer_to_the_truth_and_within_its_deviation() {
    let (recording, geometry) = simulated(0.03, &carried(), 12);
    let arranged = recording.clone().judged().arranged(&geometry).unwrap();
    let calibration = ArrayCalibration::of(&arranged, &geometry, Gravity::UNKNOWN_PLACE).unwrap();
    let [filtered, smoothed] = [false, true].map(|smooth| {
        let choice = Choice { zupt: Zupt::Stated, smooth, ..Choice::default() };
        let path = navigate_array(&arranged, &geometry, &calibration, &choice).unwrap();
        assert_eq!(path.smoothed_rate, smooth);
        path
    });
    let [before, after] = [&filtered, &smoothed].map(|path| rate_rms(path, &rates(&recording)));
    println!("{before:.4} and {after:.4} rad/s rms");
    assert!(after < 0.9 * before, "{after} {before}");
    let (_, share) = wimu_host::inertial::consistency(&smoothed.rate_nees.all).unwrap();
    assert!(share > 0.9, "{share}");
}
