//! Faults of the sensors of an array: repeated rows, spikes, stopped outputs, and outputs at the end of their range.

use super::ArrayRecording;
use crate::plural::counted;
use crate::stats::{median, quantile};
use wimu_model::STANDARD_GRAVITY_MPS2;

/// Shortest constant output of a stopped sensor while most others change in each sample, samples.
const STOPPED_SAMPLES: usize = 64;
/// Longest run of equal rows that can be measurements whatever its probability, samples.
const FEW_SAMPLES: f64 = 3.0;
/// Probability, per recording, of a longer run of equal rows by chance.
const UNLIKELY: f64 = 1e-3;
/// Fewest samples at the end of the range.
const LIMIT_SAMPLES: usize = 4;
/// Width of the band below the end of the range that is compared with it, relative to the largest output.
const NEAR_LIMIT: f64 = 0.02;
/// Least width of that band, steps of the output.
const NEAR_STEPS: f64 = 3.0;
/// Lowest range of a sensor, g.
const LEAST_LIMIT: f64 = 1.08;
/// Least ratio of the ranges of two sensors of one array.
const ALIKE: f64 = 0.8;

/// Longest spike, samples.
const SPIKE_SAMPLES: usize = 3;
/// Spike threshold: deviation over the sum of the sensor's noise and the common motion.
const SPIKE_TIMES: f64 = 10.0;

/// Fewest samples of one sensor at its own limit, while the others exceed it.
const LIMIT_OF_ONE_SAMPLES: usize = 10;
/// Least fraction at the limit of the samples in which the median of the others exceeds it.
const LIMIT_OF_ONE_SHARE: f64 = 0.9;
/// By which that median exceeds it, m/s².
const BEYOND_MPS2: f64 = 0.1;
/// Least change of that median meanwhile, m/s².
const ABOUT_MPS2: f64 = 0.2;

/// Same value but for rounding.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

impl ArrayRecording {
    /// Leaves out repeated rows, spikes of one sensor, and the constant outputs of stopped sensors. Marks samples at the
    /// end of the range: the largest output, if it is more frequent than those just below it. Remarks report each.
    #[must_use]
    pub fn judged(mut self) -> Self {
        self.leave_out_repeated();
        self.leave_out_spikes();
        self.leave_out_stopped();
        self.find_limits();
        self.find_limits_of_one();
        self
    }

    /// The same for single axes of different directions, which cannot be compared with each other.
    pub(super) fn judged_axes(mut self) -> Self {
        self.leave_out_repeated();
        self.leave_out_stopped();
        self.find_limits();
        self
    }

    /// Says which sensors give no number, and where.
    pub(super) fn say_absent(&mut self) {
        let has = |row: &Vec<[f64; 3]>, sensor: usize| row[sensor].iter().all(|v| v.is_finite());
        let mut said = Vec::new();
        for sensor in 0..self.sensors() {
            let absent = self.outputs.iter().filter(|row| !has(row, sensor)).count();
            let Some(first) = self.outputs.iter().position(|row| !has(row, sensor)) else {
                continue;
            };
            let at_s = self.start_s + self.times_s[first];
            let to_the_end = self.outputs.len() - first == absent;
            said.push(if to_the_end {
                format!("sensor {sensor} (from 0) from {at_s:.2} s on")
            } else {
                let samples = counted(absent, "sample");
                format!("{samples} of sensor {sensor} (from 0), first at {at_s:.2} s")
            });
        }
        if !said.is_empty() {
            self.remarks.push(format!("no number, left out there: {}", said.join("; ")));
        }
    }

