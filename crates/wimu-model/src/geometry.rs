//! Geometry of an accelerometer array: positions and directions of its sensing axes in body axes.

use core::fmt;

/// One sensing axis.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Axis {
    /// Position of the sensing element, m, body axes, from any origin.
    pub position_m: [f64; 3],
    /// Direction of its sensitivity, body axes, of any length; a [`Geometry`] holds it as a unit vector.
    pub direction: [f64; 3],
    /// Standard deviation of the noise of a sample, m/s².
    pub noise_mps2: f64,
}

/// Three sensing axes at one position.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Triad {
    /// Position, m, body axes, from any origin.
    pub position_m: [f64; 3],
    /// Directions of its X, Y and Z axis, body axes.
    pub axes: [[f64; 3]; 3],
    /// Standard deviation of the noise of a sample, m/s² per axis.
    pub noise_mps2: f64,
}

impl Triad {
    /// A triad whose axes are the body's.
    pub fn aligned(position_m: [f64; 3], noise_mps2: f64) -> Self {
        Self { position_m, axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], noise_mps2 }
    }
}

/// The sensing axes of an array, at most `M`: 3 for each triad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry<const M: usize> {
    axes: [Axis; M],
    len: usize,
    /// Consecutive axes that fail together.
    group: usize,
}

impl<const M: usize> Geometry<M> {
    /// From single axes.
    ///
    /// # Errors
    /// [`GeometryError`]: a value that is not finite, an axis without direction or noise, more axes
    /// than `M`. Whether the axes determine a motion is for the solver to check.
    pub fn from_axes(axes: &[Axis]) -> Result<Self, GeometryError> {
        Self::new(axes.iter().copied(), axes.len(), 1)
    }

    /// From single axes of which `group` consecutive ones belong to one sensor and fail together: the
    /// proof masses of one chip have different positions.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`]; [`GeometryError::BadGroup`] where the number of axes is not a multiple of `group`.
    pub fn from_grouped_axes(axes: &[Axis], group: usize) -> Result<Self, GeometryError> {
        if group == 0 || !axes.len().is_multiple_of(group) {
            return Err(GeometryError::BadGroup { have: axes.len(), group });
        }
        Self::new(axes.iter().copied(), axes.len(), group)
    }

    /// From triads; axis i of triad k is axis 3 k + i of the geometry.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`].
    pub fn from_triads(triads: &[Triad]) -> Result<Self, GeometryError> {
        let axes = triads.iter().flat_map(|triad| {
            triad.axes.map(|direction| Axis {
                position_m: triad.position_m,
                direction,
                noise_mps2: triad.noise_mps2,
            })
        });
        Self::new(axes, triads.len() * 3, 3)
    }

    fn new(
        source: impl Iterator<Item = Axis>,
        len: usize,
        group: usize,
    ) -> Result<Self, GeometryError> {
        if len > M {
            return Err(GeometryError::TooMany { have: len, most: M });
        }
        let unused = Axis { position_m: [0.0; 3], direction: [0.0; 3], noise_mps2: 0.0 };
        let mut axes = [unused; M];
        for (index, (slot, mut axis)) in axes.iter_mut().zip(source).enumerate() {
            let norm = libm::sqrt(axis.direction.iter().map(|d| d * d).sum());
            let finite = axis.position_m.iter().all(|p| p.is_finite()) && norm.is_finite();
            if !finite || norm <= 0.0 {
                return Err(GeometryError::BadAxis { axis: index });
            }
            if !(axis.noise_mps2 > 0.0 && axis.noise_mps2.is_finite()) {
                return Err(GeometryError::BadNoise { axis: index });
            }
            axis.direction = axis.direction.map(|d| d / norm);
            *slot = axis;
        }
        Ok(Self { axes, len, group })
    }

    /// The axes, in the order of a sample's outputs.
    pub fn axes(&self) -> &[Axis] {
        self.axes.get(..self.len).unwrap_or(&self.axes)
    }

    /// How many consecutive outputs belong to one sensor: 3 for triads, 1 for single axes.
    pub fn group(&self) -> usize {
        self.group
    }
}

impl Geometry<6> {
    /// Six single axes at the centres of a cube's faces, each along a diagonal of its face, after
    /// Chen, Lee & DeBra: θ of (71) is their closed form. `side_m` is the length of the side of the cube.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for a side or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_model::geometry::Geometry;
    ///
    /// let cube = Geometry::chen_cube(0.1, 0.01)?;
    /// let top = cube.axes()[5];
    /// assert_eq!(top.position_m, [0.0, 0.0, 0.05]);
    /// assert!((top.direction[0] - 0.5_f64.sqrt()).abs() < 1e-12);
    /// # Ok::<(), wimu_model::geometry::GeometryError>(())
    /// ```
    pub fn chen_cube(side_m: f64, noise_mps2: f64) -> Result<Self, GeometryError> {
        let half = side_m / 2.0;
        let axis = |position: [f64; 3], direction: [f64; 3]| Axis {
            position_m: position.map(|p| p * half),
            direction,
            noise_mps2,
        };
        Self::from_axes(&[
            axis([0.0, 0.0, -1.0], [1.0, 1.0, 0.0]),
            axis([0.0, -1.0, 0.0], [1.0, 0.0, 1.0]),
            axis([-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]),
            axis([1.0, 0.0, 0.0], [0.0, 1.0, -1.0]),
            axis([0.0, 1.0, 0.0], [1.0, 0.0, -1.0]),
            axis([0.0, 0.0, 1.0], [1.0, -1.0, 0.0]),
        ])
    }
}

