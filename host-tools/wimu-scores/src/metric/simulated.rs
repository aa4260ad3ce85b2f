//! Simulated recordings: two accelerometers, and walks with faults.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_sim::motion::Motion;
use wimu_sim::multi_range::MultiRange;
use wimu_sim::walk::{Strides, sensed};
use wimu_testkit::Random;

use crate::baseline::zupt;
use crate::case::Case;
use crate::command::{Point, Ran};
use crate::manifest::Source;
use crate::report::BEYOND_SIGMA;
use crate::score::{Alignment, Score, errors, quantile};
use crate::table::{Result, Table};
use crate::truth::Truth;

/// Impacts, and sample rate of a journey, Hz.
const SEEDS: u64 = 20;
const RATE_HZ: f64 = 100.0;
const FORCE: &str = "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";
const RATE: &str = ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)";

/// Length of the run that an impact stops, from accelerometers of ± 2 and ± 16 g or from the first alone.
pub fn multi_range(case: &Case, source: Source) -> Result<Score> {
    let (mut score, mut lengths) = (Score::default(), Vec::new());
    for seed in 1..=SEEDS {
        let simulated = MultiRange::new(seed, false);
        let recording = simulated.record();
        let table = |sensor: usize| {
            let si = simulated.sensors[sensor].full_scale_g * STANDARD_GRAVITY_MPS2 / 32768.0;
            let track = &recording.tracks()[sensor];
            let row = |(k, ns): (usize, &i64)| {
                let force = track.row(k)?.iter().map(|counts| counts * si);
                Some([*ns as f64 * 1e-9].into_iter().chain(force).collect())
            };
            Table::of(FORCE, track.times_ns().iter().enumerate().filter_map(row))
        };
        let ran = match source {
            Source::FinestAlone => case.navigate(&[table(0)], &[], "")?,
            _ => case.navigate(&[table(0), table(1)], &["--setup", "full_scales_g=[2,16]"], "")?,
        };
        let end = simulated.impact.pose(simulated.impact.duration()).position_m;
        let last = ran.data["moves"].as_array().and_then(|moves| moves.last());
        let number = |key: &str| last.and_then(|found| found[key].as_f64());
        let error = number("length_m").map(|length| length - Vector3::from(end).norm());
        lengths.extend(error.map(f64::abs));
        let both = [number("length_sd_m"), error];
        let [sigma, value] = both.map(|x| Vector3::x() * x.unwrap_or(0.0));
        score.take(&[Point { sigma, valid: error.is_some(), ..Point::new(0.0, value) }], 0.0);
        score.exit = score.exit.max(ran.exit);
    }
    score.figures = [0.5, 1.0].map(|part| quantile(lengths.iter().copied(), part)).to_vec();
    Ok(score)
}

/// Injects a fault into rows of time, specific force and angular rate; `none` is one.
fn inject(fault: &str, rows: &mut Vec<Vec<f64>>, random: &mut Random) -> Result<()> {
    let original = rows.clone();
    let (third, late) = (rows.len() / 3, (0.05 * RATE_HZ) as usize);
    for (k, row) in rows.iter_mut().enumerate() {
        match fault {
            "none" | "gap" => {}
            "dead" => row[4..].fill(0.0),
            "stuck" => row[4..].copy_from_slice(&original[k.min(third)][4..]),
            "saturated" => row[4..].iter_mut().for_each(|v| *v = v.clamp(-2.0, 2.0)),
            "swapped-xy" => row.swap(4, 5),
            "swapped-yz" => row.swap(5, 6),
            "negated" => row[4..].iter_mut().for_each(|v| *v = -*v),
            "negated-x" => row[4] = -row[4],
            "negated-z" => row[6] = -row[6],
            "degrees" => row[4..].iter_mut().for_each(|v| *v = v.to_degrees()),
            "late" => row[4..].copy_from_slice(&original[k.saturating_sub(late)][4..]),
            "dead-force-z" => row[3] = 0.0,
            "swapped-force-xy" => row.swap(1, 2),
            "force-in-g" => row[1..4].iter_mut().for_each(|v| *v /= STANDARD_GRAVITY_MPS2),
            "spikes" if random.uniform() >= 0.01 => {}
            "spikes" => row[1 + random.below(6)] *= 20.0,
            _ => return Err(format!("{fault} is no fault").into()),
        }
    }
    if fault == "gap" {
        rows.drain(third..third + 2 * RATE_HZ as usize);
    }
    Ok(())
}

/// A walk of a foot along random corners: rows of a recording, and its truth.
fn walk(seed: u64, random: &mut Random) -> (Vec<Vec<f64>>, Vec<Point>) {
    let mut corners = vec![[0.0; 2]];
    for k in 0..2 + random.below(3) {
        corners.push(corners[k].map(|c: f64| c + random.within(6.0)));
    }
    let walk = sensed(&Strides::along(&corners), RATE_HZ, seed);
    let (mut rows, mut truth) = (Vec::new(), Vec::new());
    for (k, sample) in walk.samples.v.iter().enumerate() {
        let time_s = walk.samples.t[k].s();
        let rate = sample.rate_rad_s.unwrap_or_default();
        rows.push([time_s].iter().chain(&sample.force_mps2).chain(&rate).copied().collect());
        let [w, x, y, z] = walk.reference.quaternion.v[k].into();
        let attitude = Some(UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)));
        truth.push(Point { attitude, ..Point::new(time_s, walk.reference.position_m.v[k]) });
    }
    (rows, truth)
}

/// Walks with the fault that is the recording's name.
pub fn journeys(case: &Case, source: Source) -> Result<Score> {
    let (mut score, mut beyond) = (Score::default(), 0);
    for number in 0..case.journeys {
        // Each fault has walks of its own.
        let seed = case
            .recording
            .bytes()
            .fold(number, |seed, byte| seed.wrapping_mul(31).wrapping_add(u64::from(byte)));
        let mut random = Random::new(seed);
        let (mut rows, truth) = walk(seed, &mut random);
        inject(case.recording, &mut rows, &mut random)?;
        let table = Table::of(&format!("{FORCE}{RATE}"), rows);
        let truth = Truth::new(truth, case.entry);
        let ran = match source {
            Source::Command => case.navigate(&[table], &[], "")?,
            _ => Ran { points: zupt::path(&table, &zupt::FOOT, &truth, &[])?, ..Ran::default() },
        };
        let all = errors(&ran.points, &truth, Alignment::Heading).into_iter();
        let moving: Vec<Point> = all.filter(|e| e.0).map(|e| e.1).collect();
        let largest_sigma = std::mem::take(&mut score.worst_sigma);
        score.take(&moving, truth.sd_m);
        beyond += usize::from(score.worst_sigma > BEYOND_SIGMA);
        score.worst_sigma = score.worst_sigma.max(largest_sigma);
        score.exit = score.exit.max(ran.exit);
    }
    score.samples = case.journeys as usize;
    score.figures = vec![100.0 * beyond as f64 / case.journeys as f64];
    Ok(score)
}
