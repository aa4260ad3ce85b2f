//! Does a stored calibration still hold? The recursive form: equation (48).

use wimu_model::{ErrorModel, ModelError, ParameterSet};

use crate::force;
use crate::linear::{double, real};
use crate::terms::{self, Theta};
use crate::{Covariance, Gravity, Parameter, Pose, Scalar};

/// What makes a calibration age, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ageing {
    /// By how much the bias differs from one run to the next, m/s² an axis.
    pub turn_on_mps2: f64,
    /// By how much the bias moves with temperature beyond what the model says, m/s² per K an axis.
    pub per_kelvin_mps2: f64,
    /// What differs from pose to pose and is no noise, m/s².
    pub pose_mps2: f64,
}

impl Default for Ageing {
    /// 15 mm/s² from run to run (ten to twenty were seen on MPU-9150), 5 mm/s² per K (½ mg, as
    /// datasheets have it), 3 mm/s² from pose to pose.
    fn default() -> Self {
        Self {
            turn_on_mps2: 0.015,
            per_kelvin_mps2: 0.005,
            pose_mps2: 0.003,
        }
    }
}

/// How uncertain it is what the bias does with temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Slopes {
    /// Standard deviation of the model's slopes, m/s² per K, within the temperatures they were seen at.
    sd: [f64; 3],
    seen_c: [f64; 2],
    /// The same elsewhere.
    beyond: f64,
}

impl Slopes {
    fn unknown(per_kelvin_mps2: f64) -> Self {
        Self {
            sd: [per_kelvin_mps2; 3],
            seen_c: [f64::NEG_INFINITY, f64::INFINITY],
            beyond: per_kelvin_mps2,
        }
    }

    /// Grows with temperature by what becomes uncertain of the bias, m/s².
    fn at(&self, axis: usize, celsius: f64) -> f64 {
        let [low, high] = self.seen_c;
        let within = celsius.max(low).min(high);
        let sd = self.sd.get(axis).copied().unwrap_or(self.beyond);
        sd * within + self.beyond * (celsius - within)
    }
}

/// A run of temperatures in one direction: within it what slopes are off by adds up.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Warming {
    began_c: f64,
    last_c: f64,
}

impl Warming {
    fn from(celsius: f64) -> Self {
        Self {
            began_c: celsius,
            last_c: celsius,
        }
    }

    /// Goes on to `now`, or begins anew where it turns back; the temperature before.
    fn to(&mut self, now: f64) -> f64 {
        let before = self.last_c;
        if (now - before) * (before - self.began_c) < 0.0 {
            self.began_c = before;
        }
        self.last_c = now;
        before
    }
}

/// What a pose says about a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Check {
    /// |f| − g before the pose was taken into account, m/s².
    pub residual_mps2: f64,
    /// Its standard deviation if the calibration holds, m/s².
    pub expected_sd_mps2: f64,
    /// Whether it holds as far as this pose tells: a good calibration fails once in a thousand
    /// poses. A pose that contradicts changes nothing.
    pub holds: bool,
}

/// Normal deviate of that chance.
const MOST_DEVIATIONS: f64 = 3.2905;

/// A stored calibration that is checked, and brought up to date, by every rest.
///
/// With the default ageing, of 1000 runs of twelve rests each that differ by 15 mm/s² an axis from the
/// calibration, 0.8 % contradict it at a rest and none at two in a row, which is when a device tells.
/// Once six rests of a run are in, a bias that jumps by 20 mm/s² is contradicted in 72 % of the runs by
/// the next six and told by a device in 25 %, by 30 in 96 and 67 %, by 50 in 100 and 92 %; by 10 mm/s²,
/// as the next run may differ anyway, in 9 and 0.4 %.
///
/// `SelfCheck<f32>` holds its parameters and their covariance in f32: half the memory, and no f64 in
/// what a rest asks for but a few numbers. It says the same to 0.005 of a standard deviation.
///
/// ```
/// use wimu_calib::{Ageing, Covariance, Gravity, Pose, SelfCheck};
/// use wimu_model::ErrorModel;
///
/// let stored = ErrorModel::default();
/// let known = [[0.0; 12]; 12]; // as of an estimate: `estimate.covariance.matrix()`
/// let mut check = SelfCheck::new(&stored, &known, Gravity::UNKNOWN_PLACE, Ageing::default());
/// let at_rest = Pose::from_mean([0.0, 0.010, 9.810]);
/// assert!(check.push(&at_rest).is_some_and(|check| check.holds));
/// let knocked = Pose::from_mean([0.0, 0.010, 9.950]);
/// assert!(check.push(&knocked).is_some_and(|check| !check.holds));
/// // What the rest told is in the model from now on.
/// assert!(check.model()?.terms().bias_mps2[2] > 0.0);
/// # Ok::<(), wimu_model::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfCheck<R: Scalar = f64> {
    stored: ErrorModel,
    theta: Theta<R>,
    /// That of gravity taken out.
    covariance: [[R; Parameter::COUNT]; Parameter::COUNT],
    gravity: Gravity,
    ageing: Ageing,
    slopes: Slopes,
    warming: Option<Warming>,
    poses: u32,
    contradictions: u32,
}

impl SelfCheck {
    /// A check of `stored`, whose 12 parameters have `covariance` (in the order of
    /// [`Parameter::ALL`]), made at `gravity` and used there: what is not known of gravity is in
    /// the covariance and is taken out of it again, because it changes no |f| − g.
    pub fn new(
        stored: &ErrorModel,
        covariance: &[[f64; Parameter::COUNT]; Parameter::COUNT],
        gravity: Gravity,
        ageing: Ageing,
    ) -> Self {
        Self::start(stored, covariance, gravity, ageing)
    }
}

