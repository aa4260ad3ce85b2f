//! What navigating a file claims.

use crate::common::{push, read};
use tempfile::{NamedTempFile, TempPath};
use wimu_calib::Gravity;
use wimu_host::Code;
use wimu_host::array::{Array, ArrayBody, ArrayCalibration, ArrayGeometry};
use wimu_host::formats::ReadOptions;
use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::{Aids, Choice, InertialPath, Method, Profile, StartPose, Zupt, navigate};
use wimu_host::series::{Flags, Ns};

/// A file that is removed when dropped.
fn file(text: &str) -> TempPath {
    let path = NamedTempFile::with_suffix(".csv").unwrap().into_temp_path();
    std::fs::write(&path, text).unwrap();
    path
}

/// Rest, 0.5 m along x in 1.5 s, rest; bias 0.03 m/s² and a little deterministic noise.
fn slide() -> Imu {
    let mut recording = Imu::default();
    for k in 0..450 {
        let t = f64::from(k) * 0.01;
        let tau = ((t - 1.5) / 1.5).clamp(0.0, 1.0);
        let curve = 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) * 0.5 / 2.25;
        let path = tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
        let noise = f64::from((k * 7919) % 13 - 6) * 0.003;
        let force_mps2 = [curve + 0.03 + noise, -noise, 9.80665 + noise].into();
        let time = Ns::from_s(t);
        recording.push(time, Sample { force_mps2, ..Sample::default() });
        let truth = &mut recording.reference;
        truth.position_m.push(time, [0.5 * path, 0.0, 0.0].into(), Flags::NONE);
        truth.quaternion.push(time, [1.0, 0.0, 0.0, 0.0].into(), Flags::NONE);
    }
    recording
}

/// At rest for so long, s, before [`slide`]'s move; time jumps by `gap_s` a second before its end.
fn slide_after(rest_s: f64, gap_s: f64) -> Imu {
    let mut recording = Imu::default();
    let moved = slide();
    let before = (rest_s * 100.0) as usize;
    let mut time = Ns::default();
    for k in 0..before + moved.samples.len() {
        let after = k.checked_sub(before);
        let from = after.unwrap_or(k % 100);
        let rate = [0.001, -0.002, 0.0015].map(|r| r * ((k * 31) % 7) as f64 / 3.0);
        time = time.after_s(if k + 100 == before { 0.01 + gap_s } else { 0.01 });
        recording.push(time, Sample { rate_rad_s: Some(rate.into()), ..moved.samples.v[from] });
        let (truth, known) = (&mut recording.reference, &moved.reference);
        truth.position_m.push(time, known.position_m.v[from], Flags::NONE);
        truth.quaternion.push(time, known.quaternion.v[from], Flags::NONE);
    }
    recording
}

fn said(path: &InertialPath, what: &str) -> bool {
    path.findings.iter().any(|found| found.to_string().contains(what))
}

#[test]
fn position_is_measured_from_the_end_of_the_first_rest_however_long_it_was() {
    for (rest_s, gap_s) in [(2.0, 0.0), (40.0, 0.0), (10.0, 3600.0)] {
        let recording = slide_after(rest_s, gap_s);
        let path = navigate(&recording, &Choice::default()).unwrap();
        let from = (rest_s * 100.0) as usize + 150;
        assert_eq!(path.method, Method::Strapdown);
        if gap_s > 0.0 {
            // How far it went in an hour is not known.
            assert!(!path.points[from].valid);
            continue;
        }
        assert!(path.origin > from - 100 && path.origin < from + 60, "{}", path.origin);
        let moving = &path.points[from + 20..from + 150];
        assert!(moving.iter().all(|p| p.valid && p.sd_m() < 0.3), "{rest_s}");
        let end = path.points[from + 280].position_m[0] - path.points[path.origin].position_m[0];
        assert!((end - 0.5).abs() < 0.1, "{rest_s}: {end}");
        let (_, below) = path.consistency().unwrap();
        assert!(below > 0.9, "{rest_s}: {below}");
    }
}

