//! Errors against truth, as in the float64 reference.

use std::fmt;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_host::inertial::PathPoint;
use wimu_host::localization::{RangeRecording, RangeSample};

/// 95 % points of χ² with 2 and 3 degrees of freedom.
const CHI_SQUARE: [f64; 2] = [5.991, 7.815];
/// Medians of χ² with 2 and 3 degrees of freedom.
const MEDIAN: [f64; 2] = [1.386, 2.366];
/// Error of the truth of the vehicle (GPS), m.
const GPS_M: f64 = 0.03;
/// Autocorrelation of the error below which samples count as independent.
const INDEPENDENT: f64 = 0.2;

/// True positions, own clock.
pub struct Truth {
    times_s: Vec<f64>,
    positions_m: Vec<Vector3<f64>>,
    headings_rad: Vec<f64>,
}

impl Truth {
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
        let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let header = lines.next().ok_or("no header")?;
        let column = |name: &str| header.iter().position(|h| *h == name);
        let needed =
            |name: &str| column(name).ok_or(format!("{}: no column {name}", path.display()));
        let (time, east, north) =
            (needed("Time (s)")?, needed("Truth Position E (m)")?, needed("Truth Position N (m)")?);
        let (up, heading) = (column("Truth Position U (m)"), column("Truth Heading (rad)"));
        let mut truth =
            Self { times_s: Vec::new(), positions_m: Vec::new(), headings_rad: Vec::new() };
        for row in lines {
            let value =
                |k: usize| row[k].parse::<f64>().map_err(|e| format!("{}: {e}", path.display()));
            truth.times_s.push(value(time)?);
            truth.positions_m.push(Vector3::new(
                value(east)?,
                value(north)?,
                up.map_or(Ok(0.0), value)?,
            ));
            truth.headings_rad.extend(heading.map(value).transpose()?);
        }
        Ok(truth)
    }

    pub fn position_m(&self, k: usize) -> Vector3<f64> {
        self.positions_m[k]
    }

    pub fn heading_rad(&self, k: usize) -> Option<f64> {
        self.headings_rad.get(k).copied()
    }

    fn ends(&self) -> [f64; 2] {
        [self.times_s[0], self.times_s[self.times_s.len() - 1]]
    }

    fn at(&self, time_s: f64) -> Vector3<f64> {
        let k = self.times_s.partition_point(|t| *t <= time_s).clamp(1, self.times_s.len() - 1);
        let [from, to] = [self.times_s[k - 1], self.times_s[k]];
        let part = ((time_s - from) / (to - from)).clamp(0.0, 1.0);
        self.positions_m[k - 1] + (self.positions_m[k] - self.positions_m[k - 1]) * part
    }
}

/// Error and consistency.
pub struct Score {
    pub rmse_m: f64,
    largest_m: f64,
    /// Fraction of the NEES below the 95 % point: of all samples, and of independent ones.
    all: f64,
    pub thinned: f64,
    pub below: usize,
    pub thinned_s: f64,
    pub independent: usize,
    /// Median NEES over its expectation.
    median: f64,
    offset_s: f64,
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "RMSE {:.3} m, largest {:.2} m; NEES below the 95 % point: {:.2} of all, {:.2} of {} every {:.1} s; median {:.2}; offset {:+.2} s",
            self.rmse_m,
            self.largest_m,
            self.all,
            self.thinned,
            self.independent,
            self.thinned_s,
            self.median,
            self.offset_s
        )
    }
}

