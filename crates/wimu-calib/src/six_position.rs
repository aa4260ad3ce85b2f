//! Calibration from six known orientations: each side of the sensor up once.

use core::fmt;

use wimu_model::{ErrorModel, ErrorTerms, Matrix3};

use crate::estimate::{self, Residuals, TermDeviations};
use crate::force;
use crate::outliers::Rejected;
use crate::pose::mean_temperature;
use crate::terms::{PERFECT, Terms, Theta};
use crate::{
    Covariance, Estimate, Face, Gravity, Method, Parameter, Parameters, Pose, Refusal, design,
    input, student,
};

/// Placement error beyond which the sides were not squared at all, rad: 5°, 0.4 % of scale factor.
const MOST_PLACEMENT_RAD: f64 = 0.0873;

/// Degrees of freedom in which six sides show their placement error.
const PLACEMENT_DOF: usize = 6;

/// By how much a position comes back otherwise than before, beyond noise and placement, m/s², until
/// visits of one side show it: what poses of real sensors are predicted to. It counts as this many
/// degrees of freedom of them, ever fewer up to six of them.
const REVISIT_MPS2: f64 = 0.002;
const REVISIT_DOF: f64 = 2.0;
/// 6 / the 5 % point of χ² with six degrees of freedom: what six sides show may be as much more.
const SEEN_AT_MOST: f64 = 3.67;

/// How well the sensor was squared when it was put down.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Placement {
    sd_rad: f64,
}

impl Placement {
    /// 1°, 1 σ about each level axis: by hand, on a table, in a box with square corners.
    pub const BY_HAND: Self = Self {
        sd_rad: core::f64::consts::PI / 180.0,
    };

    /// Standard deviation of the tilt about each level axis, rad, 0..=0.0873 (5°).
    ///
    /// # Errors
    /// [`PlacementError`] when it is outside.
    pub fn new(sd_rad: f64) -> Result<Self, PlacementError> {
        if (0.0..=MOST_PLACEMENT_RAD).contains(&sd_rad) {
            Ok(Self { sd_rad })
        } else {
            Err(PlacementError { sd_rad })
        }
    }

    /// Standard deviation of the tilt about each level axis, rad.
    pub fn sd_rad(self) -> f64 {
        self.sd_rad
    }
}

impl Default for Placement {
    fn default() -> Self {
        Self::BY_HAND
    }
}

/// A placement error outside 0..=0.0873 rad.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlacementError {
    /// What was given, rad.
    pub sd_rad: f64,
}

impl fmt::Display for PlacementError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "the placement's standard deviation, {} rad, is outside 0 to {MOST_PLACEMENT_RAD} rad \
             (5°): square the sensor better, or use multi-position",
            self.sd_rad
        )
    }
}

impl core::error::Error for PlacementError {}

/// Estimates all 12 parameters from poses with one axis upright each, told apart by their dominant
/// component. Equations (18) and (19) of docs/EQUATIONS.md.
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes. Those within 20° of an axis
/// ([`Face::of`]) are used, each of the six sides at least once; several of one side are averaged
/// by their samples. Others are left out of the fit, not of its residuals. Bias and scale factor
/// of an axis come from its own pair of sides alone, where a placement error enters in second
/// order only; misalignments from the other pairs, where it enters in full.
///
/// A sensor whose driver swaps or negates axes is not noticed here: [`six_position_labelled`]
/// notices.
///
/// # Errors
/// [`Refusal`] when the poses cannot support the model; each says what to do.
pub fn six_position(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter(), gravity)?;
    let all = poses.iter().map(|pose| (Face::of(pose), pose));
    estimate(all, gravity, placement)
}

/// The same from poses whose side that is up was noted when they were taken.
///
/// # Errors
/// [`Refusal`], also [`Refusal::Mirrored`], [`Refusal::Inverted`], [`Refusal::AxesSwapped`] and
/// [`Refusal::NotUpright`] when what a pose reads does not go with what was noted.
pub fn six_position_labelled(
    poses: &[(Face, Pose)],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter().map(|(_, pose)| pose), gravity)?;
    check_labels(poses)?;
    let all = poses.iter().map(|(face, pose)| (Some(*face), pose));
    estimate(all, gravity, placement)
}

