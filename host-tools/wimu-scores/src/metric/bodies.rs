//! Arrays, joints, cameras.

use nalgebra::{Quaternion, SMatrix, UnitQuaternion, Vector3, Vector6};
use serde_json::from_value;

use crate::case::Case;
use crate::command::{Point, at, error_at, run};
use crate::manifest::Source;
use crate::score::{Score, rms};
use crate::table::{Result, Table, XYZ};

/// mimu4444: sensors, counts of a gyroscope at 1 deg/s, counts at which a sensor clips, samples of the first rest.
const UNITS: usize = 8;
const COUNTS: f64 = 16.4;
const CLIPPED: f64 = 32_760.0;
const REST: usize = 300;
/// The array moves above this, rad/s.
const MOVING_RAD_S: f64 = 1.0;
/// Seconds at both ends of a joint's truth in which it disagrees with the gyroscopes, and time constant of the complementary
/// filter, s.
const ENDS_S: [f64; 2] = [5.0, 4.0];
const COMPLEMENTARY_S: f64 = 2.0;
/// 95 % points of χ² with three and six degrees of freedom.
const CHI_SQUARE_95: [f64; 2] = [7.815, 12.592];
/// Variance of a translation that the motion does not show, m².
const UNKNOWN_M2: f64 = 1e6;

/// Against the mean of the gyroscopes, which the command does not get. Samples beside a clipped one are left out.
pub fn rate(case: &Case, source: Source) -> Result<Score> {
    let recording = Table::read(&case.data.join(case.recording))?;
    let times = recording.times()?;
    let mut truth = vec![Vector3::zeros(); times.len()];
    let mut clips = vec![false; times.len()];
    for unit in 0..UNITS {
        let gyroscope = recording.vectors(&format!("Gyroscope {unit} # (LSB)"), XYZ)?;
        let accelerometer = recording.vectors(&format!("Accelerometer {unit} # (LSB)"), XYZ)?;
        for k in 0..times.len() {
            truth[k] += (gyroscope[k] / COUNTS / UNITS as f64).map(f64::to_radians);
            clips[k] |= gyroscope[k].amax().max(accelerometer[k].amax()) >= CLIPPED;
        }
    }
    let bias = truth.iter().take(REST).sum::<Vector3<f64>>() / REST as f64;
    let mut score = Score::default();
    let mut points: Vec<Point> = times.iter().map(|t| Point::new(*t, Vector3::zeros())).collect();
    if source == Source::Command {
        let ran = case.navigate(&[case.table(case.recording, source)?], &[], "Angular Rate")?;
        (score.exit, points) = (ran.exit, ran.points);
    }
    let error = |k: usize| {
        let is_near_clipping = clips[k.saturating_sub(1)..(k + 2).min(clips.len())].contains(&true);
        let rate = truth[k] - bias;
        let is_scored = rate.norm() > MOVING_RAD_S && !is_near_clipping;
        // Whether the position is valid says nothing about the rate.
        let error = error_at(&points, times[k], rate).filter(|_| is_scored)?;
        Some(Point { valid: true, ..error })
    };
    let errors: Vec<Point> = (0..times.len()).filter_map(error).collect();
    score.take(&errors, 0.0);
    score.figures = vec![rms(errors.iter().map(|e| e.value.norm() / 3.0_f64.sqrt())).to_degrees()];
    Ok(score)
}

/// Angle about z between two units.
pub fn angle(case: &Case, source: Source) -> Result<Score> {
    let files = [case.recording, case.entry.second.as_deref().ok_or("no second unit")?];
    let truth = |file: &str| -> Result<Vec<Point>> {
        let table = Table::read(&case.data.join(file))?;
        let rows = table.times()?.into_iter().zip(table.attitudes("Truth Quaternion")?);
        let point = |(t, q)| Point { attitude: Some(q), ..Point::new(t, Vector3::zeros()) };
        Ok(rows.map(point).collect())
    };
    let (first, second) = (truth(files[0])?, truth(files[1])?);
    let (a, b) = (case.table(files[0], source)?, case.table(files[1], source)?);
    let (mut score, mut points) = (Score::default(), Vec::new());
    if source == Source::Command {
        let ran = case.navigate(&[a, b], &["--relative"], "Angle")?;
        let along = |p: Point| Point { value: p.value.x * X, sigma: p.sigma.x * X, ..p };
        (score.exit, points) = (ran.exit, ran.points.into_iter().map(along).collect());
    } else {
        let a = inclination(&a)?;
        let between = |b: Point| Some(Point::new(b.time_s, b.value - at(&a, b.time_s)?.value));
        points.extend(inclination(&b)?.into_iter().filter_map(between));
    }
    let (mut last, mut errors) = (0.0, Vec::new());
    for a in &first {
        let other = at(&second, a.time_s).and_then(|b| b.attitude);
        let Some((p, q)) = a.attitude.zip(other) else { continue };
        let between = p.inverse() * q;
        let angle = 2.0 * between.k.atan2(between.w).to_degrees();
        last = angle + 360.0 * ((last - angle) / 360.0_f64).round();
        errors.extend(error_at(&points, a.time_s, last * X));
    }
    let [from_s, until_s] = [errors.first(), errors.last()].map(|e| e.map_or(0.0, |e| e.time_s));
    let core = from_s + ENDS_S[0]..until_s - ENDS_S[1];
    let core = errors.iter().filter(|e| core.contains(&e.time_s)).copied();
    let mut core: Vec<Point> = core.collect();
    for part in [&mut errors, &mut core] {
        // The zero of an angle is a choice.
        let mean = part.iter().map(|e| e.value).sum::<Vector3<f64>>() / part.len() as f64;
        part.iter_mut().for_each(|e| e.value -= mean);
        score.figures.push(rms(part.iter().map(|e| e.value.x)));
    }
    score.take(&core, 0.0);
    Ok(score)
}

