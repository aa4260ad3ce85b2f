//! What happened to aids, and anchors whose ranges contradict the path.

use super::aids::range::RANGE;
use super::aids::{Aid, Kind, several};
use crate::localization::AnchorStates;
use crate::{Code, Problem};

/// Fewest of a kind that contradict a path: 5 by chance is 10⁻¹⁵.
const DENIED: usize = 5;

/// What happened to the measurements of one kind.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct AidUse {
    /// Number that was used.
    pub used: usize,
    /// Number that contradicted the path. A rejected range had no line of sight, or little weight for another reason.
    pub rejected: usize,
    /// Number that came too late.
    pub late: usize,
    #[serde(skip)]
    kind: &'static Kind,
    /// Times of the first and of the last one that contradicted the path, s.
    #[serde(skip)]
    rejected_s: Option<[f64; 2]>,
}

impl AidUse {
    /// Of none.
    pub(super) fn of(kind: &'static Kind) -> Self {
        Self { used: 0, rejected: 0, late: 0, kind, rejected_s: None }
    }

    pub(super) fn count(&mut self, aid: &Aid, accepted: bool) {
        if accepted {
            self.used += 1;
            return;
        }
        self.rejected += 1;
        let first_s = self.rejected_s.map_or(aid.time_s, |[first_s, _]| first_s);
        self.rejected_s = Some([first_s, aid.time_s]);
    }

    /// What findings call one of them.
    pub(super) fn one(&self) -> &'static str {
        self.kind.one
    }

    /// A line of the result.
    pub(super) fn text(&self) -> String {
        let Self { used, rejected, late, kind, .. } = self;
        format!("{}: {used} used, {rejected} rejected, {late} late\n", several(kind.one))
    }

    /// When the first one contradicted the path, s, if most did.
    pub(super) fn denied_s(&self) -> Option<f64> {
        let most = self.rejected >= DENIED && self.rejected > self.used;
        self.rejected_s.filter(|_| most).map(|[first_s, _]| first_s)
    }

    /// What is said of rejected ones.
    pub(super) fn finding(&self) -> Option<Problem> {
        let (rejected, all) = (self.rejected, self.used + self.rejected);
        if all + self.late == 0 {
            let text = format!("the {} are not used", several(self.kind.one));
            return Some(Code::Navigation.warning(text).remedy(self.kind.needs));
        }
        let [first, last] = self.rejected_s?;
        if *self.kind == RANGE {
            let text = format!(
                "{rejected} of {all} ranges had no line of sight or contradict the path: little weight"
            );
            return Some(Code::Navigation.note(text));
        }
        if rejected as f64 <= self.kind.rejects * all as f64 {
            return None;
        }
        let text = format!(
            "{rejected} of {all} {} rejected: their innovations exceed the limit of the test",
            several(self.kind.one)
        );
        Some(Code::Navigation.warning(text).remedy(self.kind.remedy).between(first, last))
    }
}

/// Ranges of an anchor over which the fraction of contradicting ones is averaged, and the fraction that is reported.
const RANGES: f64 = 50.0;
const FRACTION: f64 = 0.6;

/// Anchors most of whose ranges contradict the path.
#[derive(Clone, Debug, Default)]
pub(super) struct Suspects {
    /// Fraction of the last ranges of each anchor that contradict the path, and when it exceeded [`FRACTION`] first, s.
    anchors: Vec<(f64, Option<f64>)>,
}

impl Suspects {
    /// A range to an anchor by its index, and whether it was believed.
    pub fn see(&mut self, anchor: usize, time_s: f64, believed: bool) {
        let count = self.anchors.len().max(anchor + 1);
        self.anchors.resize(count, (0.0, None));
        let (fraction, since_s) = &mut self.anchors[anchor];
        *fraction += (f64::from(!believed) - *fraction) / RANGES;
        if *fraction > FRACTION {
            since_s.get_or_insert(time_s);
        }
    }

    pub fn finding(&self, anchors: &AnchorStates) -> Option<Problem> {
        let pairs = anchors.names().zip(&self.anchors);
        let named = pairs.filter_map(|(name, (_, since_s))| {
            since_s.map(|since_s| format!("{name} from {since_s:.1} s"))
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