impl Score {
    fn of(
        times_s: &[f64],
        errors: &[Vector3<f64>],
        nees: &[f64],
        dof: usize,
        offset_s: f64,
    ) -> Self {
        let count = errors.len().max(1) as f64;
        let rmse_m = (errors.iter().map(Vector3::norm_squared).sum::<f64>() / count).sqrt();
        let thinned_s = independent_s(times_s, errors);
        let mut last = f64::NEG_INFINITY;
        let thinned: Vec<f64> = times_s
            .iter()
            .zip(nees)
            .filter(|(t, _)| {
                let far = **t - last >= thinned_s;
                last = if far { **t } else { last };
                far
            })
            .map(|(_, nees)| *nees)
            .collect();
        let below = |nees: &[f64]| {
            let limit = CHI_SQUARE[dof - 2];
            nees.iter().filter(|n| **n < limit).count() as f64 / nees.len().max(1) as f64
        };
        let mut sorted = nees.to_vec();
        sorted.sort_by(f64::total_cmp);
        Self {
            rmse_m,
            largest_m: errors.iter().map(Vector3::norm).fold(0.0, f64::max),
            all: below(nees),
            thinned: below(&thinned),
            below: (below(&thinned) * thinned.len() as f64).round() as usize,
            thinned_s,
            independent: thinned.len(),
            median: sorted[sorted.len() / 2] / MEDIAN[dof - 2],
            offset_s,
        }
    }
}

/// Shortest lag, s, at which the autocorrelation of the error is below [`INDEPENDENT`].
fn independent_s(times_s: &[f64], errors: &[Vector3<f64>]) -> f64 {
    let mean = errors.iter().sum::<Vector3<f64>>() / errors.len().max(1) as f64;
    let variance: f64 =
        errors.iter().map(|e| (e - mean).norm_squared()).sum::<f64>() / errors.len().max(1) as f64;
    let step_s = (times_s[times_s.len() - 1] - times_s[0]) / times_s.len() as f64;
    let correlation = |lag: usize| {
        let pairs = errors.iter().zip(&errors[lag..]);
        let sum: f64 = pairs.map(|(a, b)| (a - mean).dot(&(b - mean))).sum();
        sum / (errors.len() - lag) as f64 / variance
    };
    let lag = (1..errors.len() / 2).find(|lag| correlation(*lag) < INDEPENDENT);
    lag.unwrap_or(errors.len() / 2) as f64 * step_s
}

/// What is scored, and the time offsets that are tried, s: truth minus ranges.
pub struct Alignment {
    span_s: [f64; 2],
    offsets_s: Vec<f64>,
}

impl Alignment {
    pub fn of(name: &str, truth: &Truth, recording: &RangeRecording) -> Self {
        let [from, to] = truth.ends();
        let steps = |most: i32| (-most..=most).map(|k| f64::from(k) * 0.02).collect();
        match name {
            "drone1" => Self {
                span_s: [recording.ranges[0].time_s + 2.0, f64::INFINITY],
                offsets_s: vec![1.08],
            },
            _ if name.starts_with("drone") => Self {
                span_s: [recording.ranges[0].time_s + 2.0, f64::INFINITY],
                offsets_s: steps(100),
            },
            _ => Self { span_s: [from + 4.0, to - 1.0], offsets_s: steps(15) },
        }
    }

    pub fn score(&self, points: &[PathPoint], truth: &Truth) -> Score {
        let [from, to] = truth.ends();
        let mut best: Option<Score> = None;
        for offset_s in &self.offsets_s {
            let used: Vec<&PathPoint> = points
                .iter()
                .filter(|p| p.time_s > self.span_s[0] && p.time_s < self.span_s[1])
                .filter(|p| p.time_s + offset_s > from && p.time_s + offset_s < to)
                .collect();
            let path: Vec<Vector3<f64>> = used.iter().map(|p| p.position_m.into()).collect();
            let truth: Vec<Vector3<f64>> =
                used.iter().map(|p| truth.at(p.time_s + offset_s)).collect();
            let (rotation, translation) = rigid(&path, &truth);
            let pairs = path.iter().zip(&truth);
            let errors: Vec<Vector3<f64>> = pairs
                .map(|(p, t)| rotation.transpose() * (rotation * p + translation - t))
                .collect();
            let nees = errors.iter().zip(&used).map(|(e, p)| {
                let inverse = Matrix3::from(p.covariance_m2).try_inverse();
                inverse.map_or(f64::INFINITY, |inverse| e.dot(&(inverse * e)))
            });
            let nees: Vec<f64> = nees.collect();
            let times_s: Vec<f64> = used.iter().map(|p| p.time_s).collect();
            let score = Score::of(&times_s, &errors, &nees, 3, *offset_s);
            if best.as_ref().is_none_or(|b| score.rmse_m < b.rmse_m) {
                best = Some(score);
            }
        }
        best.expect("an offset")
    }
}

