//! Second-order terms of a vector that is measured in the body frame: equation (124).
//!
//! With the attitude error θ and the error e of the vector u, both in the navigation frame, exp(−θ) (u + e) has the
//! second-order part ½ θ × (θ × u) − θ × e. With P = cov(θ) and c = cov(θ, e), its mean is
//!
//! ```text
//! ½ (P − tr(P) 1) u − [c₂₃ − c₃₂, c₃₁ − c₁₃, c₁₂ − c₂₁]
//! ```
//!
//! With 11° of tilt the mean of g (1 − cos θ) is 0.18 m/s², and a first-order filter takes it for an acceleration.

use nalgebra::{Matrix3, RealField, Vector3};

use crate::filter::Filter;
use crate::rotation::real;
use crate::state::{ATTITUDE, Block};

/// Mean and covariance of the second-order part, navigation frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SecondOrder<R> {
    pub mean: Vector3<R>,
    pub covariance: Matrix3<R>,
}

impl<R: RealField + Copy> SecondOrder<R> {
    /// Of a vector whose error is that of a block.
    ///
    /// The covariance is the outer product of the first mean plus tr(P) cov(e): wider than that of Gaussian errors, and
    /// better in fast motion (score_navigation).
    pub fn of<const N: usize>(filter: &Filter<R, N>, vector: &Vector3<R>, error: Block<3>) -> Self {
        let attitude = filter.covariance(ATTITUDE);
        let cross = filter.cross_covariance(ATTITUDE, error);
        let trace = attitude.trace();
        let rotation = (attitude - Matrix3::identity() * trace) * vector * real::<R>(0.5);
        let c = |i: usize, j: usize| cross[(i, j)] - cross[(j, i)];
        Self {
            mean: rotation - Vector3::new(c(1, 2), c(2, 0), c(0, 1)),
            covariance: rotation * rotation.transpose() + filter.covariance(error) * trace,
        }
    }
}