#[test]
fn an_outlier_of_one_axis_is_left_out() {
    let whole = slide_after(2.0, 0.0);
    let mut faulty = whole.clone();
    faulty.samples.v[400].force_mps2[0] += 40.0;
    faulty.samples.v[430].rate_rad_s = Some([0.0, 20.0, 0.0].into());
    let [path, expected] =
        [&faulty, &whole].map(|recording| navigate(recording, &Choice::default()).unwrap());
    assert!(said(&path, "departs") && !said(&expected, "departs"));
    assert_eq!(path.points.len(), whole.samples.len());
    let end = |path: &InertialPath| path.points[path.points.len() - 1].position_m[0];
    assert!((end(&path) - end(&expected)).abs() < 0.01, "{} {}", end(&path), end(&expected));
}

#[test]
fn a_bias_of_the_gyroscope_that_hides_every_rest_is_taken_off() {
    let whole = slide_after(2.0, 0.0);
    let mut biased = whole.clone();
    for rate in biased.samples.v.iter_mut().filter_map(|sample| sample.rate_rad_s.as_mut()) {
        *rate += nalgebra::Vector3::new(0.15, 0.0, -0.05);
    }
    let [path, expected] =
        [&biased, &whole].map(|recording| navigate(recording, &Choice::default()).unwrap());
    assert!(said(&path, "taken off as its bias") && !said(&expected, "its bias"));
    let end = |path: &InertialPath| path.points[path.points.len() - 1];
    assert!((end(&path).position_m[0] - end(&expected).position_m[0]).abs() < 0.01);
    assert!(end(&path).valid);
}

#[test]
fn a_sensor_that_freezes_in_its_first_second_is_left_out() {
    let (mut frozen, mut random) = (slide_after(2.0, 0.0), wimu_testkit::Random::new(1));
    for sample in &mut frozen.samples.v {
        sample.force_mps2 += nalgebra::Vector3::from(random.normals(0.02));
    }
    let last = frozen.samples.v[60];
    frozen.samples.v[61..].fill(last);
    let path = navigate(&frozen, &Choice::default()).unwrap();
    assert!(said(&path, "gives one and the same value"), "{:?}", path.findings);
    assert!(path.points[200..].iter().all(|point| !point.valid));
}

#[test]
fn a_slide_is_not_taken_for_a_foot() {
    let choice = Choice { profile: Profile::Foot, ..Choice::default() };
    let path = navigate(&slide_after(2.0, 0.0), &choice).unwrap();
    assert!(said(&path, "no foot swings"));
    let last = path.points[path.points.len() - 1];
    assert!((last.position_m[0] - 0.5).abs() < 3.0 * last.sd_m(), "{last:?}");
}

/// Two rests with a turn of 1 rad about x between, as a gyroscope with its scale times `scale` shows it.
fn turned(scale: f64) -> Imu {
    let mut recording = Imu::default();
    for k in 0..600_u32 {
        let t = f64::from(k) * 0.01;
        let tau = (t - 2.5).clamp(0.0, 1.0);
        let angle = tau * tau * (3.0 - 2.0 * tau);
        let rate = 6.0 * tau * (1.0 - tau);
        let noise = f64::from((k * 7919) % 13) * 0.003 - 0.018;
        let force = [noise, 9.80665 * angle.sin() - noise, 9.80665 * angle.cos() + noise];
        let rate = [scale * rate + 0.1 * noise, 0.1 * noise, -0.1 * noise];
        let sample =
            Sample { force_mps2: force.into(), rate_rad_s: Some(rate.into()), ..Sample::default() };
        recording.push(Ns::from_s(t), sample);
    }
    recording
}

#[test]
fn a_gyroscope_that_contradicts_gravity_is_not_used_and_reported() {
    let right = navigate(&turned(1.0), &Choice::default()).unwrap();
    assert_eq!(right.method, Method::Strapdown);
    assert!(!said(&right, "gravity's rotation"), "{:?}", right.findings);
    for (scale, says) in [(-1.0, "signs reversed"), (0.3, "hardly follows")] {
        let wrong = navigate(&turned(scale), &Choice::default()).unwrap();
        assert_eq!(wrong.method, Method::Tilt);
        assert!(said(&wrong, says), "{:?}", wrong.findings);
    }
    let degrees = navigate(&turned(180.0 / std::f64::consts::PI), &Choice::default());
    assert!(degrees.unwrap_err().remedy.contains("deg/s"));
}

