//! Gauss–Newton of equations (200) to (204): the camera's pose in the body, one frame for each block, Student weights.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3};

use super::stream::{PoseStream, StreamPose};

/// Parameters of the answer: rotation, translation, clock offset, scale of the camera's positions.
pub(super) const SHARED: usize = 8;
/// Parameters of a block: rotation and position of the frames, then the drift of a gyroscope.
const BLOCK: usize = 9;
/// Degrees of freedom of Student's t: heavy tails of poses that jump (Lange, Little & Taylor 1989).
const STUDENT_DOF: f64 = 4.0;
/// Part of the curvature of Student's log-likelihood that its weights have, of three components.
const CURVATURE: f64 = 2.0 / (STUDENT_DOF + 3.0);
/// Standard deviation of the scale error of a camera's positions. Chosen on `camera/falcon_3`, `prime_sense_1`: −2 to 6 %.
const SCALE_SD: f64 = 0.05;
/// Standard deviation of the clock offset after its search, s.
const OFFSET_SD_S: f64 = 0.1;
/// Standard deviation of a translation before the data, m: weak.
const TRANSLATION_SD_M: f64 = 10.0;
/// Least standard deviations of a rotation, rad, and of a position, m: rounding of poses in files.
const ROUNDING: [f64; 2] = [1e-6, 1e-6];
/// Gauss–Newton steps at most, and the step that ends them, rad, m or s.
const STEPS: usize = 40;
const SETTLED: f64 = 1e-8;
/// Groups of neighbouring poses whose errors are taken as independent: their least number, and their length, s.
const GROUPS: usize = 20;
const GROUP_S: f64 = 3.0;
/// An eigenvalue below this fraction of the largest one is none.
const RANK: f64 = 1e-9;

type Shared = SMatrix<f64, SHARED, SHARED>;
type Gradient = SVector<f64, SHARED>;

/// Frames of a block.
#[derive(Clone, Copy, Debug)]
struct Frames {
    /// Rotation from the camera's frame to the body's.
    rotation: UnitQuaternion<f64>,
    /// Position of the camera's frame in the body's, m.
    position_m: Vector3<f64>,
    /// Drift of the body's rotation over half a block, rad, body axes.
    rotation_drift: Vector3<f64>,
}

/// What is estimated.
#[derive(Clone, Debug)]
pub(super) struct State {
    /// Camera axes to body axes.
    pub rotation: UnitQuaternion<f64>,
    /// Camera in the body, m, body axes.
    pub translation_m: Vector3<f64>,
    /// Time of the body's clock less that of the camera's, s.
    pub offset_s: f64,
    /// Scale error of the camera's positions.
    pub scale: f64,
    frames: Vec<Frames>,
}

/// A pose of the camera and where it is in its block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    pub pose: StreamPose,
    pub block: usize,
    /// Time from the block's middle over half its length.
    pub phase: f64,
}

/// Residual of one pose with its weight.
#[derive(Clone, Copy, Debug)]
pub struct Residual {
    /// Time of the camera's clock, s.
    pub time_s: f64,
    /// Rotation, rad.
    pub rotation_rad: f64,
    /// Position, m.
    pub position_m: f64,
    /// Lower of its two weights: 1.75 for a pose without error, towards 0 for one that contradicts the others.
    pub weight: f64,
}

/// Result of [`fit`].
pub(super) struct Fit {
    pub state: State,
    /// Of the shared parameters, with the Birge ratio.
    pub covariance: Shared,
    /// The same if the noise were white: what the data do not show has its prior here.
    pub white: Shared,
    /// Birge ratio: scatter of the blocks over what white noise would do.
    pub birge: f64,
    /// Standard deviations of the noise: rotation, rad, and position, m, of each component.
    pub noise: [f64; 2],
    pub residuals: Vec<Residual>,
}