/// Refuses labels that do not go with what the poses read.
fn check_labels(poses: &[(Face, Pose)]) -> Result<(), Refusal> {
    let Some(&(face, first)) = poses
        .iter()
        .find(|(face, pose)| Face::of(pose) != Some(*face))
    else {
        return Ok(());
    };
    let disagreement = match Face::of(&first) {
        Some(reads) => Refusal::AxesSwapped { face, reads },
        None => Refusal::NotUpright { face },
    };
    // What each axis, pointing up, makes the output say: a signed permutation, if all poses agree.
    let mut says = [None; 3];
    for (face, pose) in poses {
        let Some(reads) = Face::of(pose) else {
            return Err(disagreement);
        };
        let said = (reads.axis(), reads.sign() * face.sign());
        if *says[face.axis()].get_or_insert(said) != said {
            return Err(disagreement);
        }
    }
    let mut permutation = [[0.0; 3]; 3];
    for (axis, said) in says.into_iter().enumerate() {
        if let Some((row, sign)) = said {
            permutation[row][axis] = sign;
        }
    }
    let [[a, b, c], [d, e, f], [g, h, i]] = permutation;
    if (a, e, i) == (-1.0, -1.0, -1.0) {
        return Err(Refusal::Inverted);
    }
    let determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
    Err(if determinant < 0.0 {
        Refusal::Mirrored
    } else {
        disagreement
    })
}

/// Weighted sums of the poses of one side.
#[derive(Clone, Copy, Default)]
struct Side {
    weight: f64,
    /// Σ w² over the poses.
    weight_squares: f64,
    sum: [f64; 3],
    /// Σ w² times the noise of its mean.
    noise: [f64; 3],
    /// Of the readings of the axis that is upright, each visit counting once.
    visits: f64,
    upright: f64,
    upright_squares: f64,
}

impl Side {
    /// Adds a pose, or takes it out again with `sign` −1.
    fn add(&mut self, pose: &Pose, sign: f64) {
        let w = pose.weight();
        self.weight += sign * w;
        self.weight_squares += sign * w * w;
        for axis in 0..3 {
            self.sum[axis] += sign * w * pose.mean_mps2[axis];
            self.noise[axis] += sign * w * w * pose.noise(axis);
        }
    }

    /// One more visit, which reads `upright` on the axis that is.
    fn visit(&mut self, upright: f64) {
        // About the first, which keeps the digits.
        let before = upright
            - if self.visits > 0.0 {
                self.upright / self.visits
            } else {
                upright
            };
        self.visits += 1.0;
        self.upright += upright;
        self.upright_squares += before * before * (self.visits - 1.0) / self.visits;
    }

    fn mean(&self) -> [f64; 3] {
        self.sum.map(|s| s / self.weight)
    }

    /// Variance of the mean from the sensor's noise.
    fn noise_variance(&self) -> [f64; 3] {
        self.noise.map(|n| n / (self.weight * self.weight))
    }

    /// 1 / how many poses of equal weight this would be.
    fn share(&self) -> f64 {
        self.weight_squares / (self.weight * self.weight)
    }
}

/// The six sides in the order of [`Face::ALL`].
type Sides = [Side; 6];

/// b and A from the six sides: equation (18).
fn solve(sides: &Sides, gravity_mps2: f64) -> ErrorTerms {
    let mut terms = ErrorTerms::default();
    for axis in 0..3 {
        let (up, down) = (sides[2 * axis].mean(), sides[2 * axis + 1].mean());
        terms.bias_mps2[axis] = 0.5 * (up[axis] + down[axis]);
        for row in 0..3 {
            terms.matrix[row][axis] = (up[row] - down[row]) / (2.0 * gravity_mps2);
        }
    }
    terms
}

