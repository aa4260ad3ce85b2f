//! Vehicles with position fixes: errors at the end of outages.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_host::inertial::{Choice, Fix, Fixes, PathPoint, Profile, navigate};
use wimu_host::motion::MotionRecording;
use wimu_testkit::figure;

/// Interval of the outages, and time of the first of each phase, s.
const EVERY_S: f64 = 60.0;
const PHASES_S: [f64; 3] = [60.0, 80.0, 100.0];
/// 95 % point of χ² with three degrees of freedom.
const CHI_SQUARE: f64 = 7.815;
/// Antenna from the unit where the lever arm is not known, m, a component: it is not part of the path.
const ANTENNA_M: f64 = 0.1;
/// NEES below the 95 % point: bar.
const NEES: [f64; 2] = [0.85, 0.98];

/// Length of the outages, s; bar of median and 90 % point of the error, m, and reference.
struct Outages {
    lasts_s: f64,
    bar_m: [f64; 2],
    reference: &'static str,
}
const OUTAGES: [Outages; 2] = [
    Outages {
        lasts_s: 15.0,
        bar_m: [2.0, 8.0],
        reference: "prototype 2.0 / 7.8, tuned filter of the source 5.1 over the whole drive",
    },
    Outages {
        lasts_s: 30.0,
        bar_m: [8.0, 20.0],
        reference: "prototype 9.2 / 23, tuned filter of the source 12.0 over the whole drive",
    },
];

/// Scores a drive, `NAME_imu.csv` with the fixes `NAME_gnss.csv`, by the forward filter.
pub fn score(folder: &Path, name: &str) -> Result<(), String> {
    let read = |e: wimu_host::HostError| e.to_string();
    let recording = MotionRecording::from_csv(&folder.join(format!("{name}_imu.csv")));
    let recording = recording.map_err(read)?;
    let all = Fixes::read(&folder.join(format!("{name}_gnss.csv")), 0.0).map_err(read)?;
    println!("\n{name}: outages every {EVERY_S} s, forward filter, error in space at their end");
    for outages in &OUTAGES {
        let mut ends = Vec::new();
        let (mut below, mut count, mut ends_below) = (0_u32, 0_u32, 0);
        for phase_s in PHASES_S {
            let begins = outage_begins(&recording, &all, phase_s, outages.lasts_s);
            let outage = |fix: &Fix| {
                let within =
                    |begin: &f64| fix.time_s > *begin && fix.time_s <= begin + outages.lasts_s;
                begins.iter().position(within)
            };
            let (withheld, given): (Vec<Fix>, Vec<Fix>) =
                all.fixes.iter().partition(|fix| outage(fix).is_some());
            let choice = Choice {
                profile: Profile::Vehicle,
                smooth: false,
                limit_m: 1e3,
                fixes: Fixes { fixes: given, ..Fixes::default() },
                ..Choice::default()
            };
            let path = navigate(&recording, &choice).map_err(read)?;
            for (k, fix) in withheld.iter().enumerate() {
                let (error_m, nees) = error(&path.points, fix);
                let fits = nees < CHI_SQUARE;
                (below, count) = (below + u32::from(fits), count + 1);
                let is_last = withheld.get(k + 1).is_none_or(|next| outage(next) != outage(fix));
                if is_last {
                    println!(
                        "    {} s from {:5.1} s: {error_m:6.2} m, NEES {nees:.2}",
                        outages.lasts_s,
                        fix.time_s - outages.lasts_s
                    );
                    ends_below += usize::from(fits);
                    ends.push(error_m);
                }
            }
            if phase_s == PHASES_S[0] {
                path.findings.iter().for_each(|finding| println!("    {finding}"));
            }
        }
        ends.sort_by(f64::total_cmp);
        let [median, p90] = [0.5, 0.9].map(|part| quantile(&ends, part));
        let what = format!("{name}: {} outages of {} s", ends.len(), outages.lasts_s);
        let [most, most_p90] = outages.bar_m;
        figure(
            &format!("{what}, error at the end, median / p90, m"),
            format!("{median:.2} / {p90:.2}"),
            &format!("at most {most} / {most_p90} ({})", outages.reference),
            median <= most && p90 <= most_p90,
        );
        let fraction = f64::from(below) / f64::from(count.max(1));
        figure(
            &format!("{what}, fraction of NEES below the 95 % point, all withheld fixes"),
            format!("{fraction:.2} of {count}; {ends_below} of {} at the ends", ends.len()),
            "0.85–0.98 (prototype 0.88 / 0.83 over the whole drive)",
            (NEES[0]..=NEES[1]).contains(&fraction),
        );
    }
    Ok(())
}

/// Where the outages of a phase begin, s: those that end within both files.
fn outage_begins(
    recording: &MotionRecording,
    fixes: &Fixes,
    phase_s: f64,
    lasts_s: f64,
) -> Vec<f64> {
    let from_s = recording.times_s[0];
    let ends = [recording.times_s.last().copied(), fixes.fixes.last().map(|fix| fix.time_s)];
    let until_s = ends.into_iter().flatten().fold(f64::INFINITY, f64::min);
    let begins = (0..).map(|k| from_s + phase_s + EVERY_S * f64::from(k));
    begins.take_while(|begin| begin + lasts_s <= until_s).collect()
}

/// Distance of the path from a fix, m, and its NEES.
fn error(points: &[PathPoint], fix: &Fix) -> (f64, f64) {
    let at = points.partition_point(|p| p.time_s < fix.time_s).clamp(1, points.len() - 1);
    let (before, after) = (&points[at - 1], &points[at]);
    let part = (fix.time_s - before.time_s) / (after.time_s - before.time_s);
    let [from, to] = [before, after].map(|point| Vector3::from(point.position_m));
    let error = from + (to - from) * part - Vector3::from(fix.position_m);
    let own = Vector3::from(fix.position_sd_m).map(|sd| sd * sd + ANTENNA_M * ANTENNA_M);
    let covariance = Matrix3::from(after.covariance_m2) + Matrix3::from_diagonal(&own);
    let nees =
        covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)));
    (error.norm(), nees)
}

/// Quantile of sorted values, linear between them.
fn quantile(sorted: &[f64], part: f64) -> f64 {
    let at = part * sorted.len().saturating_sub(1) as f64;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    match (sorted.get(low), sorted.get(high)) {
        (Some(a), Some(b)) => a + (b - a) * at.fract(),
        _ => f64::NAN,
    }
}