/// Turns about the vertical for `lasts_s` with the rate rising and falling in `ramp_s`, at `radius_m` from the axis,
/// twice, with rests between; the gyroscope's rate times `scale`. The field is turned by a room, or not.
fn level(radius_m: f64, rate: f64, lasts_s: f64, scale: f64, turned_rad: f64) -> Imu {
    let mut recording = Imu::default();
    let ramp_s = 0.4;
    let mut heading = 0.0;
    let count = ((2.0 + 2.0 * (lasts_s + 2.0)) * 100.0) as u32;
    for k in 0..count {
        let t = f64::from(k) * 0.01;
        let own = (t - 2.0).rem_euclid(lasts_s + 2.0);
        let smooth = |x: f64| {
            let x = x.clamp(0.0, 1.0);
            (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x))
        };
        let (mut w, mut dw) = (0.0, 0.0);
        if t > 2.0 {
            let (up, rising) = smooth(own / ramp_s);
            let (down, falling) = smooth((own - lasts_s + ramp_s) / ramp_s);
            w = rate * (up - down);
            dw = rate * (rising - falling) / ramp_s;
        }
        heading += w * 0.01;
        let noise = |salt: u32| f64::from((k * 7919 + salt) % 13) - 6.0;
        // Each turn, the room turns the field more.
        let field = heading - turned_rad * (t / (lasts_s + 2.0)).floor();
        let [x, y] = [radius_m * dw + 0.003 * noise(1), radius_m * w * w + 0.003 * noise(5)];
        let rate = [0.01, 0.0, scale * w - 0.01];
        let rate = [2, 3, 4].map(|k| rate[k as usize - 2] + 0.0003 * noise(k));
        let sample = Sample {
            step_s: 0.0,
            force_mps2: [x, y, 9.80665 + 0.003 * noise(9)].into(),
            field_ut: Some([20.0 * field.sin(), 20.0 * field.cos(), -40.0].into()),
            rate_rad_s: Some(rate.into()),
        };
        recording.push(Ns::from_s(t), sample);
    }
    recording
}

#[test]
fn a_rotation_about_the_vertical_keeps_its_gyroscope() {
    let quarter = std::f64::consts::FRAC_PI_2;
    for (name, recording) in [
        ("on the spot", level(0.0, quarter / 1.1, 1.5, 1.0, 0.0)),
        ("in a circle", level(1.5, 1.0, 8.0, 1.0, 0.0)),
        ("in a room", level(0.0, quarter / 1.1, 1.5, 1.0, 1.0)),
        // Gravity does not show it, and the field alone is no witness.
        ("reversed", level(0.0, quarter / 1.1, 1.5, -1.0, 0.0)),
    ] {
        let path = navigate(&recording, &Choice::default()).unwrap();
        assert_eq!(path.method, Method::Strapdown, "{name}: {:?}", path.findings);
        assert!(!said(&path, "gravity's rotation"), "{name}: {:?}", path.findings);
    }
}

#[test]
fn an_accelerometer_that_gives_gravity_and_times_in_another_unit_are_said() {
    let mut down = slide();
    for sample in &mut down.samples.v {
        sample.force_mps2 = sample.force_mps2.map(|f| -f);
        sample.field_ut = Some([0.0, 20.0, -44.0].into());
    }
    let path = navigate(&down, &Choice::default()).unwrap();
    assert!(
        said(&path, "z axis points down") && said(&path, "field points up"),
        "{:?}",
        path.findings
    );
    for (factor, unit) in [(1e3, "Time (ms)"), (1e6, "Time (us)"), (1e-3, "unit of its times")] {
        let mut other = slide();
        for (time, sample) in other.samples.t.iter_mut().zip(&mut other.samples.v) {
            *time = Ns::from_s(time.s() * factor);
            sample.step_s *= factor;
        }
        let refused = navigate(&other, &Choice::default()).unwrap_err();
        assert_eq!(refused.code, Code::DataRefused);
        assert!(refused.remedy.contains(unit), "{refused:?}");
    }
}

#[test]
fn a_bias_of_the_vertical_is_not_taken_for_gravity() {
    let mut recording = turned(1.0);
    for sample in &mut recording.samples.v {
        sample.force_mps2[2] += 0.07;
    }
    assert_eq!(recording.gravity_mps2(), 9.80665);
    let path = navigate(&recording, &Choice::default()).unwrap();
    // It turned on the spot.
    for point in &path.points[path.origin..] {
        let off = point.position_m.iter().map(|p| p * p).sum::<f64>().sqrt();
        assert!(off < 3.0 * point.sd_m().max(0.003), "{point:?}");
    }
    // One that is not calibrated shows its own.
    for sample in &mut recording.samples.v {
        sample.force_mps2 = sample.force_mps2.map(|f| 1.05 * f);
    }
    assert!(recording.gravity_mps2() > 10.2);
}

