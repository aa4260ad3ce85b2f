//! Simulated sensors and real recordings for the tests.

#![allow(dead_code, reason = "each test file uses its own part of it")]

use std::path::PathBuf;

use proptest::test_runner::Config as ProptestConfig;
use wimu_calib::{Gravity, MagneticPose, MultiPosition, Pose, Terms};
use wimu_model::{Alignment, ErrorModel, ErrorTerms, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
pub use wimu_testkit::Random;

/// The gravity of the simulated tests, m/s².
pub const G: f64 = STANDARD_GRAVITY_MPS2;

/// Nine parameters that the poses alone determine; the same without outliers; and with priors.
pub const NINE: MultiPosition = MultiPosition { terms: Terms::NONE, priors: false, reject: false };
pub const ROBUST: MultiPosition = MultiPosition { reject: true, ..NINE };
pub const AUTO: MultiPosition = MultiPosition { priors: true, ..ROBUST };

/// Gravity that is known exactly.
pub fn exact() -> Gravity {
    Gravity::new(G, 0.0).expect("gravity")
}

/// Failures print their seed; nothing is written beside the tests.
pub fn config() -> ProptestConfig {
    ProptestConfig { failure_persistence: None, ..ProptestConfig::default() }
}

/// Draws error models.
pub trait DrawModel {
    /// Bias up to 80 mg, scale factor ±4 %, misalignment ±2°; lower triangular or full.
    fn model(&mut self, triangular: bool) -> ErrorModel;
}

impl DrawModel for Random {
    fn model(&mut self, triangular: bool) -> ErrorModel {
        let mut terms = ErrorTerms::default();
        for row in 0..3 {
            terms.bias_mps2[row] = self.within(0.08 * STANDARD_GRAVITY_MPS2);
            for column in 0..3 {
                terms.matrix[row][column] = if row == column {
                    1.0 + self.within(0.04)
                } else if triangular && column > row {
                    0.0
                } else {
                    self.within(0.035)
                };
            }
        }
        ErrorModel::new(terms).expect("within bounds")
    }
}

/// What a sensor puts out with `up` upward.
pub fn pose(model: &ErrorModel, gravity: f64, up: [f64; 3]) -> Pose {
    let force = SpecificForceMps2(up.map(|c| c * gravity));
    Pose::from_mean(model.distort(force, None).0)
}

/// Noise of `sd`, m/s², on the mean.
pub fn jitter(random: &mut Random, pose: &mut Pose, sd: f64) {
    for y in &mut pose.mean_mps2 {
        *y += random.normal() * sd;
    }
}

/// The twelve vertices of an icosahedron: well spread, none along an axis.
pub fn twelve() -> [[f64; 3]; 12] {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let norm = (1.0 + golden * golden).sqrt();
    let (short, long) = (1.0 / norm, golden / norm);
    let mut all = [[0.0; 3]; 12];
    for (k, vertex) in all.iter_mut().enumerate() {
        let a = if k & 1 == 0 { short } else { -short };
        let b = if k & 2 == 0 { long } else { -long };
        vertex[k / 4] = 0.0;
        vertex[(k / 4 + 1) % 3] = a;
        vertex[(k / 4 + 2) % 3] = b;
    }
    all
}

/// Twelve well spread directions and `more` random ones.
pub fn ups(random: &mut Random, more: usize) -> Vec<[f64; 3]> {
    let mut ups = twelve().to_vec();
    ups.extend((0..more).map(|_| random.direction()));
    ups
}

/// `up` as a person places it: off by `sd_rad` about each of two axes.
pub fn misplaced(random: &mut Random, up: [f64; 3], sd_rad: f64) -> [f64; 3] {
    // Two directions at right angles to `up`.
    let other = if up[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let a = unit(cross(up, other));
    let b = cross(up, a);
    let (s, t) = (random.normal() * sd_rad, random.normal() * sd_rad);
    unit([0, 1, 2].map(|i| up[i] + s * a[i] + t * b[i]))
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

pub fn unit(v: [f64; 3]) -> [f64; 3] {
    let norm = norm(v);
    v.map(|c| c / norm)
}

/// Bias, then A row by row, as `Parameter::ALL` orders them.
pub fn parameters(model: &ErrorModel) -> [f64; 12] {
    let terms = model.terms();
    let mut all = [0.0; 12];
    all[..3].copy_from_slice(&terms.bias_mps2);
    for row in 0..3 {
        all[3 + 3 * row..6 + 3 * row].copy_from_slice(&terms.matrix[row]);
    }
    all
}

/// The rows of a recording beside the repository, or `None`, saying so, where it is absent.
pub fn recording(name: &str) -> Option<Vec<Vec<String>>> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("SKIPPED: {} is absent", path.display());
        return None;
    };
    let rows = text.lines().skip(1);
    Some(rows.map(|row| row.split(',').map(str::to_owned).collect()).collect())
}

/// Three columns of a row as numbers times `scale`.
pub fn vector(row: &[String], column: usize, scale: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| row[column + i].parse::<f64>().expect("a number") * scale)
}

/// The magnetometer's field, nT, and its dip, rad.
pub const FIELD: f64 = 48_000.0;
pub const DIP: f64 = 1.1;

/// Soft iron of determinant one, hard iron, the rotation, and what is seen in `count` orientations.
pub fn magnetometer(
    random: &mut Random,
    count: usize,
    noise_nt: f64,
) -> ([f64; 6], [f64; 3], Alignment, Vec<MagneticPose>) {
    let mut s = [0, 1, 2, 3, 4, 5]
        .map(|k| if k < 3 { 1.0 + random.within(0.15) } else { random.within(0.08) });
    let m = |s: &[f64; 6]| [[s[0], s[3], s[4]], [s[3], s[1], s[5]], [s[4], s[5], s[2]]];
    let a = m(&s);
    let determinant = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1])
        - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0])
        + a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
    s = s.map(|x| x / determinant.cbrt());
    let hard = [0; 3].map(|_| random.within(60_000.0));
    let q = [0; 4].map(|_| random.normal());
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let turn = q.map(|x| x / norm);
    let to_accelerometer = Alignment::from_quaternion(turn).unwrap();
    let back = Alignment::from_quaternion([turn[0], -turn[1], -turn[2], -turn[3]]).unwrap();
    let poses = (0..count)
        .map(|_| {
            let up = random.direction();
            let side = unit(cross(up, random.direction()));
            let field: [f64; 3] =
                std::array::from_fn(|i| FIELD * (DIP.cos() * side[i] - DIP.sin() * up[i]));
            let own = back.rotate(field);
            let a = m(&s);
            MagneticPose {
                output_nt: std::array::from_fn(|r| {
                    hard[r]
                        + (0..3).map(|c| a[r][c] * own[c]).sum::<f64>()
                        + noise_nt * random.normal()
                }),
                up: up.map(|u| 9.81 * u),
            }
        })
        .collect();
    (s, hard, to_accelerometer, poses)
}
