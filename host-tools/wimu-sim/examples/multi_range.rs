//! Bars of merged accelerometers over simulated ones: noise, peak of an impact, step at the change-over.
//! `cargo run --release -p wimu-sim --example multi_range -- [SEEDS] [--pictures PICTURES]`

use std::path::Path;

use wimu_host::Result;
use wimu_host::chart::{Chart, Series, write_all};
use wimu_host::multi_range::{FullScales, Merge};
use wimu_host::recording::{Quantity, Recording};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_sim::multi_range::MultiRange;
use wimu_testkit::figure;

/// Bars: noise of the merged over that of the finest, error of the peak, step over σ.
const NOISE: f64 = 1.05;
const PEAK: f64 = 0.02;
const STEP: f64 = 1.0;
/// Part of ± 2 g from which on the finest is saturated.
const SATURATED: f64 = 0.99;
/// Samples before and after a change-over.
const AROUND: usize = 3;

/// Of one simulation.
#[derive(Clone, Copy, Debug)]
struct Score {
    /// RMS error of the merged over that of the finest, at rest and wherever it is not saturated; the largest of the axes.
    noise: [f64; 2],
    /// Relative error of the peak: merged, finest alone, widest alone (as the datasheet has it).
    peak: [f64; 3],
    /// Mean change of the error at a change-over, outwards, over σ of a sample.
    step: f64,
    /// RMS of the error over σ, where the finest is saturated.
    consistency: f64,
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let seeds = arguments.first().and_then(|n| n.parse().ok()).unwrap_or(20);
    for (name, widest) in [("±2, ±16 g", false), ("±2, ±16, ±200 g", true)] {
        let scores = (1..=seeds).map(|seed| score(&MultiRange::new(seed, widest)));
        let scores = scores.collect::<Result<Vec<Score>>>()?;
        print(name, &scores);
    }
    if let Some(at) = arguments.iter().position(|a| a == "--pictures") {
        let folder = arguments.get(at + 1).map_or("pictures", String::as_str);
        write_all(Path::new(folder), &[("multi-range", picture()?)])?;
    }
    Ok(())
}

fn print(name: &str, scores: &[Score]) {
    let of = |part: fn(&Score) -> f64| {
        let mut all: Vec<f64> = scores.iter().map(part).collect();
        all.sort_by(f64::total_cmp);
        (all[all.len() / 2], all[all.len() - 1])
    };
    let line = |claim: &str, part: fn(&Score) -> f64, target: &str, bar: f64| {
        let (median, worst) = of(part);
        let claim = format!("{name}: {claim}, median / worst of {}", scores.len());
        figure(&claim, format!("{median:.3} / {worst:.3}"), target, worst <= bar);
    };
    line("noise over that of ±2 g, at rest", |s| s.noise[0], "at most 1.05", NOISE);
    line("the same wherever ±2 g is not saturated", |s| s.noise[1], "at most 1.05", NOISE);
    let (fine, _) = of(|s| 100.0 * s.peak[1]);
    let (wide, _) = of(|s| 100.0 * s.peak[2]);
    let target = format!("at most 2 (±2 g alone {fine:.0}, the widest alone {wide:.1})");
    line("error of the peak of an impact, %", |s| 100.0 * s.peak[0], &target, 100.0 * PEAK);
    line("step at the change-over, σ", |s| s.step.abs(), "at most 1", STEP);
    line("RMS error over σ where ±2 g is saturated", |s| s.consistency, "–", f64::INFINITY);
}

/// Times, s, and values, m/s², of an accelerometer.
fn samples(recording: &Recording, sensor: u8) -> Vec<(f64, [f64; 3])> {
    let mut tracks = recording.of(Quantity::SpecificForce);
    let track = tracks.find(|track| track.info.sensor == sensor);
    let scale = match track.map(|track| track.info.unit) {
        Some(wimu_host::recording::Unit::Counts { si_per_lsb }) => si_per_lsb.unwrap_or(1.0),
        _ => 1.0,
    };
    let rows = track.into_iter().flat_map(|track| {
        let rows = track.times_ns().iter().enumerate();
        rows.filter_map(|(k, ns)| Some((*ns as f64 * 1e-9, track.row(k)?.try_into().ok()?)))
    });
    rows.map(|(time_s, row): (f64, [f64; 3])| (time_s, row.map(|axis| axis * scale))).collect()
}

fn merged(simulated: &MultiRange) -> Result<(Recording, Merge)> {
    let recording = simulated.record();
    let merge = Merge::of(&recording, &FullScales::default())?;
    Ok((recording, merge.expect("two or three ranges")))
}