#[test]
fn a_straight_move_without_a_gyroscope_is_as_long_as_it_was() {
    let path = navigate(&slide(), &Choice::default()).unwrap();
    assert_eq!((path.points.len(), path.method), (450, Method::Tilt));
    let [one] = path.moves[..] else {
        panic!("{:?}", path.moves);
    };
    assert!(one.valid && one.length_sd_m < 0.05, "{one:?}");
    assert!((one.length_m - 0.5).abs() < 2.0 * one.length_sd_m, "{one:?}");
    // The same with a tilt of 3 degrees at its end: it was rotated.
    let mut tilted = slide();
    for sample in &mut tilted.samples.v[300..] {
        sample.force_mps2[1] += 9.80665 * 3_f64.to_radians();
    }
    let path = navigate(&tilted, &Choice::default()).unwrap();
    assert!(path.moves.iter().all(|one| !one.valid), "{:?}", path.moves);
}

#[test]
fn constant_velocity_between_two_accelerations_is_not_taken_for_a_rest() {
    // After 5 s of rest 0.2 m/s for 3 s, as quiet as a rest: 0.66 m.
    let recording = slide();
    let rest = |k: usize| f64::from((k as u32 * 7919) % 13) * 0.003 - 0.018;
    let mut constant = Imu::new("constant");
    for k in 0..1050 {
        let push = match k {
            500..530 => 0.2 / 0.3,
            830..860 => -0.2 / 0.3,
            _ => 0.0,
        };
        let sample = Sample {
            force_mps2: [push + 0.03 + rest(k), -rest(k), 9.80665 + rest(k)].into(),
            rate_rad_s: Some([0.01 * rest(k), -0.01 * rest(k), 0.01 * rest(k)].into()),
            ..recording.samples.v[0]
        };
        constant.push(Ns::from_s(k as f64 * 0.01), sample);
    }
    let path = navigate(&constant, &Choice::default()).unwrap();
    let end = path.points.last().unwrap();
    assert!(
        (end.position_m[0].hypot(end.position_m[1]) - 0.66).abs() < 3.0 * end.sd_m(),
        "{end:?}"
    );
    assert!(end.sd_m() < 0.3, "{end:?}");
}

#[test]
fn a_start_pose_given_rests_and_a_bounded_place_are_used() {
    let recording = slide_after(2.0, 0.0);
    let with = |change: &dyn Fn(&mut Choice)| {
        let mut choice = Choice::default();
        change(&mut choice);
        navigate(&recording, &choice).unwrap()
    };
    let start = StartPose { position_m: [3.0, -2.0, 1.0], heading_rad: Some(1.0) };
    let placed = with(&|choice| choice.start = Some(start));
    let first = placed.points[100];
    for (value, expected) in first.position_m.iter().zip([3.0, -2.0, 1.0]) {
        assert!((value - expected).abs() < 0.01, "{first:?}");
    }
    let free = with(&|choice| choice.zupt = Zupt::Off);
    let within = with(&|choice| {
        choice.zupt = Zupt::Off;
        choice.within_m = Some(0.2);
    });
    let last = |path: &InertialPath| path.points.last().unwrap().sd_m();
    assert!(
        last(&within) < 0.5 * last(&free) && last(&within) < 0.5,
        "{} {}",
        last(&within),
        last(&free)
    );
    let given = with(&|choice| choice.rests_s = Some(vec![0.0..=1.0]));
    assert_eq!(given.rests().rests, 1);
    let cautious = with(&|choice| choice.zupt = Zupt::Assumed);
    assert!(last(&cautious) > 1.5 * last(&with(&|_| {})));
}

#[test]
fn the_path_is_written_with_the_columns_that_were_promised() {
    let path = navigate(&slide(), &Choice::default()).unwrap();
    let out = file("");
    path.write_csv(&out).unwrap();
    let text = std::fs::read_to_string(&out).unwrap();
    assert_eq!(
        text.lines().next().unwrap(),
        "Time (s),Position E (m),Position N (m),Position U (m),Velocity E (m/s),Velocity N (m/s),\
         Velocity U (m/s),Quaternion W,Quaternion X,Quaternion Y,Quaternion Z,\
         Angular Rate X (rad/s),Angular Rate Y (rad/s),Angular Rate Z (rad/s),\
         Sigma E (m),Sigma N (m),Sigma U (m),Valid"
    );
    assert_eq!(text.lines().count(), 451);
    path.page("slide", "text", &Aids::default()).write(&out).unwrap();
    assert!(std::fs::read_to_string(&out).unwrap().contains("<svg"));
}

