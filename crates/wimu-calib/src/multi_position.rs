//! Calibration from the magnitude of gravity alone: any orientations, none of them known.

use core::fmt;

use nalgebra::{Cholesky, Matrix3, SMatrix, SVector, Vector3};
use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::Residuals;
use crate::least_squares::{Knowledge, Magnitude, PERFECT, Theta, bias, matrix};
use crate::{Covariance, Estimate, Gravity, Method, Parameter, Pose, Refusal, input, pose};

/// Which parameters are fitted; the others are those of a perfect sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Model {
    /// The bias: 3.
    Bias3,
    /// Bias and scale factors: 6.
    BiasScale6,
    /// Bias, scale factors and the three misalignments below the diagonal of A: all that gravity
    /// alone can tell, because it does not see a rotation of the sensor as a whole.
    #[default]
    Full9,
}

/// Beyond, some orientation is predicted so badly that the model is of no use there. Twelve well
/// spread poses give 1 to 2, twelve random ones 4.
const MOST_AMPLIFICATION: f64 = 10.0;
/// Beyond, in standard deviations of a residual, a pose left out is not predicted: some pose
/// decides alone. Twelve well spread poses give 2 to 3.
const MOST_LEFT_OUT: f64 = 10.0;
/// A fit that leaves more than this, m/s² rms, is not one of static poses.
const MOST_RMS_MPS2: f64 = 0.5;
/// A left-out error below this, m/s², is a good prediction whatever the residuals.
const GOOD_LEFT_OUT_MPS2: f64 = 1e-4;

const BIAS: [Parameter; 3] = [Parameter::BiasX, Parameter::BiasY, Parameter::BiasZ];
const BIAS_SCALE: [Parameter; 6] = [
    Parameter::BiasX,
    Parameter::BiasY,
    Parameter::BiasZ,
    Parameter::ScaleX,
    Parameter::ScaleY,
    Parameter::ScaleZ,
];
const FULL: [Parameter; 9] = [
    Parameter::BiasX,
    Parameter::BiasY,
    Parameter::BiasZ,
    Parameter::ScaleX,
    Parameter::MisalignmentXy,
    Parameter::ScaleY,
    Parameter::MisalignmentXz,
    Parameter::MisalignmentYz,
    Parameter::ScaleZ,
];

impl Model {
    /// How many parameters are fitted.
    pub fn parameters(self) -> usize {
        match self {
            Self::Bias3 => BIAS.len(),
            Self::BiasScale6 => BIAS_SCALE.len(),
            Self::Full9 => FULL.len(),
        }
    }

    /// The next smaller model, where there is one.
    pub fn smaller(self) -> Option<Self> {
        match self {
            Self::Bias3 => None,
            Self::BiasScale6 => Some(Self::Bias3),
            Self::Full9 => Some(Self::BiasScale6),
        }
    }
}

impl fmt::Display for Model {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}-parameter model", self.parameters())
    }
}

/// Estimates the error model from static poses whose orientations nobody knows: |f| = g in each.
/// Equations (11) to (17) of docs/EQUATIONS.md.
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes, in any orientations; one more than
/// the model has parameters at the least, twelve well spread ones for a good answer. All count the
/// same. A is lower triangular in the result.
///
/// # Errors
/// [`Refusal`] when the poses cannot support the model; each says what to do.
pub fn multi_position(poses: &[Pose], gravity: Gravity, model: Model) -> Result<Estimate, Refusal> {
    let need = model.parameters() + 1;
    if poses.len() < need {
        let have = poses.len();
        return Err(Refusal::TooFewPoses { have, need, model });
    }
    input::check(poses.iter(), gravity)?;
    match model {
        Model::Bias3 => fit(poses, gravity, model, BIAS),
        Model::BiasScale6 => fit(poses, gravity, model, BIAS_SCALE),
        Model::Full9 => fit(poses, gravity, model, FULL),
    }
}

