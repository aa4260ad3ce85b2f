//! The full-scale range of a calibration.

use wimu_model::Sensitivity;

use super::Source;
use crate::recording::OutputUnit;
use crate::{Code, Problem};

/// A full-scale range, and its source.
#[derive(Clone, Copy)]
pub(super) struct Range {
    /// ± *g*.
    pub g: u8,
    pub source: Source,
}

impl Range {
    /// From the data, else as given, else that of 16 bits at this sensitivity.
    pub fn of(
        unit: OutputUnit,
        given: Option<u8>,
        sensitivity: Option<Sensitivity>,
    ) -> Option<Self> {
        let board = match unit {
            OutputUnit::Counts { range_g, .. } => range_g,
            OutputUnit::Mps2 => None,
        };
        let from = |source| move |g| Self { g, source };
        let likely = || sensitivity.map(likely_range_g);
        (board.map(from(Source::Board)))
            .or_else(|| given.map(from(Source::Given)))
            .or_else(|| likely().map(from(Source::SixteenBits)))
    }

    /// An assumed range.
    pub fn finding(self, sensitivity: Sensitivity) -> Option<Problem> {
        (self.source == Source::SixteenBits).then(|| {
            let text = format!(
                "the range is unknown: ±{} g assumed (16 bits at {:.0} LSB/g); a board accepts the calibration at this range \
                 only",
                self.g,
                sensitivity.lsb_per_g()
            );
            let finding = Code::RangeAssumed.warning(text);
            finding.remedy("give the range with --range")
        })
    }
}

/// The usual full-scale range of 16 bits at this sensitivity: the power of two below it, with 10 % for the scale
/// error of the sensor.
pub(super) fn likely_range_g(sensitivity: Sensitivity) -> u8 {
    let full_scale_g = 1.1 * 32768.0 / sensitivity.lsb_per_g();
    2_u8.pow((full_scale_g.log2().floor() as u32).min(7))
}