impl Geometry<12> {
    /// Four triads at alternate corners of a cube around the origin, `arm_m` from it: the smallest
    /// set whose angular rate has two roots only.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for an arm or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_model::geometry::Geometry;
    ///
    /// let four = Geometry::four_triads(0.03, 0.01)?;
    /// let [x, y, z] = four.axes()[3].position_m;
    /// assert!(x > 0.0 && y < 0.0 && (x * x + y * y + z * z - 9e-4).abs() < 1e-12);
    /// # Ok::<(), wimu_model::geometry::GeometryError>(())
    /// ```
    pub fn four_triads(arm_m: f64, noise_mps2: f64) -> Result<Self, GeometryError> {
        let p = arm_m / libm::sqrt(3.0);
        Self::from_triads(&[
            Triad::aligned([p, p, p], noise_mps2),
            Triad::aligned([p, -p, -p], noise_mps2),
            Triad::aligned([-p, p, -p], noise_mps2),
            Triad::aligned([-p, -p, p], noise_mps2),
        ])
    }
}

impl Geometry<18> {
    /// Six triads on the axes, `arm_m` from the origin, in the order +x, −x, +y, −y, +z, −z: isotropic.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for an arm or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_model::geometry::Geometry;
    ///
    /// let octahedron = Geometry::octahedron(0.01, 0.01)?;
    /// assert_eq!(octahedron.axes()[15].position_m, [0.0, 0.0, -0.01]);
    /// # Ok::<(), wimu_model::geometry::GeometryError>(())
    /// ```
    pub fn octahedron(arm_m: f64, noise_mps2: f64) -> Result<Self, GeometryError> {
        let triad = |k: usize| {
            let mut position = [0.0; 3];
            if let Some(along) = position.get_mut(k / 2) {
                *along = if k.is_multiple_of(2) { arm_m } else { -arm_m };
            }
            Triad::aligned(position, noise_mps2)
        };
        Self::from_triads(&core::array::from_fn::<Triad, 6, _>(triad))
    }
}

impl Geometry<24> {
    /// Eight triads on both sides of a square board: pairs at its corners (±`half_side_m`,
    /// ±`half_side_m`), `half_thickness_m` above and below in turn, as on a MIMU4444 board.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for lengths or noise that are not positive and finite.
    ///
    /// ```
    /// use wimu_model::geometry::Geometry;
    ///
    /// let board = Geometry::eight_triads_board(0.02, 0.001, 0.01)?;
    /// assert_eq!((board.axes().len(), board.group()), (24, 3));
    /// assert_eq!(board.axes()[3].position_m, [-0.02, 0.02, -0.001]);
    /// # Ok::<(), wimu_model::geometry::GeometryError>(())
    /// ```
    pub fn eight_triads_board(
        half_side_m: f64,
        half_thickness_m: f64,
        noise_mps2: f64,
    ) -> Result<Self, GeometryError> {
        let (p, h) = (half_side_m, half_thickness_m);
        let position = |x: f64, y: f64, z: f64| Triad::aligned([x * p, y * p, z * h], noise_mps2);
        Self::from_triads(&[
            position(-1.0, 1.0, 1.0),
            position(-1.0, 1.0, -1.0),
            position(-1.0, -1.0, 1.0),
            position(-1.0, -1.0, -1.0),
            position(1.0, 1.0, 1.0),
            position(1.0, 1.0, -1.0),
            position(1.0, -1.0, 1.0),
            position(1.0, -1.0, -1.0),
        ])
    }
}

/// Why a geometry is not valid, or does not determine a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum GeometryError {
    /// More axes than the type has room for.
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
                "{have} axes where there is room for {most}: make the geometry's size 3 for each triad"
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_make_no_geometry_are_refused() {
        let nan = Triad::aligned([f64::NAN, 0.0, 0.0], 0.01);
        assert_eq!(Geometry::<3>::from_triads(&[nan]), Err(GeometryError::BadAxis { axis: 0 }));
        let silent = Triad::aligned([0.0; 3], 0.0);
        assert_eq!(Geometry::<3>::from_triads(&[silent]), Err(GeometryError::BadNoise { axis: 0 }));
        let many = [Triad::aligned([0.0; 3], 0.1); 2];
        assert_eq!(
            Geometry::<3>::from_triads(&many),
            Err(GeometryError::TooMany { have: 6, most: 3 })
        );
        let five = [Axis { position_m: [0.0; 3], direction: [0.0, 0.0, 2.0], noise_mps2: 0.1 }; 5];
        assert_eq!(
            Geometry::<6>::from_grouped_axes(&five, 3),
            Err(GeometryError::BadGroup { have: 5, group: 3 })
        );
        let single = Geometry::<6>::from_axes(&five).expect("five axes");
        assert_eq!((single.axes().len(), single.axes()[4].direction[2]), (5, 1.0));
    }
}
