//! A gyroscope that warms up at rest: its bias settles, b(t) = c e^(−t/T) + d, as the accelerometer's does, equation (85).

use wimu_nav::unit::UnitSample;

use crate::motion::rests;

/// A rest that shows it lasts so long, s.
const REST_S: f64 = 10.0;
/// Time constants that are tried, as shares of the rest: what settles more slowly looks like a line.
const LONGEST: f64 = 1.0;
const SHORTEST: f64 = 0.03;
const TRIED: u32 = 25;
/// χ² of six parameters more than a bias that stands still, beyond chance.
const CHANCE: f64 = 60.0;

/// What settles: c of each axis, rad/s, and T, s.
struct Warming {
    change_rad_s: [f64; 3],
    time_s: f64,
    gain: f64,
}

/// Takes off the angular rate what its bias changes by while the gyroscope warms up, so that what it has at the end of
/// the first long rest is its bias throughout; returns what to say of it.
pub(super) fn taken_off(times_s: &[f64], samples: &mut [UnitSample]) -> Option<String> {
    let unrated: Vec<UnitSample> = samples
        .iter()
        .map(|sample| UnitSample {
            rate_rad_s: None,
            ..*sample
        })
        .collect();
    let found = rests(times_s, &unrated);
    let rest = found
        .iter()
        .find(|rest| times_s[rest.end - 1] - times_s[rest.first] >= REST_S)?;
    let (start_s, end_s) = (times_s[rest.first], times_s[rest.end - 1]);
    let rates: Vec<(f64, [f64; 3])> = (rest.first..rest.end)
        .filter_map(|k| Some((times_s[k] - start_s, samples[k].rate_rad_s?)))
        .collect();
    let lasts_s = end_s - start_s;
    let found = (0..=TRIED)
        .map(|k| SHORTEST * (LONGEST / SHORTEST).powf(f64::from(k) / f64::from(TRIED)))
        .filter_map(|share| fitted(&rates, share * lasts_s))
        .max_by(|a, b| a.gain.total_cmp(&b.gain))
        .filter(|found| found.gain > CHANCE)?;
    let at = |time_s: f64| (-(time_s - start_s) / found.time_s).exp();
    for (time_s, sample) in times_s.iter().zip(samples.iter_mut()).skip(rest.first) {
        let by = at(*time_s) - at(end_s);
        if let Some(rate) = &mut sample.rate_rad_s {
            *rate = std::array::from_fn(|i| rate[i] - by * found.change_rad_s[i]);
        }
    }
    let [x, y, z] = found
        .change_rad_s
        .map(|c| (c * (at(end_s) - at(start_s))).to_degrees());
    Some(format!(
        "the gyroscope warms up: over the rest from {start_s:.1} to {end_s:.1} s its bias changes by {x:+.3} {y:+.3} \
         {z:+.3} deg/s, within {:.0} s; the change is taken off, what it has at the end counts",
        found.time_s
    ))
}

/// The change that fits best with this time constant.
fn fitted(rates: &[(f64, [f64; 3])], time_s: f64) -> Option<Warming> {
    let count = rates.len() as f64;
    let shape: Vec<f64> = rates.iter().map(|(t, _)| (-t / time_s).exp()).collect();
    let middle = shape.iter().sum::<f64>() / count;
    let square: f64 = shape.iter().map(|s| (s - middle).powi(2)).sum();
    let (mut change_rad_s, mut gain) = ([0.0; 3], 0.0);
    for (axis, change) in change_rad_s.iter_mut().enumerate() {
        let mean = rates.iter().map(|(_, r)| r[axis]).sum::<f64>() / count;
        let spread: f64 = rates.iter().map(|(_, r)| (r[axis] - mean).powi(2)).sum();
        let along: f64 = (rates.iter().zip(&shape))
            .map(|((_, r), s)| (r[axis] - mean) * (s - middle))
            .sum();
        *change = along / square;
        let explained = along * along / square;
        gain += explained / ((spread - explained) / count);
    }
    // Nothing explains a spread of zero, nor does a time without samples.
    gain.is_finite().then_some(Warming {
        change_rad_s,
        time_s,
        gain,
    })
}
