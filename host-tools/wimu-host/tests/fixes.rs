//! Fixes of position, velocity and heading beside a unit on a known path.

use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::aids::Mounting;
use wimu_host::inertial::aids::heading::HEADING as HEADING_FIX;
use wimu_host::inertial::aids::position::POSITION;
use wimu_host::inertial::aids::velocity::VELOCITY;
use wimu_host::inertial::{Aid, Aids, Choice, InertialPath, LeastDelay, Live, PathPoint, navigate};
use wimu_host::series::Ns;
use wimu_testkit::Random;

const RATE_HZ: f64 = 100.0;
/// The path closes then.
const LENGTH_S: f64 = 2.0 + 8.0 * std::f64::consts::PI / 0.7;
const GRAVITY: f64 = 9.80665;
/// Heading at the start in the frame of the fixes, rad.
const HEADING: f64 = 1.2;

/// Heading, position, velocity and acceleration: two seconds at rest, then a figure of 4 m by 2 m.
fn truth(t: f64) -> (f64, [[f64; 2]; 3]) {
    let t = (t - 2.0).max(0.0);
    // Smooth at the start.
    let (w, s) = (0.7, 1.0 - (-t).exp() * (1.0 + t));
    let p = |t: f64| {
        let s = 1.0 - (-t).exp() * (1.0 + t);
        [4.0 * (w * t).sin() * s, 2.0 * (1.0 - (2.0 * w * t).cos()) * s]
    };
    let h = 1e-3;
    let [a, b, c] = [p((t - h).max(0.0)), p(t), p(t + h)];
    let v = [0, 1].map(|k| (c[k] - a[k]) / (t + h - (t - h).max(0.0)));
    let f = [0, 1].map(|k| if t > h { (c[k] - 2.0 * b[k] + a[k]) / (h * h) } else { 0.0 });
    (HEADING + 0.8 * (0.5 * t).sin() * s, [b, v, f])
}

/// The recording, and a fix each second at the antenna `arm_m` before the unit, `late_s` after its measurement.
fn recorded(arm_m: f64, late_s: f64) -> (Imu, Vec<Aid>) {
    let mut random = Random::new(5);
    let (mut recording, mut fixes) = (Imu::new("simulated"), Vec::new());
    for k in 0..(LENGTH_S * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ;
        let (heading, [_, _, a]) = truth(t);
        let rate = (truth(t + 1e-4).0 - truth(t - 1e-4).0) / 2e-4;
        let (sin, cos) = heading.sin_cos();
        let noise = random.normals(0.02);
        let force = [cos * a[0] + sin * a[1], cos * a[1] - sin * a[0], GRAVITY];
        let turn = random.normals(0.002);
        let sample = Sample {
            force_mps2: [0, 1, 2].map(|i| force[i] + noise[i]).into(),
            rate_rad_s: Some([turn[0], turn[1], rate + turn[2]].into()),
            ..Sample::default()
        };
        recording.push(Ns::from_s(t), sample);
        if k % 100 == 50 && k < 3750 {
            let (heading, [p, ..]) = truth(t);
            let noise = random.normals(0.05);
            let at =
                [100.0 + p[0] + arm_m * heading.cos(), -50.0 + p[1] + arm_m * heading.sin(), 7.0];
            fixes.push(fix(t + late_s, [0, 1, 2].map(|i| at[i] + noise[i])));
        }
    }
    (recording, fixes)
}

fn fix(time_s: f64, position_m: [f64; 3]) -> Aid {
    Aid::of(&POSITION, time_s, &position_m, 0.05)
}

fn aided(fixes: Vec<Aid>, arm_m: f64) -> Choice {
    let lever_arm_m = [arm_m, 0.0, 0.0];
    let aids = fixes.into_iter().map(|fix| Aid { lever_arm_m, ..fix }).collect();
    Choice { aids: Aids { aids, ..Aids::default() }, ..Choice::default() }
}

/// Largest error of the position after the first ten seconds, m.
fn error_m(path: &InertialPath) -> f64 {
    let late = path.points.iter().filter(|p| p.time_s > 10.0);
    let off = late.map(|point| {
        let (_, [p, ..]) = truth(point.time_s);
        let [e, n, u] = point.position_m;
        (e - 100.0 - p[0]).hypot(n + 50.0 - p[1]).hypot(u - 7.0)
    });
    off.fold(0.0, f64::max)
}

