//! Static poses, the input of the estimators.

/// cos 10°.
pub(crate) const SAME_ORIENTATION_COS: f64 = 0.984_8;

/// One static pose: the output of the sensor while it was held still.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Mean output y, m/s², sensor axes.
    pub mean_mps2: [f64; 3],
    /// Standard deviation of one sample per axis, m/s²; 0 if unknown.
    pub sd_mps2: [f64; 3],
    /// Quantisation error of the mean per axis, m/s², 1 σ, which more samples do not reduce. 0 if
    /// noise dithers it, or if it is unknown.
    pub rounding_sd_mps2: [f64; 3],
    /// Number of samples in the mean; 0 counts as 1.
    pub samples: u32,
    /// Mean temperature of the pose, °C, if known.
    pub temperature_c: Option<f64>,
    /// Index of the first sample in the recording.
    pub first_sample: u64,
    /// Time of the middle of the pose, s, from an origin common to all poses. Only drift over a
    /// session depends on it.
    pub time_s: f64,
}

impl Pose {
    /// A pose of which only the mean output, m/s², sensor axes, is known.
    pub fn from_mean(mean_mps2: [f64; 3]) -> Self {
        Self { mean_mps2, samples: 1, ..Self::default() }
    }

    /// Whether another pose has the same orientation: their outputs are within 10°.
    pub fn is_like(&self, other: &Self) -> bool {
        let [a, b] = [self, other].map(|pose| nalgebra::Vector3::from(pose.mean_mps2));
        a.dot(&b) > SAME_ORIENTATION_COS * a.norm() * b.norm()
    }

    /// Variance of the mean of an axis from noise and quantisation, (m/s²)²; 0 if unknown. Equation
    /// (59).
    pub(crate) fn noise(&self, axis: usize) -> f64 {
        let of = |sd: &[f64; 3]| sd.get(axis).map_or(0.0, |sd| sd * sd);
        of(&self.sd_mps2) / self.weight() + of(&self.rounding_sd_mps2)
    }

    /// Variance of the mean from noise alone, averaged over the axes, (m/s²)².
    pub(crate) fn mean_free_noise(&self) -> f64 {
        let squares: f64 = self.sd_mps2.iter().map(|sd| sd * sd).sum();
        squares / (3.0 * self.weight())
    }

    /// [`Pose::noise`], averaged over the axes.
    pub(crate) fn mean_noise(&self) -> f64 {
        (0..3).map(|axis| self.noise(axis)).sum::<f64>() / 3.0
    }

    /// Weight of the pose in a mean over poses.
    pub(crate) fn weight(&self) -> f64 {
        f64::from(self.samples.max(1))
    }
}

/// Mean temperature of the poses that have one, weighted by their samples, °C.
pub(crate) fn mean_temperature<'a>(poses: impl Iterator<Item = &'a Pose>) -> Option<f64> {
    let (sum, weight) = poses
        .filter_map(|pose| Some((pose.temperature_c?, pose.weight())))
        .filter(|(celsius, _)| celsius.is_finite())
        .fold((0.0, 0.0), |(sum, total), (celsius, weight)| {
            (sum + celsius * weight, total + weight)
        });
    (weight > 0.0).then(|| sum / weight)
}