const X: Vector3<f64> = Vector3::new(1.0, 0.0, 0.0);

/// Complementary filter of accelerometer and gyroscope about z, deg.
fn inclination(unit: &Table) -> Result<Vec<Point>> {
    let (times, force) = (unit.times()?, unit.vectors("Accelerometer # (m/s²)", XYZ)?);
    let rate = unit.vectors("Gyroscope # (rad/s)", XYZ)?;
    let (mut angle, mut points) = (f64::atan2(-force[0].y, force[0].x), Vec::new());
    for k in 0..times.len() {
        if k > 0 {
            let step_s = times[k] - times[k - 1];
            angle += rate[k - 1].z * step_s;
            angle += step_s / COMPLEMENTARY_S * (f64::atan2(-force[k].y, force[k].x) - angle);
        }
        points.push(Point::new(times[k], angle.to_degrees() * X));
    }
    Ok(points)
}

/// Rotation and translation of a camera from both halves; consistent if they agree within their covariances.
pub fn hand_eye(case: &Case) -> Result<Score> {
    let camera = case.entry.second.as_deref().ok_or("no camera")?;
    let camera = Table::read(&case.data.join(camera))?;
    let times = camera.times()?;
    let middle_s = 0.5 * (times[0] + times[times.len() - 1]);
    let body = case.data.join(case.recording).display().to_string();
    let mut score = Score { samples: 1, consistent: [0, 1], valid: [0, 1], ..Score::default() };
    let mut poses = Vec::new();
    for span_s in [[f64::NEG_INFINITY, middle_s], [middle_s, f64::INFINITY]] {
        let half = case.file("camera.csv", &camera.cut(span_s)?)?;
        let ran = run(&["align", &body, "--camera", &half].map(str::to_owned), case.folder)?;
        score.exit = score.exit.max(ran.exit);
        let value = |key: &str| ran.data[key].clone();
        let Ok([w, x, y, z]) = from_value::<[f64; 4]>(value("quaternion")) else { continue };
        let sds: [f64; 3] = from_value(value("rotation_sd_rad"))?;
        // A motion may show the rotation alone.
        let place: [f64; 3] = from_value(value("translation_m")).unwrap_or_default();
        let variance = |k: usize| if k < 3 { sds[k] * sds[k] } else { UNKNOWN_M2 };
        let rotation = SMatrix::from_diagonal(&Vector6::from_fn(|k, _| variance(k)));
        let covariance = from_value::<[[f64; 6]; 6]>(value("covariance"));
        let covariance: SMatrix<f64, 6, 6> =
            covariance.map_or(rotation, |rows| SMatrix::from_fn(|r, c| rows[r][c]));
        let attitude = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        poses.push((attitude, Vector3::from(place), covariance));
    }
    let [(p, a, one), (q, b, other)] = &poses[..] else { return Ok(score) };
    let (angle, apart) = ((p.inverse() * q).scaled_axis(), b - a);
    let covariance = one + other;
    let pose = Vector6::new(angle.x, angle.y, angle.z, apart.x, apart.y, apart.z);
    let rotation = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let squares = [
        rotation.cholesky().map_or(f64::NAN, |c| angle.dot(&c.solve(&angle))),
        covariance.cholesky().map_or(f64::NAN, |c| pose.dot(&c.solve(&pose))),
    ];
    let agree = squares.iter().zip(CHI_SQUARE_95).all(|(square, limit)| *square < limit);
    score.consistent[0] = usize::from(agree);
    score.valid[0] = usize::from(score.exit == 0);
    score.figures = vec![angle.norm().to_degrees(), 1e3 * apart.norm()];
    Ok(score)
}
