//! The full-scale range of a calibration.

use wimu_model::Sensitivity;

use super::Source;
use crate::dataset::OutputUnit;

/// A full-scale range, and who said it.
#[derive(Clone, Copy)]
pub(super) struct Range {
    /// ± *g*.
    pub g: u8,
    pub source: Source,
}

impl Range {
    /// As the data say it, else as given, else as 16 bits have it at this sensitivity.
    pub fn of(
        unit: OutputUnit,
        given: Option<u8>,
        sensitivity: Option<Sensitivity>,
    ) -> Option<Self> {
        let board = match unit {
            OutputUnit::Counts { range_g, .. } => range_g,
            OutputUnit::Mps2 => None,
        };
        let told = |source| move |g| Self { g, source };
        let likely = || sensitivity.map(likely_range_g);
        (board.map(told(Source::Board)))
            .or_else(|| given.map(told(Source::Given)))
            .or_else(|| likely().map(told(Source::SixteenBits)))
    }

    /// That nobody has said it.
    pub fn remark(self, sensitivity: Sensitivity) -> Option<String> {
        (self.source == Source::SixteenBits).then(|| {
            format!(
                "the range is not known: ±{} g is taken, as of 16 bits at {:.0} LSB/g; a board takes the \
                 calibration only at its range: say it with --range",
                self.g,
                sensitivity.lsb_per_g()
            )
        })
    }
}

/// The usual full-scale range of 16 bits at this sensitivity: the power of two below it, a tenth
/// allowed for the sensor's own scale error.
pub(super) fn likely_range_g(sensitivity: Sensitivity) -> u8 {
    let full_scale_g = 1.1 * 32768.0 / sensitivity.lsb_per_g();
    2_u8.pow((full_scale_g.log2().floor() as u32).min(7))
}
