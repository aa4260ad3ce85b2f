//! What contradicting fixes and ranges have in common: an anchor, or a delay.

use nalgebra::Vector3;

use super::fixes::{Aided, Aiding, CONTRADICTIONS};
use crate::digits::significant;
use crate::localization::{RangeSample, Ranging};
use crate::plural::counted;
use crate::{Code, Problem};

/// Ranges of an anchor over which the fraction of contradicting ones is averaged, and the fraction that is reported.
const RANGES: f64 = 50.0;
const FRACTION: f64 = 0.6;

/// Anchors most of whose ranges contradict the path.
#[derive(Clone, Debug, Default)]
pub(super) struct Suspects {
    /// Fraction of the last ranges of each anchor that contradict the path.
    fractions: Vec<f64>,
    /// When it exceeded [`FRACTION`] first, s.
    since_s: Vec<Option<f64>>,
}

impl Suspects {
    /// A range, and whether it was believed.
    pub fn see(&mut self, range: &RangeSample, believed: bool) {
        let count = self.fractions.len().max(range.anchor + 1);
        self.fractions.resize(count, 0.0);
        self.since_s.resize(count, None);
        let fraction = &mut self.fractions[range.anchor];
        *fraction += (f64::from(!believed) - *fraction) / RANGES;
        if *fraction > FRACTION {
            self.since_s[range.anchor].get_or_insert(range.time_s);
        }
    }

    fn finding(&self, ranging: &Ranging) -> Option<Problem> {
        let pairs = ranging.anchors.iter().zip(&self.since_s);
        let named = pairs.filter_map(|(anchor, since_s)| {
            Some(format!("{} from {:.1} s", anchor.id, (*since_s)?))
        });
        let named: Vec<String> = named.collect();
        let text = format!(
            "most ranges contradict the path, anchor {}: has it moved, or no line of sight?",
            named.join(", ")
        );
        let remedy = "they have little weight; correct its position in the anchors";
        (!named.is_empty()).then(|| Code::Residuals.warning(text).remedy(remedy))
    }
}

/// Speed above which a position shows a delay, m/s.
const SPEED_MPS: f64 = 0.3;
/// Rejected fixes that show a delay at least, and the part of their squared innovations that it explains.
const LEAST: usize = 3;
const EXPLAINED: f64 = 0.6;

/// Sums over rejected fixes: the delay that explains their innovations r along the velocity v, −Σ r·v / Σ v². Equation (173).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    count: usize,
    product: f64,
    speed: f64,
    square: f64,
}

impl Lag {
    pub fn see(&mut self, innovation_m: &Vector3<f64>, velocity_mps: &Vector3<f64>) {
        if velocity_mps.norm() > SPEED_MPS {
            self.count += 1;
            self.product += innovation_m.dot(velocity_mps);
            self.speed += velocity_mps.norm_squared();
            self.square += innovation_m.norm_squared();
        }
    }

    /// s.
    fn delay_s(&self) -> Option<f64> {
        let explained = self.product * self.product / (self.speed * self.square);
        (self.count >= LEAST && explained > EXPLAINED).then(|| -self.product / self.speed)
    }
}

impl Aiding {
    /// What happened to the fixes and ranges up to now.
    pub fn findings(&self, ranging: Option<&Ranging>) -> Vec<Problem> {
        let mut found = Vec::new();
        if let Some([first, last]) = self.rejected_s {
            let text = format!(
                "{} of {} fixes contradict the path by far more than both standard deviations: not used",
                self.fixes.rejected,
                self.fixes.compared()
            );
            let remedy = match self.lag.delay_s() {
                Some(delay_s) => format!(
                    "a delay of about {} s explains most of them: try --setup fix_delay_s=S",
                    significant(delay_s, 2)
                ),
                None => "check their standard deviations, the delay (--setup fix_delay_s=S) and the lever arm (lever_arm_m)".to_owned(),
            };
            let finding = Code::Navigation.warning(text).remedy(remedy);
            found.push(finding.between(first, last));
        }
        let Aided { rejected, .. } = self.ranges;
        if rejected > 0 {
            let text = format!(
                "{rejected} of {} ranges had no line of sight or contradict the path: little weight",
                self.ranges.compared()
            );
            found.push(Code::Navigation.note(text));
        }
        found.extend(ranging.and_then(|ranging| self.suspects.finding(ranging)));
        if let (Some(first), Some(last)) = (self.jumps.first(), self.jumps.last()) {
            let times = counted(self.jumps.len(), "time");
            let text = match ranging {
                Some(_) => format!(
                    "several ranges contradicted the path, {times}: it jumps to the position that they show"
                ),
                None => format!(
                    "{CONTRADICTIONS} fixes in succession contradicted the path, {times}: it jumps to the next one there"
                ),
            };
            let finding = Code::Navigation.warning(text);
            found.push(finding.between(*first, *last));
        }
        found
    }
}