impl Fit {
    /// Largest standard deviation of any direction of three parameters from `first` on.
    pub fn worst_sd(&self, first: usize) -> f64 {
        let of = |covariance: &Shared| {
            let part = covariance.fixed_view::<3, 3>(first, first).into_owned();
            part.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        of(&self.covariance).max(of(&self.white))
    }
}

/// Equations of one block.
#[derive(Clone)]
struct Normal {
    xx: Shared,
    xy: SMatrix<f64, SHARED, BLOCK>,
    yy: SMatrix<f64, BLOCK, BLOCK>,
    x: Gradient,
    y: SVector<f64, BLOCK>,
}

/// A row of six residuals: rotation, position.
struct Row {
    block: usize,
    time_s: f64,
    rotation: Vector3<f64>,
    position: Vector3<f64>,
    shared: SMatrix<f64, 6, SHARED>,
    own: SMatrix<f64, 6, BLOCK>,
}

impl Row {
    fn rotation_square(&self) -> f64 {
        self.rotation.norm_squared()
    }

    fn position_square(&self) -> f64 {
        self.position.norm_squared()
    }
}

impl State {
    /// The state of a rotation and a clock offset, everything else from medians and zero.
    pub fn begin(
        rotation: UnitQuaternion<f64>,
        offset_s: f64,
        body: &PoseStream,
        observations: &[Observation],
        blocks: usize,
    ) -> Self {
        let frames = |block: usize| {
            let own = observations.iter().filter(|o| o.block == block);
            let pairs = own.filter_map(|o| Some((o, body.at(o.pose.time_s + offset_s)?)));
            let pairs: Vec<_> = pairs.collect();
            let turned = |(o, body): &(&Observation, super::stream::Interpolated)| {
                body.rotation * rotation * o.pose.rotation.inverse()
            };
            let middle = pairs.get(pairs.len() / 2).map(turned).unwrap_or_default();
            let mean = pairs.iter().map(turned).fold(Vector3::zeros(), |sum, r| {
                sum + (middle.inverse() * r).scaled_axis() / pairs.len() as f64
            });
            let rotation = middle * UnitQuaternion::from_scaled_axis(mean);
            let count = pairs.len().max(1) as f64;
            let apart =
                pairs.iter().map(|(o, body)| body.position_m - rotation * o.pose.position_m);
            let position = apart.sum::<Vector3<f64>>() / count;
            Frames { rotation, position_m: position, rotation_drift: Vector3::zeros() }
        };
        Self {
            rotation,
            translation_m: Vector3::zeros(),
            offset_s,
            scale: 0.0,
            frames: (0..blocks).map(frames).collect(),
        }
    }

    /// Residuals and derivatives of one pose; `None` where the body has no pose.
    fn row(&self, observation: &Observation, body: &PoseStream) -> Option<Row> {
        let (camera, u) = (&observation.pose, observation.phase);
        let at = body.at(camera.time_s + self.offset_s)?;
        let frames = &self.frames[observation.block];
        let turn = at.rotation * UnitQuaternion::from_scaled_axis(frames.rotation_drift * u);
        let placed = frames.rotation * camera.position_m;
        let arm = turn * self.translation_m;
        let error = (turn * self.rotation).inverse() * frames.rotation * camera.rotation;
        let rotation = error.scaled_axis();
        let position = placed * (1.0 + self.scale) + frames.position_m - at.position_m - arm;
        // Inverse left Jacobian of SO(3), to first order of the residual (Barfoot 2017, equation 7.76).
        let jacobian = Matrix3::identity() - rotation.cross_matrix() * 0.5;
        let to_camera = self.rotation.inverse().to_rotation_matrix();

        let mut shared = SMatrix::<f64, 6, SHARED>::zeros();
        shared.fixed_view_mut::<3, 3>(0, 0).copy_from(&-jacobian);
        let rate = -(jacobian * (to_camera * at.rate_rad_s));
        shared.fixed_view_mut::<3, 1>(0, 6).copy_from(&rate);
        let mut own = SMatrix::<f64, 6, BLOCK>::zeros();
        let left = jacobian * (turn * self.rotation).inverse().to_rotation_matrix();
        own.fixed_view_mut::<3, 3>(0, 0).copy_from(&left);
        if body.inertial {
            let drift = -(jacobian * to_camera.matrix()) * u;
            own.fixed_view_mut::<3, 3>(0, 6).copy_from(&drift);
        } else {
            let turned = -turn.to_rotation_matrix().into_inner();
            shared.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
            let velocity = -at.velocity_mps - turn * at.rate_rad_s.cross(&self.translation_m);
            shared.fixed_view_mut::<3, 1>(3, 6).copy_from(&velocity);
            shared.fixed_view_mut::<3, 1>(3, 7).copy_from(&placed);
            let lever = -placed.cross_matrix() * (1.0 + self.scale);
            own.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
            own.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
        }
        Some(Row {
            block: observation.block,
            time_s: camera.time_s,
            rotation,
            position,
            shared,
            own,
        })
    }

