//! Example of a residual model: a bias that is linear in temperature, from means at rest in one orientation.
//!
//! y_k = f + b₀ + b₁ (T_k − T₀) + noise, of which gravity f is known. The datasheet's b₁ = 0 ± σ is a row.

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector};

use super::{ResidualModel, Rows, Settings, minimise};

/// Mean output of an axis at rest less gravity, m/s², and its temperature, °C.
type Rest = [f64; 2];

struct ThermalBias {
    rests: Vec<Rest>,
    /// T₀, °C.
    reference_c: f64,
    /// Noise of a mean, m/s², and the datasheet's σ of b₁, m/s² per K.
    noise_mps2: f64,
    prior_mps2_per_k: f64,
}

impl ResidualModel for ThermalBias {
    /// b₀, m/s², and b₁, m/s² per K.
    type Point = [f64; 2];

    fn rows(&self, [bias, slope]: &[f64; 2]) -> Option<Rows> {
        let count = self.rests.len();
        let mut rows =
            Rows { residual: DVector::zeros(count + 1), jacobian: DMatrix::zeros(count + 1, 2) };
        for (k, [output, celsius]) in self.rests.iter().enumerate() {
            let warmer = celsius - self.reference_c;
            rows.residual[k] = (bias + slope * warmer - output) / self.noise_mps2;
            rows.jacobian[(k, 0)] = 1.0 / self.noise_mps2;
            rows.jacobian[(k, 1)] = warmer / self.noise_mps2;
        }
        rows.residual[count] = slope / self.prior_mps2_per_k;
        rows.jacobian[(count, 1)] = 1.0 / self.prior_mps2_per_k;
        Some(rows)
    }

    fn moved(&self, [bias, slope]: &[f64; 2], step: &DVector<f64>) -> [f64; 2] {
        [bias + step[0], slope + step[1]]
    }
}

#[test]
fn the_slope_is_that_of_the_rests_or_of_the_datasheet() {
    let settings = Settings { cauchy: None, last_step: 1e-9, magnitude: 1.0 };
    // Rests over this range, K: the prior is 5 mm/s² per K, the truth 4.
    for (range_k, least, most) in [(20.0, 0.003_9, 0.004_1), (0.0, -1e-9, 1e-9)] {
        let rest = |k: i32| {
            let warmer = range_k * f64::from(k) / 9.0;
            // Alternating, so that it is no slope.
            let noise = if k % 2 == 0 { 0.001 } else { -0.001 };
            [0.3 + 0.004 * warmer + noise, 25.0 + warmer]
        };
        let model = ThermalBias {
            rests: (0..10).map(rest).collect(),
            reference_c: 25.0,
            noise_mps2: 0.002,
            prior_mps2_per_k: 0.005,
        };
        let fit = minimise(&model, &[0.0; 2], &[1.0; 11], settings).expect("converges");
        let [bias, slope] = fit.at;
        assert!((bias - 0.3).abs() < 0.002 && (least..=most).contains(&slope), "{:?}", fit.at);
        let known = libm::sqrt(fit.inverse[(1, 1)]) / model.prior_mps2_per_k;
        assert!((known > 0.99) == (range_k <= 0.0), "{known}");
    }
}
