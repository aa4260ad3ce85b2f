//! Angular rate from eight accelerometers against the mean of eight gyroscopes, which nothing but
//! the scoring reads.

use std::path::Path;
use std::time::Instant;

use wimu_calib::Gravity;
use wimu_host::array::{
    ArrayBody, ArrayCalibration, ArrayGeometry, ArrayRecording, RefineOptions, refine,
};
use wimu_host::inertial::Zupt;
use wimu_nav::array::ArrayState;
use wimu_testkit::figure;

use crate::gyroscopes::mean_rate;

const DEG: f64 = std::f64::consts::PI / 180.0;

pub fn bench(data: &Path) {
    println!("\n# array/mimu4444_run1.csv: accelerometers only, against the gyroscopes' mean");
    let file = data.join("array/mimu4444_run1.csv");
    if !file.is_file() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let recording = ArrayRecording::from_csv(&file, 2048.0).expect("the recording is readable");
    let drawn = ArrayGeometry::read(&data.join("array/mimu4444_positions.csv")).expect("places");
    let calibration = ArrayCalibration::of(&recording, &drawn, Gravity::UNKNOWN_PLACE)
        .expect("the array has rests");
    println!(
        "{} rests; the sensors disagree there by {:.2} mm/s² rms; noise {:.1} mm/s²",
        calibration.rests.len(),
        calibration.disagreement_mps2 * 1e3,
        calibration.noise_mps2.iter().sum::<f64>() / calibration.noise_mps2.len() as f64 * 1e3
    );
    let start = Instant::now();
    let found = refine(&recording, &drawn, &calibration, &RefineOptions::default())
        .expect("places and delays");
    println!(
        "places and delays from {} samples in {:.1} s: what no motion explains falls from {:.3} to {:.3} m/s²",
        found.samples,
        start.elapsed().as_secs_f64(),
        found.residual_mps2[0],
        found.residual_mps2[1]
    );
    println!(
        "{}: χ² falls by {:.1} times what it has to",
        if found.accepted { "accepted" } else { "rejected" },
        found.gain
    );
    let mean = |sensors: [usize; 4], axis: usize, c: usize| {
        sensors.iter().map(|s| found.moved_m[*s][axis][c]).sum::<f64>() / 4.0 * 1e3
    };
    for (name, sensors) in [("upper", [0, 2, 4, 6]), ("lower", [1, 3, 5, 7])] {
        println!(
            "{name} chips: z axes at {:+.2} mm in x and {:+.2} in y from where they are drawn (± {:.2})",
            mean(sensors, 2, 0),
            mean(sensors, 2, 1),
            found.place_sd_m[sensors[0]][2][0] * 1e3
        );
    }
    let largest = (0..8).max_by(|a, b| found.delay_s[*a].abs().total_cmp(&found.delay_s[*b].abs()));
    let largest = largest.unwrap_or_default();
    println!(
        "largest delay of a chip: {:+.0} ± {:.0} µs",
        found.delay_s[largest] * 1e6,
        found.delay_sd_s[largest] * 1e6
    );
    let start = Instant::now();
    let motion = ArrayBody::of(&recording, &drawn, &calibration)
        .and_then(|body| body.angular_rate())
        .expect("an angular rate");
    println!(
        "smoother: {} samples in {:.1} s; {:.0?}; NIS {:.2} a degree of freedom",
        motion.rate_rad_s.len(),
        start.elapsed().as_secs_f64(),
        motion.spread,
        motion.nis
    );
    let start = Instant::now();
    let filter = |geometry: &ArrayGeometry| {
        let gravity = wimu_model::STANDARD_GRAVITY_MPS2;
        let arranged = recording.clone().arranged(geometry).expect("as many places");
        let (states, _) = ArrayBody::of(&arranged, geometry, &calibration)
            .and_then(|body| body.navigated(gravity, Zupt::Stated))
            .expect("a motion");
        // A delay is taken off with the help of samples before and after: the first and last have none.
        let lacks = arranged.times_s[0] - recording.times_s[0];
        let first = (lacks / recording.period_s()).round() as usize;
        let mut all = vec![states[0]; first];
        all.extend(states);
        all.resize(recording.times_s.len(), all[all.len() - 1]);
        all
    };
    let as_drawn = filter(&drawn);
    println!(
        "filter: {:.0} samples a second",
        as_drawn.len() as f64 / start.elapsed().as_secs_f64()
    );
    let as_found = filter(&found.geometry);

    let (truth, clipped) = mean_rate(&file).expect("the gyroscopes are readable");
    let count = truth.len();
    let near: Vec<bool> = (0..count)
        .map(|k| {
            (k.saturating_sub(1)..(k + 2).min(count))
                .any(|j| clipped[j] || recording.saturated[j] != 0)
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
    println!("{:<44}{:>10}{:>10}{:>12}", "", "RMSE", "median", "wrong sign");
    println!("{:<44}{:>10}{:>10}{:>12}", "bar, deg/s", "< 150", "< 53", "< 2 %");
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
        let rms = (squares / sizes.len() as f64).sqrt() / DEG;
        let median = sizes[sizes.len() / 2] / DEG;
        let wrong = 100.0 * wrong as f64 / scored.len() as f64;
        println!("{name:<44}{rms:>10.1}{median:>10.1}{wrong:>10.2} %");
        [rms, median, wrong]
    };
    let barred = |name: &str, [rms, median, wrong]: [f64; 3]| {
        figure(
            &format!("mimu4444_run1, {name}: rate, deg/s rms / median / wrong sign"),
            format!("{rms:.1} / {median:.1} / {wrong:.2} %"),
            "150 / 53 / 2 %",
            rms < 150.0 && median < 53.0 && wrong < 2.0,
        );
    };
    let rates = |states: &[ArrayState<f64>]| -> Vec<[f64; 3]> {
        states.iter().map(|s| s.rate_rad_s).collect()
    };
    let (drawn_rate, found_rate) = (rates(&as_drawn), rates(&as_found));
    let found = score("filter (up to now), places as drawn", &drawn_rate, &truth);
    barred("as drawn", found);
    let found = score("filter (up to now), places as found", &found_rate, &truth);
    barred("as found", found);
    let found = score("smoother (all samples), places as drawn", &motion.rate_rad_s, &truth);
    barred("smoother", found);
    for later_ms in [0.5, 1.0, 1.5, 2.0] {
        let moved = interpolated(&truth, later_ms * 1e-3 / period);
        score(&format!("filter, gyroscopes taken {later_ms} ms earlier"), &found_rate, &moved);
    }
    let consistency = |name: &str, states: &[ArrayState<f64>], truth: &[[f64; 3]]| {
        let mut nees: Vec<f64> = scored
            .iter()
            .map(|k| {
                let error = std::array::from_fn(|i| states[*k].rate_rad_s[i] - truth[*k][i]);
                wimu_host::motion::nees(error, states[*k].rate_covariance)
            })
            .collect();
        nees.sort_by(f64::total_cmp);
        let below = nees.iter().filter(|n| **n < 7.81).count();
        let below = 100.0 * below as f64 / nees.len() as f64;
        let median = nees[nees.len() / 2];
        figure(
            &format!("rate of mimu4444_run1, {name}: NEES < 7.81, median"),
            format!("{below:.0} %, {median:.2}"),
            "90–98 %, 1.5–3.5",
            (90.0..=98.0).contains(&below) && (1.5..=3.5).contains(&median),
        );
    };
    consistency("as drawn", &as_drawn, &truth);
    consistency("as found", &as_found, &truth);
    let moved = interpolated(&truth, 1.5e-3 / period);
    consistency("gyroscopes 1.5 ms earlier", &as_drawn, &moved);
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
