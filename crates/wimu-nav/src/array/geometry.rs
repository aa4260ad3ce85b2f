//! Positions and directions of the sensing axes of an array, in body axes.

use alloc::vec::Vec;
use core::fmt;

/// One sensing axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Position of the sensing element, m, body axes, from any origin.
    pub position_m: [f64; 3],
    /// Direction of its sensitivity, body axes, of any length; a [`Geometry`] holds it as a unit vector.
    pub direction: [f64; 3],
    /// Standard deviation of the noise of a sample, m/s².
    pub noise_mps2: f64,
}

impl Axis {
    /// X, Y and Z axis of a triad whose axes are the body's, at one position, m, with noise, m/s².
    pub fn triad(position_m: [f64; 3], noise_mps2: f64) -> [Self; 3] {
        let directions = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        directions.map(|direction| Self { position_m, direction, noise_mps2 })
    }
}

/// The sensing axes of an array, in the order of a sample's outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    axes: Vec<Axis>,
    group: usize,
}

impl Geometry {
    /// From axes of which `group` consecutive ones belong to one sensor and fail together: three of a triad.
    ///
    /// # Errors
    /// [`GeometryError`]: a value that is not finite, an axis without direction or noise, axes that are no multiple of
    /// `group`. Whether the axes determine a motion is for the solver to check.
    pub fn new(axes: impl IntoIterator<Item = Axis>, group: usize) -> Result<Self, GeometryError> {
        let mut axes: Vec<Axis> = axes.into_iter().collect();
        if group == 0 || !axes.len().is_multiple_of(group) {
            return Err(GeometryError::BadGroup { have: axes.len(), group });
        }
        for (index, axis) in axes.iter_mut().enumerate() {
            let norm = libm::sqrt(axis.direction.iter().map(|d| d * d).sum());
            let finite = axis.position_m.iter().all(|p| p.is_finite()) && norm.is_finite();
            if !finite || norm <= 0.0 {
                return Err(GeometryError::BadAxis { axis: index });
            }
            if !(axis.noise_mps2 > 0.0 && axis.noise_mps2.is_finite()) {
                return Err(GeometryError::BadNoise { axis: index });
            }
            axis.direction = axis.direction.map(|d| d / norm);
        }
        Ok(Self { axes, group })
    }

    /// The axes, in the order of a sample's outputs.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// How many consecutive outputs belong to one sensor.
    pub fn group(&self) -> usize {
        self.group
    }
}

/// Why a geometry is not valid, or does not determine a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum GeometryError {
    /// More sensors than [`SensorBits`](super::SensorBits) has bits.
    TooMany {
        /// How many there are.
        have: usize,
        /// How many fit.
        most: usize,
    },
    /// A position or direction is not finite, or a direction is zero.
    BadAxis {
        /// Its index; a triad has three.
        axis: usize,
    },
    /// A noise is not positive and finite.
    BadNoise {
        /// The index of its axis; a triad has three.
        axis: usize,
    },
    /// The number of axes is not a multiple of those of a sensor.
    BadGroup {
        /// How many axes there are.
        have: usize,
        /// How many make a sensor.
        group: usize,
    },
    /// Fewer usable axes than unknowns.
    TooFew {
        /// How many there are.
        have: usize,
        /// How many are needed: 3 for the specific force, 3 for the angular acceleration.
        need: usize,
    },
    /// All sensors have one position, where rotation is not observable.
    Coincident,
    /// No axis measures along this direction.
    NoForce {
        /// Unit vector, body axes.
        along: [f64; 3],
    },
    /// Angular acceleration about this direction is not observable.
    NoTurn {
        /// Unit vector, body axes.
        about: [f64; 3],
        /// Whether all sensors lie on one line.
        collinear: bool,
    },
}

impl fmt::Display for GeometryError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { have, most } => write!(
                out,
                "{have} sensors, {most} are the most: leave some out"
            ),
            Self::BadAxis { axis } => write!(
                out,
                "axis {axis} (from 0) has a position or direction that is not finite, or no direction: \
                 give its position in m and a direction in body axes"
            ),
            Self::BadNoise { axis } => write!(
                out,
                "axis {axis} (from 0) has no positive, finite noise: give the standard deviation of a \
                 sample in m/s²"
            ),
            Self::BadGroup { have, group } => write!(
                out,
                "{have} axes do not make sensors of {group}: give all axes of each sensor"
            ),
            Self::TooFew { have, need } => write!(
                out,
                "{have} usable axes, {need} are needed at the least: add sensors, or two triads and more"
            ),
            Self::Coincident => out.write_str(
                "all sensors have one position, where rotation is not observable: mount them apart, the \
                 farther the better",
            ),
            Self::NoForce { along: [x, y, z] } => write!(
                out,
                "nothing measures specific force along ({x:.2}, {y:.2}, {z:.2}): add an axis that does"
            ),
            Self::NoTurn {
                about: [x, y, z],
                collinear,
            } => {
                write!(
                    out,
                    "angular acceleration about ({x:.2}, {y:.2}, {z:.2}) is not observable: "
                )?;
                out.write_str(if collinear {
                    "the sensors lie on one line; add one off it"
                } else {
                    "add an axis across it, away from the line through the others' centre"
                })
            }
        }
    }
}

impl core::error::Error for GeometryError {}
