//! Which part of a link's data is authentic, from the tags of the device.

use serde::Serialize;
use wimu_link::auth::KeyId;

use crate::decode::{Arrival, Authenticity, Event};
use crate::plural::counted;
use crate::{Code, Problem};

/// Most intervals that are listed.
const MAX_LISTED: usize = 100;

/// Time in which a device that sends tags, one a second or more, has sent a whole interval: one had begun before the
/// link, one may be incomplete, s.
const WHOLE_S: f64 = 3.0;

/// What the tags of a link show. Times in s.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Authentication {
    /// Whether this computer has a key of the device: then its data can be authentic.
    pub key_known: bool,
    /// Time from the first data to the latest.
    pub total_s: f64,
    /// Of it, the time in which every frame is authentic.
    pub verified_s: f64,
    /// Intervals in which every frame is authentic.
    pub verified: u64,
    /// Intervals that cannot be verified, because frames did not arrive.
    pub incomplete: u64,
    /// Intervals with forged frames.
    pub forged: u64,
    /// Tags of an earlier interval or start.
    pub replayed: u64,
    /// Tags of a key that is not known here.
    pub unknown_key: u64,
    /// The first 100 forged intervals and replayed tags, in device time.
    #[serde(skip)]
    forgeries: Vec<Problem>,
    /// The latest such key.
    #[serde(skip)]
    key: Option<KeyId>,
    #[serde(skip)]
    first_ns: Option<u64>,
    /// Device time of the latest epoch.
    #[serde(skip)]
    epoch_s: f64,
}

impl Authentication {
    /// Takes the next event; returns what it shows to be forged or replayed.
    pub fn see(&mut self, arrival: &Arrival) -> Option<&Problem> {
        let first_ns = *self.first_ns.get_or_insert(arrival.host_ns);
        self.total_s = seconds(first_ns, arrival.host_ns);
        let interval = match &arrival.event {
            Event::Epoch { epoch, .. } => {
                self.epoch_s = epoch.time_us as f64 * 1e-6;
                return None;
            }
            Event::Tagged(interval) => interval,
            _ => return None,
        };
        let length_s = seconds(interval.began_ns, arrival.host_ns);
        let what = match interval.authenticity {
            Authenticity::Verified => {
                self.verified += 1;
                self.verified_s += length_s;
                return None;
            }
            Authenticity::Incomplete => {
                self.incomplete += 1;
                return None;
            }
            Authenticity::UnknownKey(key) => {
                self.unknown_key += 1;
                self.key = Some(key);
                return None;
            }
            Authenticity::Forged => {
                self.forged += 1;
                "the data are not those that the device sent"
            }
            Authenticity::Replayed => {
                self.replayed += 1;
                "the authentication of earlier data arrived again"
            }
        };
        if self.forgeries.len() == MAX_LISTED {
            return None;
        }
        let finding = Code::Forged
            .warning(what)
            .between((self.epoch_s - length_s).max(0.0), self.epoch_s)
            .remedy("do not use data of this time; find out who can send on this link");
        self.forgeries.push(finding);
        self.forgeries.last()
    }

    /// Without tags yet, of a device of which this computer has a key or not.
    pub fn new(key_known: bool) -> Self {
        Self { key_known, ..Self::default() }
    }

    /// The warning that nothing is authentic of a device whose key this computer has: whoever removes the tags can change
    /// the data.
    pub fn finding(&self) -> Option<Problem> {
        let is_early = self.has_tags() && self.total_s < WHOLE_S;
        if !self.key_known || self.verified > 0 || is_early {
            return None;
        }
        let text = format!(
            "authentic: 0.0 of {:.1} s, although this computer has the device's key",
            self.total_s
        );
        Some(Code::NotAuthentic.warning(text).remedy(
            "do not trust the data if the device has this key; find out who can change data on this link",
        ))
    }

    /// What was forged or replayed, and the warning that nothing is authentic.
    pub fn findings(&self) -> impl Iterator<Item = Problem> + '_ {
        self.forgeries.iter().cloned().chain(self.finding())
    }

    /// Whether there was a tag, or could have been.
    pub fn is_known(&self) -> bool {
        self.key_known || self.has_tags()
    }

    /// Whether there was a tag.
    pub fn has_tags(&self) -> bool {
        self.judged() + self.unknown_key > 0
    }

    fn judged(&self) -> u64 {
        self.verified + self.incomplete + self.forged + self.replayed
    }

    /// One line; `None` without tags.
    pub fn text(&self) -> Option<String> {
        if let (0, Some(key)) = (self.judged(), self.key) {
            return Some(format!("authentication not checked: this computer lacks the key {key}"));
        }
        let mut text = format!("authentic: {:.1} of {:.1} s", self.verified_s, self.total_s);
        for (count, what) in [
            (self.forged, "forged"),
            (self.replayed, "replayed"),
            (self.incomplete, "not verifiable (begun before this link, or frames lost)"),
            (self.unknown_key, "with another key"),
        ] {
            if count > 0 {
                text += &format!("; {} {what}", counted(count as usize, "interval"));
            }
        }
        self.has_tags().then_some(text)
    }
}

fn seconds(from_ns: u64, until_ns: u64) -> f64 {
    until_ns.saturating_sub(from_ns) as f64 * 1e-9
}