fn says(path: &InertialPath, text: &str) -> bool {
    path.findings.iter().any(|f| f.text.contains(text))
}

#[test]
fn the_path_is_in_the_frame_of_the_fixes() {
    let (recording, fixes) = recorded(0.0, 0.0);
    for smooth in [true, false] {
        let choice = Choice { smooth, ..aided(fixes.clone(), 0.0) };
        let path = navigate(&recording, &choice).unwrap();
        let off = error_m(&path);
        println!("{off}");
        assert!(off < 0.4, "{off}");
        let sd = path.points[3000].sd_m();
        assert!((0.01..0.2).contains(&sd), "{sd}");
        assert!(!says(&path, "contradict"), "{:?}", path.findings);
    }
}

#[test]
fn fixes_by_another_clock_are_refused_with_both_times() {
    let (recording, mut fixes) = recorded(0.0, 0.0);
    let mut refused = |offset_s: f64| {
        fixes.iter_mut().for_each(|fix| fix.time_s += offset_s);
        let refused = navigate(&recording, &aided(fixes.clone(), 0.0));
        refused.unwrap_err().to_string()
    };
    let text = refused(1e4);
    assert!(
        text.contains("none of the fixes is within the time") && text.contains("fixes from 100"),
        "{text}"
    );
    assert!(!text.contains("Unix"), "{text}");
    let text = refused(1.7e9);
    assert!(text.contains("the fixes have Unix times"), "{text}");
}

#[test]
fn a_fix_that_contradicts_the_path_is_reported_drawn_and_not_used() {
    let (recording, mut fixes) = recorded(0.0, 0.0);
    fixes[20].value[0] += 9.0;
    let choice = aided(fixes, 0.0);
    let path = navigate(&recording, &choice).unwrap();
    assert!(says(&path, "1 of 37 fixes rejected"), "{:?}", path.findings);
    // The report draws it apart from the others.
    let page = tempfile::NamedTempFile::new().unwrap();
    path.page("walk", "text", &choice.aids).write(page.path()).unwrap();
    let page = std::fs::read_to_string(page.path()).unwrap();
    assert!(page.contains("\"fix\"") && page.contains("\"rejected fix\""));
    assert!(!says(&path, "jumps"), "{:?}", path.findings);
    assert!(error_m(&path) < 0.5, "{}", error_m(&path));
}

#[test]
fn fixes_that_go_on_contradicting_are_followed_with_a_finding() {
    let (recording, mut fixes) = recorded(0.0, 0.0);
    for fix in &mut fixes[20..] {
        fix.value[0] += 30.0;
    }
    let path = navigate(&recording, &aided(fixes, 0.0)).unwrap();
    assert!(
        says(&path, "5 fixes in succession contradicted the path, 1 time"),
        "{:?}",
        path.findings
    );
    // Where the path was when the fixes began to contradict it is not known.
    let wrong = path.points.iter().filter(|point| (20.0..25.0).contains(&point.time_s));
    assert!(wrong.clone().count() > 400 && wrong.clone().all(|point| !point.valid));
    let end = path.points[path.points.len() - 1];
    let (_, [p, ..]) = truth(end.time_s);
    assert!(end.valid && (end.position_m[0] - 130.0 - p[0]).abs() < 1.0, "{end:?}");
}

#[test]
fn fixes_without_a_position_give_the_frame_of_what_they_measure() {
    let (recording, _) = recorded(0.0, 0.0);
    let end = |aid: &dyn Fn(f64) -> Aid| {
        let aids = (1..37).map(|k| aid(f64::from(k))).collect();
        let path = navigate(&recording, &aided(aids, 0.0)).unwrap();
        assert!(path.aids.values().all(|used| used.used == 36), "{:?}", path.aids);
        path.points[path.points.len() - 1]
    };
    let (heading, [[east, north], ..]) = truth(LENGTH_S);
    let found = end(&|t| Aid::of(&HEADING_FIX, t, &[truth(t).0], 0.05));
    let [w, _, _, z] = found.quaternion;
    let off = 2.0 * z.atan2(w) - heading;
    assert!(off.sin().abs() < 0.1 && off.cos() > 0.0, "{off}");
    let found = end(&|t| {
        let [e, n] = truth(t).1[1];
        Aid::of(&VELOCITY, t, &[e, n, 0.0], 0.1)
    });
    let [e, n, _] = found.position_m;
    assert!((e - east).hypot(n - north) < 0.5, "{found:?}");
    let found =
        end(&|t| Aid { sd: [f64::INFINITY, f64::INFINITY, 0.1], ..fix(t, [0.0, 0.0, 7.0]) });
    assert!((found.position_m[2] - 7.0).abs() < 0.3, "{found:?}");
}