    /// Adds a step of the shared parameters and the one that follows from it in each block.
    fn add(&mut self, step: &Gradient, normals: &[Normal]) {
        self.rotation *= UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        self.translation_m += step.fixed_rows::<3>(3);
        self.offset_s += step[6];
        self.scale += step[7];
        for (frames, normal) in self.frames.iter_mut().zip(normals) {
            let right = -(normal.y + normal.xy.transpose() * step);
            let own = normal.yy.cholesky().map_or_else(SVector::zeros, |c| c.solve(&right));
            let turn = UnitQuaternion::from_scaled_axis(own.fixed_rows::<3>(0).into_owned());
            frames.rotation = turn * frames.rotation;
            frames.position_m += own.fixed_rows::<3>(3);
            frames.rotation_drift += own.fixed_rows::<3>(6);
        }
    }
}

/// Weights of Student's t for squared residuals of three components, and their variance: a few EM steps.
fn student(squares: &[f64], variance: &mut f64, least: f64) -> Vec<f64> {
    let weight =
        |square: &f64, variance: f64| (STUDENT_DOF + 3.0) / (STUDENT_DOF + square / variance);
    for _ in 0..5 {
        let sum: f64 = squares.iter().map(|s| weight(s, *variance) * s).sum();
        *variance = (sum / (3.0 * squares.len() as f64)).max(least);
    }
    squares.iter().map(|s| weight(s, *variance)).collect()
}

/// Median of squared residuals of three components over that of χ² with three degrees of freedom (2.37).
fn initial_variance(squares: &[f64], least: f64) -> f64 {
    let median = crate::stats::median(squares.iter().copied()).unwrap_or(0.0);
    (median / 2.37).max(least)
}

impl Normal {
    fn zero() -> Self {
        Self {
            xx: Shared::zeros(),
            xy: SMatrix::zeros(),
            yy: SMatrix::zeros(),
            x: Gradient::zeros(),
            y: SVector::zeros(),
        }
    }

    /// Adds a row. `curvature` 0 gives the equations of reweighted least squares; 2/(ν + 3) those of Newton, with the change
    /// of the weights: what a standard deviation must be computed from.
    fn push(&mut self, row: &Row, weights: [f64; 2], curvature: f64) {
        let mut weight = Matrix6::zeros();
        let mut weighted = nalgebra::Vector6::zeros();
        for (k, residual) in [row.rotation, row.position].into_iter().enumerate() {
            let outer = residual * residual.transpose() * (curvature * weights[k] * weights[k]);
            let part = Matrix3::from_diagonal_element(weights[k]) - outer;
            weight.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(&part);
            weighted.fixed_rows_mut::<3>(3 * k).copy_from(&(residual * weights[k]));
        }
        let (xw, yw) = (row.shared.transpose() * weight, row.own.transpose() * weight);
        self.xx += xw * row.shared;
        self.xy += xw * row.own;
        self.yy += yw * row.own;
        self.x += row.shared.transpose() * weighted;
        self.y += row.own.transpose() * weighted;
    }

    /// The same without some of its poses, at the solution: information, and gradient of those that are left.
    fn without(&self, part: &Self) -> (Shared, Gradient) {
        let Some(own) = (self.yy - part.yy).cholesky() else {
            return (Shared::zeros(), -part.x);
        };
        let xy = self.xy - part.xy;
        let information = self.xx - part.xx - xy * own.solve(&xy.transpose());
        (information, xy * own.solve(&part.y) - part.x)
    }