fn score(simulated: &MultiRange) -> Result<Score> {
    let (recording, merge) = merged(simulated)?;
    let truth = simulated.truth();
    let fine = samples(&recording, 0);
    let found = samples(&merge.recording, 0);
    let rail = SATURATED * 2.0 * STANDARD_GRAVITY_MPS2;
    let error =
        |of: &[(f64, [f64; 3])], k: usize, axis: usize| of[k].1[axis] - truth(of[k].0)[axis];
    let is_out = |k: usize, axis: usize| fine[k].1[axis].abs() >= rail;
    let rms = |of: &[(f64, [f64; 3])], axis: usize, end_s: f64| {
        let within = (0..of.len()).filter(|k| of[*k].0 < end_s && !is_out(*k, axis));
        let squares: Vec<f64> = within.map(|k| error(of, k, axis).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let noise = [3.0, f64::INFINITY].map(|end_s| {
        let ratios = (0..3).map(|axis| rms(&found, axis, end_s) / rms(&fine, axis, end_s));
        ratios.fold(0.0, f64::max)
    });
    let [begin_s, end_s] = simulated.pulse_s();
    let peak = |of: &mut dyn Iterator<Item = (f64, [f64; 3])>| {
        let within = of.filter(|(time_s, _)| (begin_s..=end_s).contains(time_s));
        within.map(|(_, value)| value[0].abs()).fold(0.0, f64::max)
    };
    let true_peak = {
        let times = (0..=3000).map(|k| begin_s + (end_s - begin_s) * f64::from(k) / 3000.0);
        peak(&mut times.map(|time_s| (time_s, truth(time_s))))
    };
    let widest = samples(&recording, simulated.sensors.len() as u8 - 1);
    let peaks = [&found, &fine, &widest];
    let peaks = peaks.map(|of| (peak(&mut of.iter().copied()) / true_peak - 1.0).abs());
    let (mut steps, mut squares) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for k in AROUND..fine.len() - AROUND {
            let deviation = merge.deviations_mps2[k][axis];
            if is_out(k, axis) && found[k].1[axis].is_finite() {
                squares.push((error(&found, k, axis) / deviation).powi(2));
            }
            if is_out(k - 1, axis) == is_out(k, axis) {
                continue;
            }
            let mean = |from: usize| {
                let errors = (from..from + AROUND).map(|k| error(&found, k, axis));
                errors.sum::<f64>() / AROUND as f64
            };
            let (inside, outside, saturated) = match is_out(k, axis) {
                true => (mean(k - AROUND), mean(k), k),
                false => (mean(k), mean(k - AROUND), k - 1),
            };
            let outwards = fine[saturated].1[axis].signum();
            steps.push(outwards * (outside - inside) / merge.deviations_mps2[saturated][axis]);
        }
    }
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
    Ok(Score { noise, peak: peaks, step: mean(&steps), consistency: mean(&squares).sqrt() })
}

/// The impact along x: both accelerometers and the merged one.
fn picture() -> Result<Chart> {
    let simulated = MultiRange::new(1, false);
    let (recording, merge) = merged(&simulated)?;
    let [begin_s, end_s] = simulated.pulse_s();
    let shown = begin_s - 0.03..end_s + 0.03;
    let points = |of: Vec<(f64, [f64; 3])>| {
        let within = of.into_iter().filter(|(time_s, _)| shown.contains(time_s));
        within.map(|(time_s, value)| (1e3 * (time_s - begin_s), value[0])).collect()
    };
    let times = (0..900).map(|k| shown.start + (shown.end - shown.start) * f64::from(k) / 900.0);
    let truth = simulated.truth();
    let truth = points(times.map(|time_s| (time_s, truth(time_s))).collect());
    let series = vec![
        Series::line("±2 g", points(samples(&recording, 0))),
        Series::line("±16 g, not calibrated", points(samples(&recording, 1))),
        Series::line("truth", truth),
        Series::line("merged", points(samples(&merge.recording, 0))),
    ];
    Ok(Chart::new(
        "An impact beyond the range of the fine accelerometer",
        "Time from the impact (ms)",
        "Specific force along x (m/s²)",
        series,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_accelerometers_meet_their_bars_and_each_alone_does_not() {
        for widest in [false, true] {
            for seed in 101..104 {
                let score = score(&MultiRange::new(seed, widest)).unwrap();
                let claim = format!("seed {seed}, widest {widest}: {score:?}");
                // Less noise than the finest alone, but no less than both can have.
                assert!(score.noise.iter().all(|n| (0.7..=NOISE).contains(n)), "{claim}");
                assert!(score.peak[0] <= PEAK && score.peak[1] > 10.0 * PEAK, "{claim}");
                assert!(score.peak[2] > score.peak[0], "{claim}");
                assert!(score.step.abs() <= STEP, "{claim}");
                // Kinks of the pulse are errors of interpolation.
                assert!((0.2..4.0).contains(&score.consistency), "{claim}");
            }
        }
    }
}
