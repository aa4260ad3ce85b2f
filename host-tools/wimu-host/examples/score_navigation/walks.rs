//! Walks with a unit on a foot: error at the end, start and yaw aligned over the whole trial, and consistency at twenty
//! samples from a tenth of the trial to its end.

use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_testkit::figure;

use crate::methods::Scored;
use crate::recording::Recording;
use crate::score::{CHI_SQUARE_95, Consistency, Track, fraction_below, mean, median};

/// Samples of a trial at which the error is compared with its covariance.
const THINNED: usize = 20;

/// Score of one trial.
#[derive(Clone, Debug)]
pub struct Walk {
    pub name: String,
    /// Error at the end, m: in space, and horizontal.
    pub end_m: [f64; 2],
    /// Fraction of the thinned samples whose NEES is below the 95 % point of χ².
    pub consistent: f64,
}

/// The score of a track; `None` without truth of the whole trial.
pub fn score(recording: &Recording, track: &Track) -> Option<Walk> {
    let count = track.estimates.len();
    let truth = (0..count).map(|k| recording.position(k));
    let truth = truth.collect::<Option<Vec<Vector3<f64>>>>()?;
    let path = |k: usize| track.estimates[k].position - track.estimates[0].position;
    let walked = |k: usize| truth[k] - truth[0];
    let (sine, cosine) = (0..count).fold((0.0, 0.0), |(sine, cosine), k| {
        let (p, t) = (path(k), walked(k));
        (sine + p.x * t.y - p.y * t.x, cosine + p.x * t.x + p.y * t.y)
    });
    let yaw = Rotation3::from_axis_angle(&Vector3::z_axis(), sine.atan2(cosine));
    let error = |k: usize| yaw * path(k) - walked(k);
    let mut consistency = Consistency::default();
    let (from, to) = (count / 10, count.checked_sub(1)?);
    for sample in 0..THINNED {
        let k = from + sample * (to - from) / (THINNED - 1);
        let covariance = track.estimates[k].position_covariance?;
        let noise = Matrix3::identity() * recording.truth.position.powi(2);
        let covariance = yaw * covariance * yaw.inverse() + noise;
        consistency.push(&error(k), &covariance);
    }
    let end = error(to);
    Some(Walk {
        name: recording.name.clone(),
        end_m: [end.norm(), end.xy().norm()],
        consistent: consistency.nees.len() as f64 / THINNED as f64
            * fraction_below(&consistency.nees, CHI_SQUARE_95),
    })
}

/// Table of all trials, and the figures of the campaign: bars of median and 90 % quantile.
pub fn print(pool: &[Scored]) {
    for method in pool.iter().filter(|method| !method.walks.is_empty()) {
        println!("\n{}: walks, end aligned over the trial", method.name);
        println!("{:<30}{:>9}{:>15}{:>13}", "", "3-D, m", "horizontal, m", "NEES < 95 %");
        for Walk { name, end_m: [end, horizontal], consistent } in &method.walks {
            println!("{name:<30}{end:>9.3}{horizontal:>15.3}{consistent:>13.2}");
        }
        let ends = [0, 1].map(|k| method.walks.iter().map(|w| w.end_m[k]).collect::<Vec<f64>>());
        let of = |ends: &[f64]| [median(ends), quantile(ends, 0.9)];
        let consistent = mean(&method.walks.iter().map(|w| w.consistent).collect::<Vec<_>>());
        for (what, found, bars) in
            [("3-D", of(&ends[0]), [0.22, 0.42]), ("horizontal", of(&ends[1]), [0.08, 0.2])]
        {
            figure(
                &format!(
                    "{} walks, {}: {what} error at the end, median / p90, m",
                    method.walks.len(),
                    method.name
                ),
                format!("{:.3} / {:.3}", found[0], found[1]),
                &format!("at most {} / {}", bars[0], bars[1]),
                found[0] <= bars[0] && found[1] <= bars[1],
            );
        }
        figure(
            &format!("{} walks, {}: NEES below the 95 % point", method.walks.len(), method.name),
            format!("{consistent:.2}"),
            "0.80 to 0.98",
            (0.8..=0.98).contains(&consistent),
        );
    }
}

/// Quantile by linear interpolation.
fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = fraction * sorted.len().saturating_sub(1) as f64;
    let value = |k: usize| sorted.get(k).copied().unwrap_or(f64::NAN);
    let (low, high) = (value(at.floor() as usize), value(at.ceil() as usize));
    low + (high - low) * at.fract()
}
