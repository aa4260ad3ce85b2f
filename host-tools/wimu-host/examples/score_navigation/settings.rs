//! Settings of the plain baseline: one for walks, one for everything else.

use wimu_nav::navigator::Profile;

use crate::detector::Detector;

/// Noise and start. All are standard deviations.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Profile of the core.
    pub profile: Profile,
    pub detector: Detector,
    /// Whether a step is integrated with the mean of the samples at both its ends, else with the later one.
    pub mean_of_two: bool,
    /// Noise densities: m/s²/√Hz, rad/s/√Hz.
    pub accelerometer_noise: f64,
    pub gyroscope_noise: f64,
    /// Random walks of the biases: m/s²/√s, rad/s/√s.
    pub accelerometer_bias_walk: f64,
    pub gyroscope_bias_walk: f64,
    /// Biases at the start: m/s², rad/s.
    pub accelerometer_bias: f64,
    pub gyroscope_bias: f64,
    /// Samples averaged for the first alignment.
    pub start_samples: usize,
    /// Start at rest: roll and pitch, rad; velocity, m/s.
    pub tilt: f64,
    pub velocity: f64,
    /// Zero velocity at a detected rest, m/s, a component.
    pub zero_velocity: f64,
}

impl Settings {
    /// As `FIXED` of reference/localization/foot.py. Process noise stands for scale factors and clipping as well.
    pub const FOOT: Self = Self {
        profile: Profile::Foot,
        detector: Detector::FOOT,
        mean_of_two: false,
        accelerometer_noise: 0.05,
        gyroscope_noise: 0.003,
        accelerometer_bias_walk: 5e-5,
        gyroscope_bias_walk: 2e-5,
        accelerometer_bias: 0.005,
        gyroscope_bias: 0.05 * std::f64::consts::PI / 180.0,
        start_samples: 20,
        tilt: 0.5 * std::f64::consts::PI / 180.0,
        velocity: 0.01,
        zero_velocity: 0.01,
    };

    /// As `NoiseModel` of reference/estimator, without its considered states: BROAD, robot arm and simulation.
    pub const HAND: Self = Self {
        profile: Profile::Hand,
        detector: Detector::HAND,
        mean_of_two: true,
        accelerometer_noise: 0.005,
        gyroscope_noise: 2.5e-4,
        accelerometer_bias_walk: 3e-4,
        gyroscope_bias_walk: 2e-4,
        accelerometer_bias: 0.1,
        gyroscope_bias: 0.02,
        start_samples: 100,
        tilt: 0.05,
        velocity: 1e-3,
        zero_velocity: 0.01,
    };
}
