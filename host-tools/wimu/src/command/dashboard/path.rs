//! The path of a board with the ellipsoid of its uncertainty.

use serde_json::Value;
use wimu_host::chart::{Chart, Series, Style};
use wimu_host::inertial::PathPoint;
use wimu_link::message::Navigation;

/// Points of a path; where it is longer, every second one is left out.
const MOST_POINTS: usize = 1000;
/// Least distance from the path up to which fixes are shown, m.
const NEAR_M: f64 = 10.0;
/// Corners of a circle on an ellipsoid.
const CORNERS: u32 = 48;

/// A path in space.
#[derive(Default)]
pub struct Path3 {
    points: Vec<[f64; 3]>,
    covariance_m2: Option<[[f64; 3]; 3]>,
    /// Calls for each point.
    every: u32,
    calls: u32,
    origin_m: [f64; 3],
}

impl Path3 {
    /// A position that the device computed; it sends no uncertainty.
    pub fn sent(&mut self, sent: &Navigation) {
        self.push(sent.position_nm.map(|nm| nm as f64 * 1e-9));
        self.covariance_m2 = None;
    }

    /// A position of the filter.
    pub fn filtered(&mut self, point: &PathPoint) {
        self.push(point.position_m);
        self.covariance_m2 = Some(point.covariance_m2);
    }

    fn push(&mut self, position_m: [f64; 3]) {
        if position_m.iter().any(|axis| !axis.is_finite()) {
            return;
        }
        self.calls += 1;
        // The last point is always the present one.
        if self.calls >= self.every.max(1) || self.points.is_empty() {
            self.calls = 0;
            self.points.push(position_m);
        } else if let Some(last) = self.points.last_mut() {
            *last = position_m;
        }
        if self.points.len() > MOST_POINTS {
            let mut kept = [true, false].into_iter().cycle();
            self.points.retain(|_| kept.next() == Some(true));
            self.every = self.every.max(1) * 2;
        }
    }

    /// Least and largest coordinate along an axis, m.
    fn extent(&self, axis: usize) -> [f64; 2] {
        let along = self.points.iter().map(|point| point[axis]);
        along.fold([f64::MAX, f64::MIN], |[low, high], v| [low.min(v), high.max(v)])
    }

    /// The path begins here, at zero.
    pub fn zero(&mut self) {
        self.origin_m = self.points.last().copied().unwrap_or_default();
        self.points.clear();
        self.every = 1;
    }

    /// The chart, from the second point on, with fixes and whether each was used.
    pub fn chart(&self, fixes: Option<Vec<([f64; 3], bool)>>) -> Option<Value> {
        let last = self.points.last().filter(|_| self.points.len() > 1)?;
        let moved = |p: &[f64; 3]| [0, 1, 2].map(|k| p[k] - self.origin_m[k]);
        let points: Vec<_> = self.points.iter().map(moved).collect();
        let mut series = vec![
            Series::space("path", Style::Line, &points),
            Series::space("now", Style::Dots, &[moved(last)]),
        ];
        if let Some(covariance) = &self.covariance_m2 {
            let names = ["1 σ", "", ""].into_iter();
            let circles = ellipsoid(moved(last), covariance).into_iter().zip(names);
            series.extend(circles.map(|(circle, name)| Series::space(name, Style::Guide, &circle)));
        }
        let size =
            (0..3).map(|axis| self.extent(axis)).fold(0.0, |most, [a, b]| f64::max(most, b - a));
        for (name, used) in [("fix", true), ("rejected fix", false)] {
            let fixes = fixes.iter().flatten().filter(|fix| fix.1 == used).map(|fix| fix.0);
            // One far away would make a point of the path.
            let is_near = |fix: &[f64; 3]| {
                let far = |axis: usize| {
                    let [low, high] = self.extent(axis);
                    fix[axis] < low - size.max(NEAR_M) || fix[axis] > high + size.max(NEAR_M)
                };
                !(0..3).any(far)
            };
            let fixes = Vec::from_iter(fixes.filter(is_near).map(|fix| moved(&fix)));
            if !fixes.is_empty() {
                series.push(Series::space(name, Style::Dots, &fixes));
            }
        }
        let chart = Chart {
            z: "up, m".to_owned(),
            equal: true,
            ..Chart::new("Path", "east, m", "north, m", series)
        };
        Some(chart.json())
    }
}

/// Three circles on the ellipsoid of one σ about a point: L u with the Cholesky factor L and unit vectors u.
fn ellipsoid(centre: [f64; 3], p: &[[f64; 3]; 3]) -> [Vec<[f64; 3]>; 3] {
    let mut l = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            let rest = p[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = match (i == j, l[j][j] > 0.0) {
                (true, _) => rest.max(0.0).sqrt(),
                (false, true) => rest / l[j][j],
                (false, false) => 0.0,
            };
        }
    }
    [[0, 1], [1, 2], [2, 0]].map(|[a, b]| {
        let corner = |k: u32| {
            let (sin, cos) = (f64::from(k) / f64::from(CORNERS) * std::f64::consts::TAU).sin_cos();
            [0, 1, 2].map(|axis| centre[axis] + l[axis][a] * cos + l[axis][b] * sin)
        };
        (0..=CORNERS).map(corner).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_corner_of_the_ellipsoid_is_one_sigma_away() {
        // 0.5 of both correlated axes, and another one.
        let p = [[4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 9.0]];
        let inverse =
            [[1.0 / 3.0, -1.0 / 3.0, 0.0], [-1.0 / 3.0, 4.0 / 3.0, 0.0], [0.0, 0.0, 1.0 / 9.0]];
        let centre = [5.0, 6.0, 7.0];
        for corner in ellipsoid(centre, &p).into_iter().flatten() {
            let d: [f64; 3] = [0, 1, 2].map(|k| corner[k] - centre[k]);
            let square: f64 = (0..3)
                .flat_map(|i| (0..3).map(move |j| (i, j)))
                .map(|(i, j)| d[i] * inverse[i][j] * d[j])
                .sum();
            assert!((square - 1.0).abs() < 1e-9, "{corner:?}: {square}");
        }
    }

    #[test]
    fn a_long_path_keeps_its_ends_in_few_points() {
        let mut path = Path3::default();
        for k in 0..100_000 {
            path.push([f64::from(k), 0.0, 0.0]);
        }
        assert!((MOST_POINTS / 2..=MOST_POINTS).contains(&path.points.len()));
        assert_eq!(path.points[0][0], 0.0);
        assert_eq!(path.points.last().unwrap()[0], 99_999.0);
        path.push([f64::NAN; 3]);
        assert!(path.points.iter().flatten().all(|axis| axis.is_finite()));
    }
}