    /// Takes rows out that only repeat the one before, for longer than chance would have noisy outputs do: whoever wrote
    /// them had nothing new, so that there is a gap.
    fn leave_out_repeated(&mut self) {
        let count = self.outputs.len();
        // Holes are as good as equal; a row of them is none.
        let repeats = |k: usize| {
            let alike = |(a, b): (f64, f64)| a == b || (a.is_nan() && b.is_nan());
            self.steps(k).all(alike) && self.steps(k).any(|(a, b)| a == b)
        };
        // First repeated row and number of them.
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for k in (1..count).filter(|k| repeats(*k)) {
            match runs.last_mut() {
                Some((first, length)) if *first + *length == k => *length += 1,
                _ => runs.push((k, 1)),
            }
        }
        let repeated: usize = runs.iter().map(|(_, length)| length).sum();
        let distinct = (count - repeated) as f64;
        // By chance a row repeats the one before so often.
        let often = (1.0 + runs.len() as f64) / (1.0 + distinct);
        let longest = (UNLIKELY / count.max(1) as f64).ln() / often.min(1.0).ln();
        // Outputs with steps coarser than their noise repeat at rest, where few of them move from row to row.
        let moves = |k: usize| {
            let finite = (self.steps(k)).filter(|(a, b)| a.is_finite() && b.is_finite());
            let (moved, all) =
                finite.fold((0, 0), |(moved, all), (a, b)| (moved + usize::from(a != b), all + 1));
            2 * moved > all
        };
        runs.retain(|(first, length)| {
            let end = first + length;
            let lively = (*first < 2 || moves(first - 1)) && (end >= count || moves(end));
            lively && *length as f64 > longest.max(FEW_SAMPLES)
        });
        let Some((first, _)) = runs.first().copied() else {
            return;
        };
        if !self.is_noisy() {
            return;
        }
        let rows: usize = runs.iter().map(|(_, length)| length).sum();
        self.remarks.push(format!(
            "{} in which every output repeats the one before are no measurements: a gap, first from {:.2} s on",
            counted(rows, "sample"),
            self.start_s + self.times_s[first]
        ));
        let mut keep = vec![true; count];
        for (first, length) in runs {
            keep[first..first + length].fill(false);
        }
        fn only<T>(values: &mut Vec<T>, keep: &[bool]) {
            let mut kept = keep.iter();
            values.retain(|_| kept.next().copied().unwrap_or(true));
        }
        only(&mut self.times_s, &keep);
        only(&mut self.outputs, &keep);
        only(&mut self.saturated, &keep);
        for (_, values) in &mut self.other {
            only(values, &keep);
        }
    }

    /// Each output of a row beside that of the row before.
    fn steps(&self, k: usize) -> impl Iterator<Item = (f64, f64)> {
        let [now, before] = [k, k - 1].map(|k| self.outputs[k].iter().flatten().copied());
        now.zip(before)
    }

    /// Whether noise shows where the outputs change least: steps of white noise turn back, those of a smooth motion go on.
    fn is_noisy(&self) -> bool {
        let step = |k: usize| self.steps(k).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let steps: Vec<Vec<f64>> = (1..self.outputs.len()).map(step).collect();
        let dot = |a: &[f64], b: &[f64]| {
            let products = a.iter().zip(b).map(|(a, b)| a * b);
            products.filter(|p| p.is_finite()).sum::<f64>()
        };
        // What each window changes by, and how its steps go on.
        let mut windows: Vec<(f64, f64)> = (steps.chunks_exact(STOPPED_SAMPLES))
            .filter(|window| window.iter().all(|s| dot(s, s) > 0.0))
            .map(|window| {
                let squares = window.iter().map(|s| dot(s, s)).sum();
                let on = window.windows(2).map(|pair| dot(&pair[0], &pair[1])).sum();
                (squares, on)
            })
            .collect();
        windows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let quietest = windows.len().div_ceil(10);
        windows[..quietest].iter().map(|(_, on)| on).sum::<f64>() < 0.0
    }