    /// Information and gradient of the shared parameters, the block's own eliminated (Schur complement).
    fn reduced(&self) -> (Shared, Gradient) {
        let Some(own) = self.yy.cholesky() else {
            return (Shared::zeros(), Gradient::zeros());
        };
        let xx = self.xx - self.xy * own.solve(&self.xy.transpose());
        (xx, self.x - self.xy * own.solve(&self.y))
    }
}

/// The equations at one state.
struct Equations {
    rows: Vec<Row>,
    /// Weights of rotation and position of each row over their variances.
    weights: Vec<[f64; 2]>,
    normals: Vec<Normal>,
    reduced: Vec<(Shared, Gradient)>,
    /// Information of the shared parameters with its prior.
    information: Shared,
    step: Gradient,
}

impl Equations {
    /// At `state`; the variances of rotation and position are updated. `None` if they are singular.
    fn at(
        state: &State,
        body: &PoseStream,
        observations: &[Observation],
        searched_s: f64,
        variances: &mut Option<[f64; 2]>,
        curvature: f64,
    ) -> Option<Self> {
        let rows = observations.iter().filter_map(|o| state.row(o, body));
        let rows: Vec<Row> = rows.collect();
        if rows.is_empty() {
            return None;
        }
        let least = ROUNDING.map(|sd| sd * sd);
        let squares = [Row::rotation_square, Row::position_square]
            .map(|square| rows.iter().map(square).collect::<Vec<f64>>());
        let variances = variances.get_or_insert_with(|| {
            std::array::from_fn(|k| initial_variance(&squares[k], least[k]))
        });
        let [r, p] = std::array::from_fn(|k| student(&squares[k], &mut variances[k], least[k]));
        let weights = r.iter().zip(&p).map(|(r, p)| [r / variances[0], p / variances[1]]);
        let weights: Vec<[f64; 2]> = weights.collect();
        let mut normals = vec![Normal::zero(); state.frames.len()];
        for (row, weights) in rows.iter().zip(&weights) {
            normals[row.block].push(row, *weights, curvature);
        }
        for normal in &mut normals {
            for k in 0..BLOCK {
                // What the stream does not have, and blocks without poses.
                if normal.yy[(k, k)] == 0.0 {
                    normal.yy[(k, k)] = 1.0;
                }
            }
        }
        let reduced: Vec<(Shared, Gradient)> = normals.iter().map(Normal::reduced).collect();
        let mut precision = Gradient::repeat(TRANSLATION_SD_M.powi(-2));
        precision.fixed_rows_mut::<3>(0).fill(0.0);
        (precision[6], precision[7]) = (OFFSET_SD_S.powi(-2), SCALE_SD.powi(-2));
        let mut deviation = Gradient::zeros();
        let translation = deviation.fixed_rows_mut::<3>(3);
        { translation }.copy_from(&state.translation_m);
        (deviation[6], deviation[7]) = (state.offset_s - searched_s, state.scale);
        let prior = Shared::from_diagonal(&precision);
        let information = reduced.iter().map(|r| r.0).sum::<Shared>() + prior;
        let gradient = reduced.iter().map(|r| r.1).sum::<Gradient>() + prior * deviation;
        let solved = information.cholesky()?;
        Some(Self { step: -solved.solve(&gradient), information, rows, weights, normals, reduced })
    }

    /// Normal equations of groups of neighbouring poses, each with its block.
    fn groups(&self) -> Vec<(usize, Normal)> {
        let seconds = self.rows[self.rows.len() - 1].time_s - self.rows[0].time_s;
        let count = GROUPS.max((seconds / GROUP_S) as usize);
        let mut groups: Vec<(usize, usize, Normal)> = Vec::new();
        for (k, (row, weights)) in self.rows.iter().zip(&self.weights).enumerate() {
            let group = k * count / self.rows.len();
            if !matches!(groups.last(), Some(last) if (last.0, last.1) == (group, row.block)) {
                groups.push((group, row.block, Normal::zero()));
            }
            if let Some((.., normal)) = groups.last_mut() {
                normal.push(row, *weights, CURVATURE);
            }
        }
        groups.into_iter().map(|(_, block, normal)| (block, normal)).collect()
    }