fn estimate<'a>(
    poses: impl Iterator<Item = (Option<Face>, &'a Pose)> + Clone,
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    let used = poses
        .clone()
        .filter_map(|(face, pose)| Some((face? as usize, pose)));
    let g = gravity.mps2();
    let mut sides = Sides::default();
    let mut counts = [0_usize; 6];
    for (side, pose) in used.clone() {
        sides[side].add(pose, 1.0);
        sides[side].visit(pose.mean_mps2[side / 2]);
        counts[side] += 1;
    }
    for (face, count) in Face::ALL.into_iter().zip(counts) {
        if count == 0 {
            return Err(Refusal::PoseMissing { face });
        }
    }
    let terms = solve(&sides, g);
    let model = ErrorModel::new(terms).map_err(Refusal::OutOfBounds)?;
    let seen = placement_seen(&sides, &terms, g);
    if seen > MOST_PLACEMENT_RAD {
        return Err(Refusal::NotSquared {
            placement_rad: seen,
        });
    }
    // What was declared holds unless the poses contradict it beyond chance.
    let most = student::chi_squared_half_percent(PLACEMENT_DOF) / PLACEMENT_DOF as f64;
    let contradicted = seen * seen > most * placement.sd_rad * placement.sd_rad;
    let placement_sd_rad = if contradicted { seen } else { placement.sd_rad };
    let revisits = Revisits::of(&sides, &terms.matrix, g, placement_sd_rad, seen * g);
    let covariance_with =
        |extra: f64| covariance(&sides, &terms.matrix, g, placement_sd_rad, extra);
    let mut covariance = covariance_with(revisits.variance);
    let known = covariance_with(0.0);
    let dof_of = |parameter: Parameter| {
        let all = covariance.get(parameter, parameter);
        let share = (all - known.get(parameter, parameter)) / all;
        if share > 0.0 {
            revisits.dof / (share * share)
        } else {
            f64::INFINITY
        }
    };
    let diagonal = Parameter::BIAS.into_iter().chain([
        Parameter::ScaleX,
        Parameter::ScaleY,
        Parameter::ScaleZ,
    ]);
    let interval_dof = diagonal.map(dof_of).fold(
        if contradicted {
            PLACEMENT_DOF as f64
        } else {
            f64::INFINITY
        },
        f64::min,
    );
    let theta = theta(&terms);
    let worst_sd_mps2 = force::worst_sd(&theta, &covariance, g);
    covariance.add_gravity(&theta, gravity);

    let mut residuals = Residuals::default();
    let mut rejected = Rejected::default();
    for (k, (face, pose)) in poses.clone().enumerate() {
        residuals.add(k, estimate::residual_mps2(&model, gravity, pose));
        if face.is_none() {
            rejected = rejected.with(k);
        }
    }
    let fitted: usize = counts.iter().sum();
    let loo_rms_mps2 = counts.iter().all(|&count| count > 1).then(|| {
        let squares: f64 = used
            .clone()
            .map(|(side, pose)| {
                let mut others = sides;
                others[side].add(pose, -1.0);
                let left = ErrorModel::new(solve(&others, g)).map_or(f64::INFINITY, |m| {
                    estimate::residual_mps2(&m, gravity, pose)
                });
                left * left
            })
            .sum();
        libm::sqrt(squares / fitted as f64)
    });
    Ok(Estimate {
        model,
        method: Method::SixPosition {
            placement_sd_rad,
            revisit_sd_mps2: libm::sqrt(revisits.variance),
            revisits: revisits.seen,
            unexplained: revisits.unexplained,
        },
        terms: Terms::NONE,
        fitted: Parameters::ALL,
        covariance,
        term_sd: TermDeviations::default(),
        gravity,
        poses: fitted,
        dof: 3 * fitted - Parameter::COUNT,
        interval_dof: Some(interval_dof).filter(|dof| dof.is_finite()),
        rms_mps2: residuals.rms_mps2(),
        max_mps2: residuals.largest_mps2,
        worst_pose: residuals.worst_pose,
        loo_rms_mps2,
        rejected,
        // Half sums and half differences of pairs: their design is orthogonal.
        condition: 1.0,
        worst_sd_mps2,
        coverage: coverage(&sides),
        temperature_c: mean_temperature(used.map(|(_, pose)| pose)),
        temperature_range_c: None,
        drift: None,
    })
}

fn coverage(sides: &Sides) -> f64 {
    design::coverage(&sides.each_ref().map(|side| Pose::from_mean(side.mean())))
}

fn theta(terms: &ErrorTerms) -> Theta<f64> {
    let mut theta = PERFECT;
    for axis in 0..3 {
        theta[axis] = terms.bias_mps2[axis];
        for column in 0..3 {
            theta[3 + 3 * axis + column] = terms.matrix[axis][column];
        }
    }
    theta
}