#[test]
fn past_the_limit_the_position_is_marked_unusable() {
    let mut recording = slide();
    let rest = recording.samples.v[0];
    for k in 0..3000 {
        recording.push(Ns::from_s(4.5 + f64::from(k) * 0.01), rest);
    }
    let choice = Choice { zupt: Zupt::Off, limit_m: 0.3, ..Choice::default() };
    let path = navigate(&recording, &choice).unwrap();
    let horizon = path.horizon_s(0.3).expect("without ZUPT it gets lost");
    assert!(path.horizon_s(0.1).unwrap() < horizon && path.horizon_s(1e6).is_none());
    for point in &path.points {
        assert!(!point.valid || point.sd_m() <= 0.3);
    }
    assert!(!path.points.last().unwrap().valid);
}

#[test]
fn what_a_file_does_not_support_is_refused() {
    let mut recording = slide();
    for sample in &mut recording.samples.v {
        sample.force_mps2 = sample.force_mps2.map(|f| 0.5 * f);
    }
    let refused = navigate(&recording, &Choice::default()).unwrap_err();
    assert_eq!(refused.code, Code::DataRefused);

    let head = "Time (s),Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)";
    let counts = file(&format!("{head}\n0,1,2,3\n1,1,2,3\n"));
    let refused = read(&counts).unwrap_err();
    assert_eq!(refused.code, Code::UnknownFormat);
    let refused = Array::read(&counts, &ReadOptions::default(), None).unwrap_err();
    assert_eq!(refused.code, Code::Usage);
}

/// An array at rest in one attitude.
fn still_array(sensors: usize) -> Array {
    let mut recording = Array::default();
    for k in 0..400_usize {
        let noise = |s: usize| ((k * 31 + s * 17) % 11) as f64 * 0.004 - 0.02;
        let sample = (0..sensors).map(|s| [noise(s), -noise(s + 3), 9.8 + noise(s + 5)]);
        push(&mut recording, k as f64 * 0.01, sample);
    }
    recording
}

#[test]
fn places_are_read_in_both_forms_and_must_fit_the_recording() {
    let rows = file("X (m),Y (m),Z (m)\n0.01,0,0\n0,0.01,0\n0,0,0.01\n0,0,0\n");
    let table =
        "axes, IMU 1, IMU 2, IMU 3, IMU 4\nx, 0.01, 0, 0, 0\ny, 0, 0.01, 0, 0\nz, 0, 0, 0.01, 0\n";
    let columns = file(table);
    let places = ArrayGeometry::read(&rows).unwrap();
    assert_eq!(places, ArrayGeometry::read(&columns).unwrap());
    assert_eq!(places.sensors.len(), 4);
    let bad = file("X (m),Y (m),Z (m)\n0.01,zero,0\n");
    let error = ArrayGeometry::read(&bad).unwrap_err();
    assert!(error.code == Code::CsvBadNumber && error.to_string().contains("line 2"));

    let recording = still_array(4);
    let calibration = ArrayCalibration::of(&recording, &places, Gravity::UNKNOWN_PLACE).unwrap();
    assert!(calibration.uncalibrated.is_some(), "one pose is not enough to calibrate");
    let refused = |wrong: &ArrayGeometry| {
        let error = ArrayBody::of(&recording, wrong, &calibration)
            .and_then(|body| body.navigated(9.80665, Zupt::Stated))
            .unwrap_err();
        error.to_string()
    };
    assert!(
        refused(&ArrayGeometry::new(places.sensors[..3].to_vec()))
            .contains("the geometry has 3 sensors, the recording 4")
    );
    assert!(
        refused(&ArrayGeometry::at(&[[0.01, 0.0, 0.0]; 4]))
            .contains("all sensors have one position")
    );
    assert!(
        ArrayBody::of(&recording, &places, &calibration)
            .and_then(|body| body.navigated(9.80665, Zupt::Stated))
            .is_ok()
    );
}