    /// Covariance from the changes of the answer when one part after the other is left out: errors within a part may be correlated.
    /// The residuals are scaled for the leverage of their part (CR2 of Bell & McCaffrey 2002). The sum is divided by what white
    /// noise makes of it: a block that loses a part of its poses also loses what these show of its own parameters, so that the
    /// losses of information add up to more than the whole.
    fn scatter(&self, parts: &[(usize, Normal)]) -> Option<Shared> {
        let whiten = self.information.cholesky()?.l().try_inverse()?;
        let (mut sum, mut expected) = (Shared::zeros(), Shared::zeros());
        for (block, part) in parts {
            let (information, gradient) = self.normals[*block].without(part);
            let others = self.information - self.reduced[*block].0 + information;
            let remaining = (whiten * others * whiten.transpose()).symmetric_eigen();
            let axes = &remaining.eigenvectors;
            // A direction that only this part shows has no residual.
            let scale = remaining.eigenvalues.map(root_reciprocal);
            let lost = remaining.eigenvalues.map(|r| if r > RANK { 1.0 - r } else { 0.0 });
            let change = axes * scale.component_mul(&(axes.transpose() * (whiten * gradient)));
            sum += change * change.transpose();
            expected += axes * Shared::from_diagonal(&lost) * axes.transpose();
        }
        let expected = expected.symmetric_eigen();
        let axes = &expected.eigenvectors;
        let scale = Shared::from_diagonal(&expected.eigenvalues.map(root_reciprocal));
        let root = whiten.transpose() * axes * scale * axes.transpose();
        Some(root * sum * root.transpose())
    }
}

/// 1/√x; 0 where x is 0 but for rounding.
fn root_reciprocal(x: f64) -> f64 {
    if x > RANK { x.sqrt().recip() } else { 0.0 }
}

/// Fits; `None` if the equations are singular.
pub(super) fn fit(
    mut state: State,
    body: &PoseStream,
    observations: &[Observation],
) -> Option<Fit> {
    let searched_s = state.offset_s;
    let mut variances = None;
    for _ in 0..STEPS {
        let equations = Equations::at(&state, body, observations, searched_s, &mut variances, 0.0)?;
        state.add(&equations.step, &equations.normals);
        if equations.step.amax() < SETTLED {
            break;
        }
    }
    let equations =
        Equations::at(&state, body, observations, searched_s, &mut variances, CURVATURE)?;
    let variances = variances?;
    let groups = equations.groups();
    let blocks: Vec<(usize, Normal)> = equations.normals.iter().cloned().enumerate().collect();
    let scatter = [equations.scatter(&groups)?, equations.scatter(&blocks)?];
    let white = equations.information.try_inverse()?;
    let (birge, dof) = birge(&scatter, &white, blocks.len());
    // Variance of Student's t with the degrees of freedom of the Birge ratio.
    let covariance = scatter[0] * (birge.max(1.0) * dof / (dof - 2.0));
    let residuals = equations.rows.iter().zip(&equations.weights);
    let residuals = residuals.map(|(row, weights)| Residual {
        time_s: row.time_s,
        rotation_rad: row.rotation.norm(),
        position_m: row.position.norm(),
        weight: f64::min(weights[0] * variances[0], weights[1] * variances[1]),
    });
    let finite = covariance.iter().all(|c: &f64| c.is_finite());
    finite.then_some(Fit {
        residuals: residuals.collect(),
        state,
        covariance,
        white,
        birge,
        noise: variances.map(f64::sqrt),
    })
}

/// Scatter of the blocks over that of the groups of poses (Birge 1932), and its degrees of freedom. Both must be unbiased: a block
/// has more leverage than a group.
fn birge([groups, blocks]: &[Shared; 2], white: &Shared, count: usize) -> (f64, f64) {
    // What has its prior only scatters by rounding.
    let recip = |d: f64, white: f64| if d > RANK * white { d.sqrt().recip() } else { 0.0 };
    let scale = groups.diagonal().zip_map(&white.diagonal(), recip);
    let scaled =
        |matrix: &Shared| Shared::from_diagonal(&scale) * matrix * Shared::from_diagonal(&scale);
    let eigen = scaled(groups).symmetric_eigen();
    let rotated = eigen.eigenvectors.transpose() * scaled(blocks) * eigen.eigenvectors;
    let largest = eigen.eigenvalues.max();
    let shown = (0..SHARED).filter(|k| eigen.eigenvalues[*k] > RANK * largest);
    let ratios: Vec<f64> = shown.map(|k| rotated[(k, k)] / eigen.eigenvalues[k]).collect();
    let dof = (ratios.len() * (count - 1)) as f64;
    (ratios.iter().sum::<f64>() / ratios.len() as f64, dof)
}
