//! What every estimator works on.

/// One static pose: what the sensor put out while it was held still.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pose {
    /// Mean output y, m/s², sensor axes.
    pub mean_mps2: [f64; 3],
    /// Standard deviation of one sample per axis, m/s²; 0 where it is not known.
    pub sd_mps2: [f64; 3],
    /// What rounding to the sensor's counts leaves in the mean per axis, m/s², 1 σ: holding it longer
    /// does not lower it. 0 where noise dithers it away, and where it is not known.
    pub rounding_sd_mps2: [f64; 3],
    /// How many samples the mean is of; 0 counts as 1.
    pub samples: u32,
    /// Mean temperature while it was held, °C, where one was given.
    pub temperature_c: Option<f64>,
    /// Index in the recording of the first sample that the mean is of.
    pub first_sample: u64,
    /// When it was held (the middle of it), s from any origin that the poses share: only the
    /// drift over a session asks for it.
    pub time_s: f64,
}

impl Pose {
    /// A pose of which only the mean output, m/s², sensor axes, is known.
    pub fn from_mean(mean_mps2: [f64; 3]) -> Self {
        Self {
            mean_mps2,
            samples: 1,
            ..Self::default()
        }
    }

    /// Variance of the mean of an axis from the sensor's noise and rounding, (m/s²)²; 0 where
    /// unknown. Equation (59).
    pub(crate) fn noise(&self, axis: usize) -> f64 {
        let of = |sd: &[f64; 3]| sd.get(axis).map_or(0.0, |sd| sd * sd);
        of(&self.sd_mps2) / self.weight() + of(&self.rounding_sd_mps2)
    }

    /// Mean of the axes' variance of the mean from noise alone.
    pub(crate) fn mean_free_noise(&self) -> f64 {
        let squares: f64 = self.sd_mps2.iter().map(|sd| sd * sd).sum();
        squares / (3.0 * self.weight())
    }

    /// The same as [`Pose::noise`], mean of the axes.
    pub(crate) fn mean_noise(&self) -> f64 {
        (0..3).map(|axis| self.noise(axis)).sum::<f64>() / 3.0
    }

    /// How much the pose counts in a mean over poses.
    pub(crate) fn weight(&self) -> f64 {
        f64::from(self.samples.max(1))
    }
}

/// Mean temperature of those poses that have one, weighted by their samples, °C.
pub(crate) fn mean_temperature<'a>(poses: impl Iterator<Item = &'a Pose>) -> Option<f64> {
    let (sum, weight) = poses
        .filter_map(|pose| Some((pose.temperature_c?, pose.weight())))
        .filter(|(celsius, _)| celsius.is_finite())
        .fold((0.0, 0.0), |(sum, total), (celsius, weight)| {
            (sum + celsius * weight, total + weight)
        });
    (weight > 0.0).then(|| sum / weight)
}