    fn leave_out_spikes(&mut self) {
        let (sensors, count) = (self.sensors(), self.outputs.len());
        let window = |k: usize| k.saturating_sub(SPIKE_SAMPLES)..count.min(k + SPIKE_SAMPLES + 1);
        // How far each output is from the middle of those around it.
        let strange: Vec<Vec<f64>> = (0..sensors)
            .map(|sensor| {
                let of_axis = |k: usize, axis: usize| -> Option<f64> {
                    let around = window(k).map(|j| self.outputs[j][sensor][axis]);
                    let middle = median(around.filter(|v| v.is_finite()));
                    Some((self.outputs[k][sensor][axis] - middle?).abs())
                };
                let of_sample = |k: usize| {
                    let axes = (0..3).filter_map(|axis| of_axis(k, axis));
                    axes.fold(0.0, f64::max)
                };
                (0..count).map(of_sample).collect()
            })
            .collect();
        // Its noise, and no less than a step of it.
        let usual = |all: &Vec<f64>| {
            let step = all.iter().filter(|v| **v > 0.0).copied();
            let step = step.fold(f64::INFINITY, f64::min);
            median(all.iter().copied()).unwrap_or(0.0).max(step)
        };
        let usual: Vec<f64> = strange.iter().map(usual).collect();
        let step = |of: &Self, k: usize, sensor: usize, axis: usize| {
            let value = |j: usize| of.outputs[j][sensor][axis];
            let steps = window(k).skip(1).map(|j| (value(j) - value(j - 1)).abs());
            // A spike makes two of six.
            quantile(steps.filter(|v| v.is_finite()), 3).unwrap_or(0.0)
        };
        let mut found = Vec::new();
        for k in 0..count {
            let most = |sensor: usize| window(k).map(|j| strange[sensor][j]).fold(0.0, f64::max);
            for sensor in 0..sensors {
                if strange[sensor][k] <= SPIKE_TIMES * usual[sensor] {
                    continue;
                }
                // What it goes by from sample to sample there: a peak of a smooth motion is no spike.
                let steps = (0..3).map(|axis| step(self, k, sensor, axis));
                let steps = steps.fold(0.0, f64::max);
                let others = (0..sensors).filter(|other| *other != sensor).map(most);
                let moved = median(others).unwrap_or(f64::INFINITY);
                if strange[sensor][k] > SPIKE_TIMES * (usual[sensor] + moved + steps) {
                    found.push((k, sensor));
                }
            }
        }
        let Some((first, _)) = found.first() else {
            return;
        };
        let of = |sensor: usize| found.iter().filter(|(_, s)| *s == sensor).count();
        let counts = (0..sensors).map(|sensor| (sensor, of(sensor)));
        let counts: Vec<String> = counts
            .filter(|(_, count)| *count > 0)
            .map(|(sensor, count)| format!("{count} of sensor {sensor}"))
            .collect();
        self.remarks.push(format!(
            "spikes that the other sensors do not show are left out: {} (from 0), first at {:.2} s",
            counts.join(", "),
            self.start_s + self.times_s[*first]
        ));
        for (k, sensor) in found {
            self.outputs[k][sensor] = [f64::NAN; 3];
        }
    }

    fn leave_out_stopped(&mut self) {
        let (sensors, count) = (self.sensors(), self.outputs.len());
        let value = |k: usize, axis: usize| self.outputs[k][axis / 3][axis % 3];
        // Samples up to each in which most outputs have moved.
        let mut lively = vec![0_usize; count];
        for k in 1..count {
            let (mut moved, mut finite) = (0, 0);
            for axis in 0..3 * sensors {
                let (before, now) = (value(k - 1, axis), value(k, axis));
                if before.is_finite() && now.is_finite() {
                    finite += 1;
                    moved += usize::from(!same(before, now));
                }
            }
            lively[k] = lively[k - 1] + usize::from(2 * moved > finite);
        }
        let mut stopped: Vec<(usize, usize, usize)> = Vec::new();
        for axis in 0..3 * sensors {
            let mut first = 0;
            for k in 1..=count {
                if k < count && same(value(k, axis), value(first, axis)) {
                    continue;
                }
                if lively[k - 1] - lively[first] >= STOPPED_SAMPLES {
                    stopped.push((axis, first, k));
                }
                first = k;
            }
        }
        for (axis, first, end) in stopped {
            let sensor = axis / 3;
            let at = self.outputs[first][sensor][axis % 3];
            // Its other axes may have been found before it.
            if end - first < count && at.is_finite() {
                self.remarks.push(format!(
                    "sensor {sensor} (from 0) stood still from {:.2} to {:.2} s: its {} axis gave {at:.3} m/s² \
                     each time; left out there",
                    self.start_s + self.times_s[first],
                    self.start_s + self.times_s[end - 1],
                    ["X", "Y", "Z"][axis % 3]
                ));
            }
            for row in &mut self.outputs[first..end] {
                row[sensor] = [f64::NAN; 3];
            }
        }
    }