/// Rotation and translation of least squares (Kabsch), from points to targets.
fn rigid(points: &[Vector3<f64>], targets: &[Vector3<f64>]) -> (Matrix3<f64>, Vector3<f64>) {
    let mean = |all: &[Vector3<f64>]| all.iter().sum::<Vector3<f64>>() / all.len().max(1) as f64;
    let (from, to) = (mean(points), mean(targets));
    let pairs = points.iter().zip(targets);
    let cross: Matrix3<f64> = pairs.map(|(p, t)| (t - to) * (p - from).transpose()).sum();
    let svd = cross.svd(true, true);
    let (u, vt) = (svd.u.expect("u"), svd.v_t.expect("v"));
    let sign = (u * vt).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * vt;
    (rotation, to - rotation * from)
}

/// Score in the plane at given times, without alignment.
pub fn planar(points: &[PathPoint], times_s: &[f64], truth: &Truth) -> Score {
    let (mut errors, mut nees) = (Vec::new(), Vec::new());
    for time_s in times_s {
        let at = points.partition_point(|p| p.time_s < *time_s);
        let point = &points[at];
        let mut error = Vector3::from(point.position_m) - truth.at(*time_s);
        error.z = 0.0;
        let mut covariance =
            Matrix3::from(point.covariance_m2) + Matrix3::identity() * (GPS_M * GPS_M);
        covariance[(2, 2)] = 1.0;
        let inverse = covariance.try_inverse().expect("positive");
        nees.push(error.dot(&(inverse * error)));
        errors.push(error);
    }
    Score::of(times_s, &errors, &nees, 2, 0.0)
}

/// Position of robust least squares from a start, and its cost.
fn solve(
    anchors: &[Vector3<f64>],
    epoch: &[RangeSample],
    start: Vector3<f64>,
) -> (f64, Vector3<f64>) {
    let (mut position, mut squares) = (start, f64::INFINITY);
    for _ in 0..20 {
        let (mut information, mut gradient) = (Matrix3::identity() * 1e-3, Vector3::zeros());
        squares = 0.0;
        for range in epoch {
            let difference = position - anchors[range.anchor];
            let direction = difference.normalize();
            let residual = range.range_m - difference.norm();
            // Soft L1 with a scale of 0.1 m, as the reference's first position.
            let root = (1.0 + (residual / 0.1).powi(2)).sqrt();
            information += direction * direction.transpose() / root;
            gradient += direction * residual / root;
            squares += root;
        }
        position += information.cholesky().expect("positive").solve(&gradient);
    }
    (squares, position)
}

/// Robust least squares at each time with four ranges or more, from the position before.
pub fn least_squares(recording: &RangeRecording, truth: &Truth, alignment: &Alignment) -> String {
    let anchors: Vec<Vector3<f64>> =
        recording.anchors.iter().map(|a| a.position_m.into()).collect();
    let centre = anchors.iter().sum::<Vector3<f64>>() / anchors.len() as f64;
    let starts = [0.5, -0.5, 1.5, -1.5].map(|up| centre + Vector3::z() * up);
    let mut position = starts[0];
    let mut points = Vec::new();
    let epochs = recording.ranges.chunk_by(|a, b| a.time_s == b.time_s);
    for epoch in epochs.filter(|e| e.len() >= 4) {
        let found = starts.iter().chain([&position]).map(|start| solve(&anchors, epoch, *start));
        let best = found.min_by(|a, b| a.0.total_cmp(&b.0));
        position = best.expect("a start").1;
        points.push(PathPoint {
            time_s: epoch[0].time_s,
            position_m: position.into(),
            velocity_mps: [0.0; 3],
            quaternion: [1.0, 0.0, 0.0, 0.0],
            rate_rad_s: [0.0; 3],
            rate_covariance: None,
            velocity_sd_mps: [0.0; 3],
            attitude_sd_rad: [0.0; 3],
            covariance_m2: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            filtered_sd_m: 0.0,
            resting: false,
            valid: true,
        });
    }
    format!("least squares RMSE {:.3} m", alignment.score(&points, truth).rmse_m)
}
