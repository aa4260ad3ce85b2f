//! Samples for live plots: few points that keep the extremes.

use std::collections::VecDeque;

use wimu_host::monitor::Reading;

/// Points of a frame. Chosen: those of 1 kHz are not thinned at [`TICK`](super::board::TICK).
const MOST_POINTS: usize = 40;
/// Points that are kept for a page that joins: a minute at 100 Hz.
const HISTORY: usize = 6000;

/// A sample: X, Y, Z of the specific force and its magnitude, m/s², X, Y, Z of the angular rate, rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Point {
    /// Device time, s.
    time_s: f64,
    values: [f32; 7],
}

/// The samples since the last frame, and the latest ones.
#[derive(Default)]
pub struct Samples {
    pending: Vec<Point>,
    history: VecDeque<Point>,
    has_rate: bool,
    /// Whether the device's clock has begun again.
    restarted: bool,
}

/// Points for the page.
pub struct Points {
    /// Whether they are all that is known, for a page that has joined.
    pub whole: bool,
    /// Whether the device's clock has begun again.
    pub restarted: bool,
    /// Device time, s.
    pub t: Vec<f64>,
    /// The values of each channel.
    pub v: Vec<Vec<f32>>,
}

impl Samples {
    /// Takes a reading. What is not finite is 0 in a point, so that the page can draw it.
    pub fn push(&mut self, reading: &Reading) {
        let f = reading.specific_force.0;
        let norm = f.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
        self.has_rate |= reading.angular_rate.is_some();
        let w = reading.angular_rate.unwrap_or_default();
        let values = [f[0], f[1], f[2], norm, w[0], w[1], w[2]];
        let time_s = (reading.time.to_seconds() * 1e5).round() * 1e-5;
        let back = |last: &Point| time_s < last.time_s;
        if self.pending.last().or(self.history.back()).is_some_and(back) {
            self.restart();
        }
        self.pending.push(Point {
            time_s,
            values: values.map(|value| if value.is_finite() { value as f32 } else { 0.0 }),
        });
    }

    /// The device's clock begins again.
    pub fn restart(&mut self) {
        self.pending.clear();
        self.history.clear();
        self.restarted = true;
    }

    /// The points since the last call; all, for a page that has `joined`.
    pub fn take(&mut self, joined: bool) -> Option<Points> {
        let fresh = thinned(&std::mem::take(&mut self.pending), MOST_POINTS);
        self.history.extend(fresh.iter().copied());
        let old = self.history.len().saturating_sub(HISTORY);
        self.history.drain(..old);
        let restarted = std::mem::take(&mut self.restarted);
        let whole = restarted || joined;
        let sent = if whole { &*self.history.make_contiguous() } else { &fresh };
        if sent.is_empty() && !whole {
            return None;
        }
        let channels = if self.has_rate { 7 } else { 4 };
        Some(Points {
            whole,
            restarted,
            t: sent.iter().map(|point| point.time_s).collect(),
            v: (0..channels)
                .map(|channel| sent.iter().map(|point| point.values[channel]).collect())
                .collect(),
        })
    }
}

/// At most `most` points: of equal intervals two each, with the extremes of every channel in their order.
fn thinned(points: &[Point], most: usize) -> Vec<Point> {
    if points.len() <= most {
        return points.to_vec();
    }
    let of_interval = points.len().div_ceil(most / 2);
    let pairs = points.chunks(of_interval).flat_map(|chunk| {
        let mut pair = [chunk[0], chunk[chunk.len() - 1]];
        for channel in 0..pair[0].values.len() {
            let value = |k: &usize| chunk[*k].values[channel];
            let by = |a: &usize, b: &usize| value(a).total_cmp(&value(b));
            let low = (0..chunk.len()).min_by(by).unwrap_or(0);
            let high = (0..chunk.len()).max_by(by).unwrap_or(0);
            pair[0].values[channel] = value(&low.min(high));
            pair[1].values[channel] = value(&low.max(high));
        }
        pair
    });
    pairs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_extreme_and_the_number_of_points() {
        let point = |k: usize| Point {
            time_s: k as f64,
            values: [if k == 777 { 50.0 } else { (k as f32).sin() }; 7],
        };
        let points: Vec<Point> = (0..1000).map(point).collect();
        let few = thinned(&points, MOST_POINTS);
        assert!(few.len() <= MOST_POINTS);
        assert!(few.is_sorted_by(|a, b| a.time_s <= b.time_s));
        let highest = few.iter().map(|point| point.values[3]).fold(0.0, f32::max);
        assert_eq!(highest, 50.0);
        assert_eq!(thinned(&points[..MOST_POINTS], MOST_POINTS), points[..MOST_POINTS]);
    }
}
