//! Vehicles with position fixes, by the forward filter: a smoother would know what follows.

use crate::case::Case;
use crate::command::{Point, Ran, error_at};
use crate::manifest::Source;
use crate::score::{Score, quantile};
use crate::table::{ENU, Result, Table};

/// Interval of the outages, and time of the first of each phase, s.
const EVERY_S: f64 = 60.0;
const PHASES_S: [f64; 3] = [60.0, 80.0, 100.0];
/// Fixes are of the antenna, whose lever arm is not known: standard deviation of a component, m.
const FIX_M: f64 = 0.1;
/// Starts, the lengths that they are followed for, s, and the fraction of rejected fixes of one that fails.
const STARTS: usize = 40;
const FOLLOWED_S: [f64; 2] = [10.0, 60.0];
const REJECTED: f64 = 0.3;

fn drive(case: &Case, table: Table, fixes: &Table) -> Result<Ran> {
    let fixes = case.file("fixes.csv", fixes)?;
    case.navigate(&[table], &["--smooth", "off", "--setup", "limit_m=1000", "--fixes", &fixes], "")
}

/// The recording, the fixes, and the span of both, s.
fn drives(case: &Case, source: Source) -> Result<(Table, Table, [f64; 2])> {
    let table = case.table(case.recording, source)?;
    let fixes = Table::read(&case.data.join(case.truth_file()))?;
    let (a, b) = (table.times()?, fixes.times()?);
    let span_s = [a[0].max(b[0]), a[a.len() - 1].min(b[b.len() - 1])];
    Ok((table, fixes, span_s))
}

pub fn outages(case: &Case, source: Source) -> Result<Score> {
    let (table, fixes, [from_s, until_s]) = drives(case, source)?;
    let (times, positions) = (fixes.times()?, fixes.vectors("Position # (m)", ENU)?);
    let velocities = fixes.vectors("Velocity # (m/s)", ENU)?;
    let lasts_s = case.entry.lasts_s.ok_or("no lasts_s")?;
    let (mut score, mut ends) = (Score::default(), Vec::new());
    for phase_s in PHASES_S {
        let is_withheld = |k: &usize| {
            let since_s = times[*k] - from_s - phase_s;
            let begin_s = EVERY_S * (since_s / EVERY_S).floor();
            let is_whole = from_s + phase_s + begin_s + lasts_s <= until_s;
            begin_s >= 0.0 && since_s - begin_s <= lasts_s && is_whole
        };
        let (withheld, given): (Vec<usize>, Vec<usize>) = (0..times.len()).partition(is_withheld);
        let points = if source == Source::ConstantVelocity {
            let held = |k: &usize| {
                let last = given[given.partition_point(|g| g < k) - 1];
                let since_s = times[*k] - times[last];
                Point::new(times[*k], positions[last] + velocities[last] * since_s)
            };
            withheld.iter().map(held).collect()
        } else {
            let rows = given.iter().map(|k| fixes.rows[*k].clone()).collect();
            let ran = drive(case, table.clone(), &Table { rows, ..fixes.clone() })?;
            score.exit = score.exit.max(ran.exit);
            ran.points
        };
        let error = |k: &usize| error_at(&points, times[*k], positions[*k]);
        score.take(&withheld.iter().filter_map(error).collect::<Vec<_>>(), FIX_M);
        let last = withheld.iter().filter(|k| !is_withheld(&(*k + 1).min(times.len() - 1)));
        ends.extend(last.filter_map(error).map(|e| e.value.norm()));
    }
    score.samples = ends.len();
    score.figures = [0.5, 0.9].map(|part| quantile(ends.iter().copied(), part)).to_vec();
    Ok(score)
}

pub fn starts(case: &Case, source: Source) -> Result<Score> {
    let (table, fixes, [from_s, until_s]) = drives(case, source)?;
    let (times, positions) = (fixes.times()?, fixes.vectors("Position # (m)", ENU)?);
    let mut score = Score { figures: vec![0.0], ..Score::default() };
    for k in 0..STARTS {
        let part = k as f64 / (STARTS - 1) as f64;
        // Short and long ones all over the drive.
        let length_s = FOLLOWED_S[0] + (FOLLOWED_S[1] - FOLLOWED_S[0]) * (7.0 * part).fract();
        let begin_s = from_s + part * (until_s - from_s - length_s);
        let span_s = [begin_s, begin_s + length_s];
        let ran = drive(case, table.cut(span_s)?, &fixes.cut(span_s)?)?;
        let count = |key: &str| ran.data["aids"]["position"][key].as_f64().unwrap_or(0.0);
        let rejects = count("rejected") > REJECTED * (count("used") + count("rejected"));
        score.figures[0] += f64::from(u8::from(rejects || ran.exit != 0));
        score.exit = score.exit.max(ran.exit);
        let error = |k| error_at(&ran.points, times[k], positions[k]);
        score.take(&(0..times.len()).filter_map(error).collect::<Vec<_>>(), FIX_M);
    }
    score.samples = STARTS;
    Ok(score)
}