#[test]
fn a_magnetometer_with_a_wrong_axis_is_not_used() {
    let (mut recording, _) = recorded(0.0, 0.0);
    for (sample, time) in recording.samples.v.iter_mut().zip(&recording.samples.t) {
        let (sin, cos) = truth(time.s()).0.sin_cos();
        sample.field_ut = Some([20.0 * sin, -20.0 * cos, -40.0].into());
    }
    let path = navigate(&recording, &Choice::default()).unwrap();
    assert!(says(&path, "it is not used"), "{:?}", path.findings);
    // Body x is east at the start.
    let [w, .., z] = path.points[100].quaternion;
    assert!((2.0 * z.atan2(w)).abs() < 0.02);
}

#[test]
fn lever_arm_and_delay_are_taken_into_account() {
    let (recording, fixes) = recorded(1.5, 0.4);
    let shifted = fixes.iter().map(|fix| Aid { time_s: fix.time_s - 0.4, ..*fix });
    let known = navigate(&recording, &aided(shifted.collect(), 1.5)).unwrap();
    assert!(error_m(&known) < 0.4, "{}", error_m(&known));
    let unknown = navigate(&recording, &aided(fixes, 0.0)).unwrap();
    assert!(error_m(&unknown) > 0.5, "{}", error_m(&unknown));
}

#[test]
fn a_path_that_closes_ends_at_its_start() {
    let (recording, _) = recorded(0.0, 0.0);
    let open = navigate(&recording, &Choice::default()).unwrap();
    let choice = Choice { loop_m: Some(0.1), ..Choice::default() };
    let closed = navigate(&recording, &choice).unwrap();
    let far = |path: &InertialPath| {
        let end = path.points[path.points.len() - 1].position_m;
        end.iter().map(|p| p * p).sum::<f64>().sqrt()
    };
    assert!(far(&open) > 0.5, "{}", far(&open));
    assert!(far(&closed) < 0.1, "{}", far(&closed));
}

