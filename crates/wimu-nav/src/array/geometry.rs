//! Where the accelerometers of an array are and which way they point.

use core::fmt;

/// One sensing axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Place of the sensing element, m, body axes, from any origin.
    pub place_m: [f64; 3],
    /// Direction in which it measures, body axes; normalised when the geometry is made.
    pub direction: [f64; 3],
    /// Standard deviation of a sample's noise, m/s².
    pub noise_mps2: f64,
}

/// Three sensing axes at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triad {
    /// Place, m, body axes, from any origin.
    pub place_m: [f64; 3],
    /// Directions of its X, Y and Z axis, body axes.
    pub axes: [[f64; 3]; 3],
    /// Standard deviation of a sample's noise per axis, m/s².
    pub noise_mps2: f64,
}

impl Triad {
    /// A triad whose axes are the body's.
    pub fn aligned(place_m: [f64; 3], noise_mps2: f64) -> Self {
        Self {
            place_m,
            axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            noise_mps2,
        }
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
    /// than `M`. Whether they suffice is judged by [`ArraySolver::new`](super::ArraySolver::new).
    pub fn from_axes(axes: &[Axis]) -> Result<Self, GeometryError> {
        Self::new(axes.iter().copied(), axes.len(), 1)
    }

    /// From single axes of which `group` consecutive ones belong to one sensor and fail together: the
    /// proof masses of one chip are not at one place.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`]; [`GeometryError::BadGroup`] where the axes do not come out even.
    pub fn from_grouped_axes(axes: &[Axis], group: usize) -> Result<Self, GeometryError> {
        if group == 0 || !axes.len().is_multiple_of(group) {
            return Err(GeometryError::BadGroup {
                have: axes.len(),
                group,
            });
        }
        Self::new(axes.iter().copied(), axes.len(), group)
    }

    /// From triads; output 3 k + i of a sample is axis i of triad k.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`].
    pub fn from_triads(triads: &[Triad]) -> Result<Self, GeometryError> {
        let axes = triads.iter().flat_map(|triad| {
            triad.axes.map(|direction| Axis {
                place_m: triad.place_m,
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
        let unused = Axis {
            place_m: [0.0; 3],
            direction: [0.0; 3],
            noise_mps2: 0.0,
        };
        let mut axes = [unused; M];
        for (index, (slot, mut axis)) in axes.iter_mut().zip(source).enumerate() {
            let norm = libm::sqrt(axis.direction.iter().map(|d| d * d).sum());
            let finite = axis.place_m.iter().all(|p| p.is_finite()) && norm.is_finite();
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
    /// Chen, Lee & DeBra: θ of (71) is their closed form. `side_m` is the length of the cube's side.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for a side or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_nav::array::{ArraySolver, Geometry, Roots};
    ///
    /// let solver = ArraySolver::<f64, 6>::new(&Geometry::chen_cube(0.1, 0.01)?)?;
    /// // Turned faster and faster about z, 5 rad/s²: the axes on top and below it feel nothing, the others
    /// // 0.05 m · 5 rad/s² / √2.
    /// let felt = 0.05 * 5.0 / 2_f64.sqrt();
    /// let linear = solver.reduce(&[0.0, felt, -felt, felt, -felt, 0.0]);
    /// assert_eq!(solver.roots(), Roots::None); // no angular rate: integrate ω̇
    /// let turn = solver.theta(&linear, [0.0; 3]);
    /// assert!((turn[2] - 5.0).abs() < 1e-9 && turn[0].abs() < 1e-9);
    /// # Ok::<(), wimu_nav::array::GeometryError>(())
    /// ```
    pub fn chen_cube(side_m: f64, noise_mps2: f64) -> Result<Self, GeometryError> {
        let half = side_m / 2.0;
        let axis = |place: [f64; 3], direction: [f64; 3]| Axis {
            place_m: place.map(|p| p * half),
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
    /// set with two roots only.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for an arm or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_nav::array::{ArraySolver, Geometry, Roots};
    ///
    /// let solver = ArraySolver::<f64, 12>::new(&Geometry::four_triads(0.02, 0.01)?)?;
    /// assert_eq!(solver.roots(), Roots::Two);
    /// # Ok::<(), wimu_nav::array::GeometryError>(())
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
    /// Six triads on the axes, `arm_m` from the origin, in the order +x, −x, +y, −y, +z, −z: alike in all
    /// directions.
    ///
    /// # Errors
    /// As [`Geometry::from_axes`], for an arm or noise that is not positive and finite.
    ///
    /// ```
    /// use wimu_nav::array::{ArraySolver, Geometry, Roots};
    ///
    /// let solver = ArraySolver::<f32, 18>::new(&Geometry::octahedron(0.01, 0.01)?)?;
    /// assert_eq!(solver.roots(), Roots::Two);
    /// # Ok::<(), wimu_nav::array::GeometryError>(())
    /// ```
    pub fn octahedron(arm_m: f64, noise_mps2: f64) -> Result<Self, GeometryError> {
        let triad = |k: usize| {
            let mut place = [0.0; 3];
            if let Some(along) = place.get_mut(k / 2) {
                *along = if k.is_multiple_of(2) { arm_m } else { -arm_m };
            }
            Triad::aligned(place, noise_mps2)
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
    /// use wimu_nav::array::{ArraySolver, Geometry, Roots};
    ///
    /// let board = Geometry::eight_triads_board(0.02, 0.001, 0.01)?;
    /// let solver = ArraySolver::<f32, 24>::new(&board)?;
    /// assert_eq!((solver.roots(), solver.rank()), (Roots::Two, 6));
    /// // All in one plane: a turn and its mirror image at the board look alike, too.
    /// let flat = ArraySolver::<f32, 24>::new(&Geometry::eight_triads_board(0.02, 0.0, 0.01)?)?;
    /// assert_eq!((flat.roots(), flat.rank()), (Roots::Four, 3));
    /// # Ok::<(), wimu_nav::array::GeometryError>(())
    /// ```
    pub fn eight_triads_board(
        half_side_m: f64,
        half_thickness_m: f64,
        noise_mps2: f64,
    ) -> Result<Self, GeometryError> {
        let (p, h) = (half_side_m, half_thickness_m);
        let place = |x: f64, y: f64, z: f64| Triad::aligned([x * p, y * p, z * h], noise_mps2);
        Self::from_triads(&[
            place(-1.0, 1.0, 1.0),
            place(-1.0, 1.0, -1.0),
            place(-1.0, -1.0, 1.0),
            place(-1.0, -1.0, -1.0),
            place(1.0, 1.0, 1.0),
            place(1.0, 1.0, -1.0),
            place(1.0, -1.0, 1.0),
            place(1.0, -1.0, -1.0),
        ])
    }
}

/// Why a geometry cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum GeometryError {
    /// More axes than the type has room for.
    TooMany {
        /// How many there are.
        have: usize,
        /// How many fit.
        most: usize,
    },
    /// A place or direction is not finite, or a direction is zero.
    BadAxis {
        /// Its index; a triad has three.
        axis: usize,
    },
    /// A noise is not positive and finite.
    BadNoise {
        /// The index of its axis; a triad has three.
        axis: usize,
    },
    /// Axes that do not make whole sensors.
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
    /// All sensors are at one place, where rotation does not show.
    Coincident,
    /// No axis measures along this direction.
    NoForce {
        /// Unit vector, body axes.
        along: [f64; 3],
    },
    /// Angular acceleration about this direction does not show.
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
                "axis {axis} (from 0) has a place or direction that is not finite, or no direction: \
                 give its place in m and a direction in body axes"
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
                "all sensors are at one place, where rotation does not show: place them apart, the \
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
                    "angular acceleration about ({x:.2}, {y:.2}, {z:.2}) does not show: "
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