    fn find_limits(&mut self) {
        let mut found: Vec<(usize, usize, f64)> = Vec::new();
        let mut rest = Vec::new();
        for sensor in 0..self.sensors() {
            for axis in 0..3 {
                for sign in [-1.0, 1.0] {
                    let values = || {
                        let all = self.outputs.iter().map(|row| sign * row[sensor][axis]);
                        all.filter(|v| v.is_finite())
                    };
                    let largest = values().fold(f64::NEG_INFINITY, f64::max);
                    let shows = is_limit(largest, &values);
                    let list = if shows { &mut found } else { &mut rest };
                    list.push((sensor, axis, sign * largest));
                }
            }
        }
        let largest = found.iter().map(|(.., v)| v.abs()).fold(0.0, f64::max);
        found.retain(|(.., limit)| limit.abs() >= ALIKE * largest);
        if found.is_empty() {
            return;
        }
        // Others that reach the very same value were there too, if less often.
        let shown: Vec<f64> = found.iter().map(|(.., v)| v.abs()).collect();
        rest.retain(|(.., v)| shown.iter().any(|limit| same(v.abs(), *limit)));
        found.extend(rest);
        let mut marked = 0;
        for (row, bits) in self.outputs.iter().zip(&mut self.saturated) {
            let before = *bits;
            for (sensor, axis, limit) in &found {
                let beyond = row[*sensor][*axis] * limit.signum() >= limit.abs() * (1.0 - 1e-9);
                *bits |= u32::from(beyond) << sensor;
            }
            marked += usize::from(*bits != before);
        }
        if marked > 0 {
            let mut sensors: Vec<usize> = found.iter().map(|(sensor, ..)| *sensor).collect();
            sensors.sort_unstable();
            sensors.dedup();
            self.remarks.push(format!(
                "sensors {sensors:?} (from 0) repeat outputs of up to {largest:.2} m/s² and none beyond: taken \
                 for their limit, {marked} samples"
            ));
        }
    }
}

impl ArrayRecording {
    /// A limit that one sensor has and the others have not: it stays at its largest value, to the bit, while the
    /// others go beyond and about.
    fn find_limits_of_one(&mut self) {
        let sensors = self.sensors();
        if sensors < 3 {
            return;
        }
        for (sensor, axis) in (0..sensors).flat_map(|s| (0..3).map(move |a| (s, a))) {
            for sign in [-1.0, 1.0] {
                let own = |row: &Vec<[f64; 3]>| sign * row[sensor][axis];
                let largest = (self.outputs.iter().map(own))
                    .filter(|v| v.is_finite())
                    .fold(f64::NEG_INFINITY, f64::max);
                let at = |row: &Vec<[f64; 3]>| same(own(row), largest);
                if self.outputs.iter().filter(|row| at(row)).count() < LIMIT_OF_ONE_SAMPLES {
                    continue;
                }
                // What the others give meanwhile, where most of them are beyond.
                let (mut beyond, mut hits) = (0, Vec::new());
                for row in &self.outputs {
                    let others = (0..sensors).filter(|s| *s != sensor);
                    let others = others.map(|s| sign * row[s][axis]);
                    let Some(middle) = median(others.filter(|v| v.is_finite())) else {
                        continue;
                    };
                    if own(row).is_finite() && middle > largest + BEYOND_MPS2 {
                        beyond += 1;
                        if at(row) {
                            hits.push(middle);
                        }
                    }
                }
                let count = hits.len() as f64;
                let mean = hits.iter().sum::<f64>() / count;
                let square = hits.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
                let clips = hits.len() >= LIMIT_OF_ONE_SAMPLES
                    && count >= LIMIT_OF_ONE_SHARE * f64::from(beyond)
                    && square > ABOUT_MPS2 * ABOUT_MPS2;
                if !clips {
                    continue;
                }
                let mut marked = 0;
                for (row, bits) in self.outputs.iter().zip(&mut self.saturated) {
                    if at(row) && *bits >> sensor & 1 == 0 {
                        *bits |= 1 << sensor;
                        marked += 1;
                    }
                }
                if marked > 0 {
                    self.remarks.push(format!(
                        "sensor {sensor} (from 0): its {} axis stays at {:.2} m/s² while the others go beyond: taken for \
                         its limit, {marked} samples",
                        ["X", "Y", "Z"][axis],
                        sign * largest
                    ));
                }
            }
        }
    }
}

/// Whether the largest of values looks like a limit.
fn is_limit<I: Iterator<Item = f64>>(largest: f64, values: &dyn Fn() -> I) -> bool {
    if !(largest.is_finite() && largest > LEAST_LIMIT * STANDARD_GRAVITY_MPS2) {
        return false;
    }
    let mut last = f64::NAN;
    let mut step = f64::INFINITY;
    let (mut at, mut on_end) = (0, false);
    for value in values() {
        let change = (value - last).abs();
        if change > 1e-9 * largest {
            step = step.min(change);
        }
        if same(value, largest) {
            at += 1;
            on_end |= same(value, last);
        }
        last = value;
    }
    if at < LIMIT_SAMPLES || !on_end {
        return false;
    }
    let below = largest - (NEAR_LIMIT * largest).max(NEAR_STEPS * step);
    let near = values().filter(|v| *v >= below && !same(*v, largest));
    at > 2 * near.count()
}