/// The placement error that the poses show, rad rms over six degrees of freedom: the other two
/// axes of each pair say the bias again, with the tilts added.
fn placement_seen(sides: &Sides, terms: &ErrorTerms, gravity_mps2: f64) -> f64 {
    let mut squares = 0.0;
    for axis in 0..3 {
        let (up, down) = (&sides[2 * axis], &sides[2 * axis + 1]);
        let share = 0.25 * (up.share() + down.share());
        for other in (0..3).filter(|&other| other != axis) {
            let middle = 0.5 * (up.mean()[other] + down.mean()[other]);
            let tilt =
                (middle - terms.bias_mps2[other]) / (terms.matrix[other][other] * gravity_mps2);
            squares += tilt * tilt / share;
        }
    }
    libm::sqrt(squares / PLACEMENT_DOF as f64)
}

/// What differs from visit to visit beyond noise and placement: equation (19).
struct Revisits {
    /// (m/s²)².
    variance: f64,
    /// Its degrees of freedom, what is known beforehand included.
    dof: f64,
    /// Visits beyond the first of each side.
    seen: usize,
    /// Whether they differ by more than noise and placement explain.
    unexplained: bool,
}

impl Revisits {
    fn of(sides: &Sides, a: &Matrix3, g: f64, placement_rad: f64, seen_mps2: f64) -> Self {
        let tilt = placement_rad * placement_rad;
        let (mut squares, mut dof, mut noise, mut explained) = (0.0, 0.0, 0.0, 0.0);
        for (index, side) in sides.iter().enumerate() {
            let axis = index / 2;
            let across: f64 = (0..3)
                .map(|other| if other == axis { tilt } else { 1.0 } * a[axis][other] * a[axis][other])
                .sum();
            let own = side.noise_variance()[axis] / side.share();
            squares += side.upright_squares;
            dof += side.visits - 1.0;
            noise += own / 6.0;
            explained += (own + g * g * tilt * across) / 6.0;
        }
        let taken = (REVISIT_MPS2 * REVISIT_MPS2).min(SEEN_AT_MOST * seen_mps2 * seen_mps2);
        let taken = (taken - noise).max(0.0);
        let beyond = (squares - dof * explained).max(0.0);
        let seen = dof as usize;
        let more = REVISIT_DOF * (1.0 - dof / 6.0).max(0.0);
        Self {
            variance: (beyond + more * taken) / (dof + more),
            dof: dof + more,
            seen,
            unexplained: seen > 0 && squares > student::chi_squared_half_percent(seen) * explained,
        }
    }
}

/// Covariance from placement, noise and `revisit`, the variance of what else differs from visit to
/// visit: equation (19).
fn covariance(
    sides: &Sides,
    a: &Matrix3,
    gravity_mps2: f64,
    placement_rad: f64,
    revisit: f64,
) -> Covariance {
    let g = gravity_mps2;
    let tilt = placement_rad * placement_rad;
    let mut covariance = Covariance::ZERO;
    for axis in 0..3 {
        // Of a side's mean output: tilts bring in the other two columns of A in first order and
        // shorten this one in second.
        let of = |side: &Side, r: usize, c: usize| {
            let first: f64 = (0..3)
                .filter(|&other| other != axis)
                .map(|other| a[r][other] * a[c][other])
                .sum();
            let second = tilt * a[r][axis] * a[c][axis];
            let noise = if r == c {
                side.noise_variance()[r] + revisit * side.share()
            } else {
                0.0
            };
            tilt * (first + second) * g * g * side.share() + noise
        };
        let (up, down) = (&sides[2 * axis], &sides[2 * axis + 1]);
        let both = |r, c| of(up, r, c) + of(down, r, c);
        let bias = Parameter::ALL[axis];
        covariance.add(bias, bias, 0.25 * both(axis, axis));
        for r in 0..3 {
            let row = Parameter::ALL[3 + 3 * r + axis];
            let cross = (of(up, axis, r) - of(down, axis, r)) / (4.0 * g);
            covariance.add(bias, row, cross);
            covariance.add(row, bias, cross);
            for c in 0..3 {
                let column = Parameter::ALL[3 + 3 * c + axis];
                // Both sides are shortened on average: a systematic part that does not average out.
                let shortened = tilt * tilt * a[r][axis] * a[c][axis];
                covariance.add(row, column, both(r, c) / (4.0 * g * g) + shortened);
            }
        }
    }
    covariance
}