#[test]
fn a_table_of_fixes_may_leave_out_columns_and_values() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fixes.csv");
    let text =
        "Time (ms),Height (cm),Height Sigma (cm),Heading (deg)\n500,200,10,\n1500,,,90\n2500,,,\n";
    std::fs::write(&file, text).unwrap();
    let late = Mounting { delay_s: 0.25, ..Mounting::default() };
    let read = Aids::read(&file, &late).unwrap();
    let [height, heading] = read.aids[..] else {
        panic!("{read:?}");
    };
    assert_eq!((height.kind.name, height.time_s, height.value[2]), ("position", 0.25, 2.0));
    assert!(height.sd[0].is_infinite() && (height.sd[2] - 0.1).abs() < 1e-12);
    assert_eq!(heading.kind.name, "heading");
    assert!((heading.value[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    std::fs::write(&file, "Time (s),Depth (m)\n1,2\n").unwrap();
    let refused = Aids::read(&file, &Mounting::default()).unwrap_err();
    assert!(refused.to_string().contains("no column is a measurement"), "{refused}");
    std::fs::write(&file, "Time (s),Velocity E (m/s)\n1,2\n").unwrap();
    let read = Aids::read(&file, &Mounting::default()).unwrap();
    assert!(read.aids[0].sd[0].is_finite() && read.aids[0].sd[1].is_infinite(), "{read:?}");
}

#[test]
fn what_of_a_table_of_fixes_is_not_used_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fixes.csv");
    let noticed = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let read = Aids::read(&file, &Mounting::default()).unwrap();
        let texts: Vec<String> = read.findings.iter().map(ToString::to_string).collect();
        texts.join("\n")
    };
    let sigma = "Position Sigma E (m),Position Sigma N (m)";
    let header = format!("Time (s),Position E (m),Position N (m),{sigma}");
    assert_eq!(noticed(&format!("{header}\n1,2,3,0.1,0.1\n")), "");
    let text = noticed(&format!("{header}\n1,2,3,0,-1\n2,2,3,0.1,0.1\n"));
    assert!(text.contains("2 standard deviations of the fixes are not positive"), "{text}");
    let text = noticed("Time (s),East,Position N (m)\n1,2,3\n");
    for part in ["not used: East", "have only one", "no standard deviation: 3 m"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn a_path_that_its_fixes_cannot_hold_to_the_limit_is_refused_with_their_sigma() {
    let (recording, mut fixes) = recorded(0.0, 0.0);
    fixes.iter_mut().for_each(|fix| fix.sd = [30.0; 3]);
    let refused = navigate(&recording, &aided(fixes, 0.0)).unwrap_err();
    assert!(refused.remedy.contains("the fixes are ± 52 m"), "{refused} {}", refused.remedy);
}

/// The recording as a stream: each fix arrives `late_s` after its time. The answer at each tenth sample.
fn streamed(live: &mut Live, late_s: f64, arm_m: f64) -> Vec<PathPoint> {
    let (recording, fixes) = recorded(arm_m, 0.0);
    let lever_arm_m = [arm_m, 0.0, 0.0];
    let mut fixes = fixes.into_iter().map(|fix| Aid { lever_arm_m, ..fix }).peekable();
    let mut points = Vec::new();
    for (k, sample) in recording.samples.v.iter().enumerate() {
        let time_s = recording.samples.t[k].s();
        while let Some(fix) = fixes.next_if(|fix| fix.time_s + late_s <= time_s) {
            live.aid(fix);
        }
        live.push(time_s, *sample).unwrap();
        if k % 10 == 9 {
            points.extend(live.now());
        }
    }
    points
}

#[test]
fn a_stream_has_the_path_of_its_recording_though_fixes_are_late() {
    let (recording, fixes) = recorded(0.5, 0.0);
    let choice = Choice { smooth: false, ..aided(fixes, 0.5) };
    let path = navigate(&recording, &choice).unwrap();
    let begun = Choice::default();
    let off = |late_s: f64, delay_s: f64| {
        let mut live = Live::new(begun.clone(), Imu::default(), delay_s);
        let points = streamed(&mut live, late_s, 0.5);
        assert!(points.iter().all(|p| p.time_s > 2.9), "{:?}", points[0]);
        // The heading is decided.
        let decided = points.iter().filter(|p| p.time_s > 15.0);
        let apart = decided.map(|point| {
            assert!(point.valid, "{point:?}");
            let same = &path.points[(point.time_s * RATE_HZ).round() as usize];
            let [e, n, u] = [0, 1, 2].map(|i| point.position_m[i] - same.position_m[i]);
            e.hypot(n).hypot(u)
        });
        (apart.fold(0.0, f64::max), live.findings())
    };
    let (far, findings) = off(0.0, 0.0);
    println!("{far}");
    assert!(far < 0.15, "{far}");
    assert_eq!(findings.iter().filter(|f| f.text.contains("frame of the fixes")).count(), 1);
    // Each answer is up to 2.5 s from the last fix.
    let (far, _) = off(1.5, 1.6);
    println!("{far}");
    assert!((0.05..1.0).contains(&far), "{far}");
    let mut live = Live::new(begun, Imu::default(), 0.5);
    streamed(&mut live, 1.5, 0.5);
    // The first three came before the filter began.
    let late = "34 fixes arrived later than the filter waits";
    let found = live.findings();
    assert!(found.iter().any(|f| f.text.contains(late)), "{found:?}");
}

#[test]
fn wrong_fixes_are_counted() {
    let (recording, mut fixes) = recorded(0.0, 0.0);
    for k in [12, 20, 30] {
        fixes[k].value[k % 2] += 30.0;
    }
    let path = navigate(&recording, &aided(fixes, 0.0)).unwrap();
    assert!(says(&path, "3 of 37 fixes"), "{:?}", path.findings);
}

#[test]
fn a_magnet_near_the_unit_is_reported() {
    let (mut recording, fixes) = recorded(0.0, 0.0);
    for (sample, time) in recording.samples.v.iter_mut().zip(&recording.samples.t) {
        let (sin, cos) = truth(time.s()).0.sin_cos();
        sample.field_ut = Some([20.0 * sin, 20.0 * cos, -40.0].into());
    }
    let magnet = "the magnetic field contradicted";
    let path = navigate(&recording, &aided(fixes.clone(), 0.0)).unwrap();
    assert!(!says(&path, magnet), "{:?}", path.findings);
    for (sample, time) in recording.samples.v.iter_mut().zip(&recording.samples.t) {
        if (10.0..25.0).contains(&time.s())
            && let Some(field) = &mut sample.field_ut
        {
            field[0] += 80.0;
        }
    }
    let path = navigate(&recording, &aided(fixes, 0.0)).unwrap();
    assert!(says(&path, magnet), "{:?}", path.findings);
    assert!(error_m(&path) < 0.5, "{}", error_m(&path));
}

#[test]
fn the_offset_of_a_clock_is_that_of_the_least_delayed_of_the_last_two_minutes() {
    let mut clock = LeastDelay::default();
    assert_eq!(clock.offset_s(), None);
    // The other clock is 1000 s ahead, and gains 1 ms a second.
    for k in 0..600 {
        let arrived_s = f64::from(k);
        let delay_s = f64::from((k * 7) % 10) * 0.02;
        clock.see((arrived_s - delay_s) * 1.001 + 1000.0, arrived_s);
    }
    let offset_s = clock.offset_s().unwrap();
    assert!((1000.48..1000.6).contains(&offset_s), "{offset_s}");
}

/// Height of a lift that stands for ten seconds and then goes up and down, m.
fn height_m(time_s: f64) -> f64 {
    3.0 * (1.0 - (time_s - 10.0).max(0.0).cos())
}

/// A unit in the lift, whose accelerometer has a bias.
fn lifted() -> Imu {
    let mut random = Random::new(7);
    let mut recording = Imu::new("lift");
    for k in 0..6000_u32 {
        let above_s = f64::from(k) * 0.01 - 10.0;
        let up = if above_s > 0.0 { 3.0 * above_s.cos() } else { 0.0 };
        let noise = random.normals(0.02);
        let rate_rad_s = Some(random.normals(0.001).into());
        let force_mps2 = [noise[0], noise[1], GRAVITY + up + 0.03 + noise[2]].into();
        let sample = Sample { force_mps2, rate_rad_s, ..Sample::default() };
        recording.push(Ns::from_s(f64::from(k) * 0.01), sample);
    }
    recording
}

#[test]
fn a_barometer_is_a_table_with_pressures_and_finds_the_height_of_the_origin() {
    let recording = lifted();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pressure.csv");
    let rows = (0..600).map(|k| {
        let time_s = f64::from(k) * 0.1;
        let above_m = 1000.0 + height_m(time_s);
        let hpa = 1013.25 * (1.0 - above_m / 44_330.8_f64).powf(5.255_88);
        format!("{time_s},{hpa}\n")
    });
    let text = format!("Time (s),Pressure (hPa)\n{}", rows.collect::<String>());
    std::fs::write(&file, text).unwrap();
    let aids = Aids::read(&file, &Mounting::default()).unwrap();
    let alone = Choice { limit_m: f64::INFINITY, ..Choice::default() };
    let path = navigate(&recording, &Choice { aids, ..alone.clone() }).unwrap();
    let end = path.points[5500];
    let sd = end.sigma_m()[2];
    assert!((end.position_m[2] - height_m(55.0)).abs() < 3.0 * sd && sd < 1.5, "{end:?}");
    let without = navigate(&recording, &alone).unwrap().points[5500].sigma_m()[2];
    assert!(without > 3.0 * sd, "{without} {sd}");
    let origin = &path.states[0];
    assert_eq!(origin.name, "pressure height of the origin");
    assert!((origin.value - 1000.0).abs() < 3.0, "{origin:?}");
    let found = path.aids["pressure"];
    assert!(found.used > 590, "{found:?}");
    assert!(path.residuals.iter().all(|residual| residual.aid == "pressure"));
}

#[test]
fn a_fix_whose_time_is_uncertain_is_worth_less_in_motion() {
    let (recording, fixes) = recorded(0.0, 0.0);
    let sd_m = |time_sd_s: f64| {
        let fixes = fixes.iter().map(|fix| Aid { time_sd_s, ..*fix }).collect();
        let choice = Choice { smooth: false, ..aided(fixes, 0.0) };
        navigate(&recording, &choice).unwrap().points[3000].sd_m()
    };
    assert!(sd_m(0.2) > 1.5 * sd_m(0.0), "{} {}", sd_m(0.2), sd_m(0.0));
}