fn fit<const N: usize>(
    poses: &[Pose],
    gravity: Gravity,
    model: Model,
    free: [Parameter; N],
) -> Result<Estimate, Refusal> {
    let problem = Magnitude {
        poses,
        gravity_mps2: gravity.mps2(),
        free,
    };
    let first = match model {
        Model::Full9 => ellipsoid(poses, gravity.mps2()),
        Model::Bias3 | Model::BiasScale6 => None,
    };
    let found = [first, Some(PERFECT)]
        .into_iter()
        .flatten()
        .find_map(|start| problem.solve(&start, None));
    let at = found.as_ref().map_or(PERFECT, |fit| fit.theta);
    let knowledge = problem.knowledge(&at).ok_or(Refusal::NotConverged)?;
    if !knowledge.suffices() {
        return Err(knowledge.refusal(model, &free));
    }
    let fit = found.ok_or(Refusal::NotConverged)?;
    let terms = ErrorTerms {
        bias_mps2: bias(&fit.theta),
        matrix: matrix(&fit.theta),
        ..ErrorTerms::default()
    };
    let error_model = ErrorModel::new(terms).map_err(Refusal::OutOfBounds)?;

    let dof = poses.len() - N;
    let residuals = Residuals::of(&error_model, gravity, poses.iter());
    if residuals.rms_mps2 > MOST_RMS_MPS2 {
        return Err(Refusal::PoorFit {
            rms_mps2: residuals.rms_mps2,
            pose: residuals.worst_pose,
        });
    }
    let unit_variance = problem
        .inverse_information(&fit)
        .ok_or_else(|| knowledge.refusal(model, &free))?;
    let mut covariance = Covariance::ZERO;
    let variance = fit.cost / dof as f64;
    for (r, &a) in free.iter().enumerate() {
        for (c, &b) in free.iter().enumerate() {
            covariance.add(a, b, variance * unit_variance[(r, c)]);
        }
    }
    let worst_sd_mps2 = knowledge.amplification * libm::sqrt(variance);
    covariance.add_gravity(&fit.theta, gravity);

    let left_out = problem.leave_one_out(&fit);
    let most = (MOST_LEFT_OUT * libm::sqrt(variance)).max(GOOD_LEFT_OUT_MPS2);
    if left_out.rms_mps2 > most {
        return Err(Refusal::PoorPrediction {
            model,
            loo_rms_mps2: left_out.rms_mps2,
            rms_mps2: residuals.rms_mps2,
            pose: left_out.worst_pose,
        });
    }
    Ok(Estimate {
        model: error_model,
        method: Method::MultiPosition(model),
        covariance,
        gravity,
        poses: poses.len(),
        dof,
        rms_mps2: residuals.rms_mps2,
        max_mps2: residuals.max_mps2,
        worst_pose: residuals.worst_pose,
        loo_rms_mps2: Some(left_out.rms_mps2),
        condition: knowledge.condition,
        worst_sd_mps2,
        temperature_c: pose::mean_temperature(poses.iter()),
    })
}

impl<const N: usize> Knowledge<N> {
    fn suffices(&self) -> bool {
        self.amplification < MOST_AMPLIFICATION
    }

    fn refusal(&self, model: Model, free: &[Parameter; N]) -> Refusal {
        let largest = self.variance.max();
        Refusal::NotObservable {
            model,
            parameters: free
                .iter()
                .zip(self.variance.iter())
                .filter(|&(_, &variance)| variance >= 0.1 * largest)
                .map(|(&parameter, _)| parameter)
                .collect(),
            condition: self.condition,
            amplification: self.amplification,
            add: self.poorest,
        }
    }
}

/// The start: the ellipsoid yᵀQy + 2pᵀy = 1 by linear least squares, equation (11).
///
/// `None` when the points are on no ellipsoid.
fn ellipsoid(poses: &[Pose], gravity_mps2: f64) -> Option<Theta> {
    let mut information = SMatrix::<f64, 9, 9>::zeros();
    let mut right = SVector::<f64, 9>::zeros();
    for pose in poses {
        let [x, y, z] = pose.mean_mps2.map(|c| c / gravity_mps2);
        let row = SVector::from([
            x * x,
            y * y,
            z * z,
            2.0 * x * y,
            2.0 * x * z,
            2.0 * y * z,
            2.0 * x,
            2.0 * y,
            2.0 * z,
        ]);
        information.ger(1.0, &row, &row, 1.0);
        right += row;
    }
    let s = Cholesky::new(information)?.solve(&right);
    let q = Matrix3::new(s[0], s[3], s[4], s[3], s[1], s[5], s[4], s[5], s[2]);
    let p = Vector3::new(s[6], s[7], s[8]);
    let inverse = q.try_inverse()?;
    let centre = -(inverse * p);
    let size = 1.0 - p.dot(&centre);
    // y = c + A u with |u| = 1 gives A Aᵀ = size Q⁻¹; its Cholesky factor is the triangular A.
    let a = Cholesky::new(inverse * size)?.unpack();
    let c = centre * gravity_mps2;
    let theta = [
        c[0],
        c[1],
        c[2],
        a[(0, 0)],
        0.0,
        0.0,
        a[(1, 0)],
        a[(1, 1)],
        0.0,
        a[(2, 0)],
        a[(2, 1)],
        a[(2, 2)],
    ];
    theta.iter().all(|t| t.is_finite()).then_some(theta)
}
