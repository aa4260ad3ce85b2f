//! Angular rate from eight accelerometers against the mean of eight gyroscopes, which nothing but
//! the scoring reads.

use std::path::Path;
use std::time::Instant;

use wimu_calib::Gravity;
use wimu_host::array::{ArrayCalibration, ArrayRecording, angular_rate, read_places};

/// LSB per deg/s of the gyroscopes.
const GYROSCOPE: f64 = 16.4;
const LIMIT: f64 = 32_760.0;
const DEG: f64 = std::f64::consts::PI / 180.0;

pub fn bench(data: &Path) {
    println!("\n# array/mimu4444_run1.csv: accelerometers only, against the gyroscopes' mean");
    let file = data.join("array/mimu4444_run1.csv");
    if !file.is_file() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let recording = ArrayRecording::from_csv(&file, 2048.0).expect("the recording is readable");
    let places = read_places(&data.join("array/mimu4444_positions.csv")).expect("places");
    let calibration =
        ArrayCalibration::of(&recording, Gravity::UNKNOWN_PLACE).expect("the array has rests");
    println!(
        "{} rests; the sensors disagree there by {:.2} mm/s² rms; noise {:.1} mm/s²",
        calibration.rests.len(),
        calibration.disagreement_mps2 * 1e3,
        calibration.noise_mps2.iter().sum::<f64>() / calibration.noise_mps2.len() as f64 * 1e3
    );
    let start = Instant::now();
    let motion = angular_rate(&recording, &places, &calibration).expect("an angular rate");
    println!(
        "{} samples in {:.1} s; {:.0?}; NIS {:.2} a degree of freedom",
        motion.rate_rad_s.len(),
        start.elapsed().as_secs_f64(),
        motion.spread,
        motion.nis
    );

    let (truth, clipped) = gyroscopes(&recording);
    let count = truth.len();
    let near: Vec<bool> = (0..count)
        .map(|k| {
            (k.saturating_sub(1)..(k + 2).min(count)).any(|j| clipped[j] || recording.saturated[j])
        })
        .collect();
    let norm = |v: [f64; 3]| v.iter().map(|a| a * a).sum::<f64>().sqrt();
    let moving: Vec<usize> = (0..count).filter(|k| norm(truth[*k]) > 1.0).collect();
    let scored: Vec<usize> = moving.iter().copied().filter(|k| !near[*k]).collect();
    println!(
        "{} samples above 1 rad/s, {} next to clipping left out, {} scored",
        moving.len(),
        moving.len() - scored.len(),
        scored.len()
    );
    println!(
        "{:<44}{:>10}{:>10}{:>12}",
        "", "RMSE", "median", "wrong sign"
    );
    println!(
        "{:<44}{:>10}{:>10}{:>12}",
        "bar, deg/s", "< 150", "< 53", "< 2 %"
    );
    let period = recording.period_s();
    let score = |name: &str, rate: &[[f64; 3]], truth: &[[f64; 3]]| {
        let (mut squares, mut sizes, mut wrong) = (0.0, Vec::new(), 0);
        for k in &scored {
            let mut along = 0.0;
            for axis in 0..3 {
                let d = rate[*k][axis] - truth[*k][axis];
                squares += d * d;
                sizes.push(d.abs());
                along += rate[*k][axis] * truth[*k][axis];
            }
            wrong += usize::from(along < 0.0);
        }
        sizes.sort_by(f64::total_cmp);
        println!(
            "{name:<44}{:>10.1}{:>10.1}{:>10.2} %",
            (squares / sizes.len() as f64).sqrt() / DEG,
            sizes[sizes.len() / 2] / DEG,
            100.0 * wrong as f64 / scored.len() as f64
        );
    };
    score("all samples (smoother)", &motion.rate_rad_s, &truth);
    score("up to now (likeliest root)", &motion.causal_rad_s, &truth);
    for later_ms in [0.5, 1.0, 1.5, 2.0] {
        let moved = interpolated(&truth, later_ms * 1e-3 / period);
        score(
            &format!("smoother, gyroscopes taken {later_ms} ms earlier"),
            &motion.rate_rad_s,
            &moved,
        );
    }
    let mut nees: Vec<f64> = scored
        .iter()
        .map(|k| {
            (0..3)
                .map(|i| {
                    let d = motion.rate_rad_s[*k][i] - truth[*k][i];
                    d * d / motion.rate_sd_rad_s[*k][i].powi(2)
                })
                .sum::<f64>()
        })
        .collect();
    nees.sort_by(f64::total_cmp);
    println!(
        "median of Σ (error / sd)²: {:.2} (2.37 if right and uncorrelated)",
        nees[nees.len() / 2]
    );
}

/// Mean of the gyroscopes less that of the first rest, rad/s, and where one of them is at its limit.
fn gyroscopes(recording: &ArrayRecording) -> (Vec<[f64; 3]>, Vec<bool>) {
    let count = recording.times_s.len();
    let mut mean = vec![[0.0; 3]; count];
    let mut clipped = vec![false; count];
    let mut sensors = 0.0;
    for (name, values) in &recording.other {
        let Some(axis) = ["X (", "Y (", "Z ("].iter().position(|a| name.contains(a)) else {
            continue;
        };
        if !name.starts_with("Gyroscope") {
            continue;
        }
        sensors += 1.0 / 3.0;
        for (k, value) in values.iter().enumerate() {
            mean[k][axis] += value / GYROSCOPE * DEG;
            clipped[k] |= value.abs() >= LIMIT;
        }
    }
    let rest = 300.min(count);
    let bias: [f64; 3] =
        std::array::from_fn(|axis| mean[..rest].iter().map(|m| m[axis]).sum::<f64>() / rest as f64);
    for value in &mut mean {
        for axis in 0..3 {
            value[axis] = (value[axis] - bias[axis]) / sensors;
        }
    }
    (mean, clipped)
}

/// A series `by` samples earlier, by cubic interpolation.
fn interpolated(series: &[[f64; 3]], by: f64) -> Vec<[f64; 3]> {
    let at = |k: isize| series[k.clamp(0, series.len() as isize - 1) as usize];
    (0..series.len() as isize)
        .map(|k| {
            let u = 1.0 - by;
            std::array::from_fn(|axis| {
                let [a, b, c, d] = [-2, -1, 0, 1].map(|o| at(k + o)[axis]);
                b + 0.5
                    * u
                    * (c - a + u * (2.0 * a - 5.0 * b + 4.0 * c - d + u * (3.0 * (b - c) + d - a)))
            })
        })
        .collect()
}