impl<R: Scalar> SelfCheck<R> {
    fn start(
        stored: &ErrorModel,
        covariance: &[[f64; Parameter::COUNT]; Parameter::COUNT],
        gravity: Gravity,
        ageing: Ageing,
    ) -> Self {
        let theta = terms::theta_of(stored);
        let mut covariance = Covariance::from_matrix(covariance);
        covariance.remove_gravity(&theta, gravity);
        let turn_on = ageing.turn_on_mps2 * ageing.turn_on_mps2;
        for bias in Parameter::BIAS {
            covariance.add(bias, bias, turn_on);
        }
        Self {
            stored: *stored,
            theta: theta.map(real),
            covariance: covariance.matrix().map(|row| row.map(real)),
            gravity,
            ageing,
            slopes: Slopes::unknown(ageing.per_kelvin_mps2),
            warming: None,
            poses: 0,
            contradictions: 0,
        }
    }

    /// A check of the calibration that a device stores; `None` if it has no quality record.
    ///
    /// If its model has a temperature term of the bias, the ageing with temperature is the standard
    /// deviation of that term within the calibrated temperatures. Outside them, and without such a
    /// term, it is [`Ageing::per_kelvin_mps2`].
    pub fn of(set: &ParameterSet, gravity: Gravity, ageing: Ageing) -> Option<Self> {
        let quality = set.quality.as_ref()?.terms();
        let mut check = Self::start(&set.model, &quality.covariance.matrix(), gravity, ageing);
        check.warming = quality
            .temperature
            .map(|t| Warming::from(f64::from(t.mean_c)));
        if let Some(seen) = quality.temperature
            && set.model.terms().temperature.bias_mps2_per_k != [0.0; 3]
        {
            check.slopes = Slopes {
                sd: quality.other_sd.bias_mps2_per_k.map(f64::from),
                seen_c: [f64::from(seen.lowest_c), f64::from(seen.highest_c)],
                ..check.slopes
            };
        }
        Some(check)
    }

    /// Takes a rest into account. `None` where it is no pose: not finite, or nowhere near gravity.
    pub fn push(&mut self, pose: &Pose) -> Option<Check> {
        let terms = self.stored.terms().temperature;
        let celsius = pose.temperature_c.filter(|celsius| celsius.is_finite());
        let warmer = celsius.map_or(0.0, |celsius| celsius - terms.reference_c);
        let mut output = pose.mean_mps2;
        for axis in 0..3 {
            output[axis] -= terms.bias_mps2_per_k2[axis] * warmer * warmer;
        }
        let g = self.gravity.mps2();
        let (force, row) = force::magnitude(&self.theta, output.map(real), real(warmer)).filter(
            |(force, _)| {
                let force = double(*force);
                (0.5 * g..1.5 * g).contains(&force)
            },
        )?;

        if let Some(now) = celsius {
            let warming = self.warming.get_or_insert(Warming::from(now));
            let before = warming.to(now);
            for axis in 0..3 {
                let moved = |from: f64, to: f64| {
                    let by = self.slopes.at(axis, to) - self.slopes.at(axis, from);
                    by * by
                };
                let more = moved(warming.began_c, now) - moved(warming.began_c, before);
                self.covariance[axis][axis] += real(more.max(0.0));
            }
        }

        let residual = force - real(g);
        let product = |a: &[R; Parameter::COUNT]| {
            let mut sum = R::zero();
            for (a, b) in a.iter().zip(&row) {
                sum += *a * *b;
            }
            sum
        };
        let along: [R; Parameter::COUNT] = core::array::from_fn(|i| product(&self.covariance[i]));
        let known = double(product(&along));
        let apart = self.ageing.pose_mps2 * self.ageing.pose_mps2 + pose.mean_noise();
        let variance = known + apart;
        let expected = libm::sqrt(variance);
        let residual_mps2 = double(residual);
        let holds = residual_mps2.abs() <= MOST_DEVIATIONS * expected;
        self.poses = self.poses.saturating_add(1);
        if holds && variance > 0.0 {
            let per_variance = real(1.0 / variance);
            let gain = along.map(|along| along * per_variance);
            for (theta, gain) in self.theta.iter_mut().zip(gain) {
                *theta -= gain * residual;
            }
            for (row, gain) in self.covariance.iter_mut().zip(gain) {
                for (covariance, along) in row.iter_mut().zip(along) {
                    *covariance -= gain * along;
                }
            }
        } else {
            self.contradictions = self.contradictions.saturating_add(1);
        }
        Some(Check {
            residual_mps2,
            expected_sd_mps2: expected,
            holds,
        })
    }

    /// How many poses were taken.
    pub fn poses(&self) -> u32 {
        self.poses
    }

    /// How many of them contradicted the calibration.
    pub fn contradictions(&self) -> u32 {
        self.contradictions
    }

    /// The model brought up to date.
    ///
    /// # Errors
    /// [`ModelError`] when that is no accelerometer's any more.
    pub fn model(&self) -> Result<ErrorModel, ModelError> {
        let mut updated = *self.stored.terms();
        let theta = self.theta.map(double);
        updated.bias_mps2 = terms::bias(&theta);
        updated.matrix = terms::matrix(&theta);
        ErrorModel::new(updated)
    }

    /// Covariance of its 12 parameters, that of gravity included.
    pub fn covariance(&self) -> Covariance {
        let mut covariance = Covariance::from_matrix(&self.covariance.map(|row| row.map(double)));
        covariance.add_gravity(&self.theta.map(double), self.gravity);
        covariance
    }
}
