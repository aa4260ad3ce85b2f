//! Which part of a link's data is authentic, from the tags of the device.

use serde::Serialize;
use wimu_link::auth::KeyId;

use crate::decode::{Arrival, Authenticity, Event};
use crate::finding::{Finding, FindingCode};
use crate::plural::counted;

/// Most intervals that are listed.
const MAX_LISTED: usize = 100;

/// What the tags of a link show. Times in s.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Authentication {
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
    pub findings: Vec<Finding>,
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
    pub fn see(&mut self, arrival: &Arrival) -> Option<&Finding> {
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
        if self.findings.len() == MAX_LISTED {
            return None;
        }
        let finding = FindingCode::Forged
            .warning(what)
            .between((self.epoch_s - length_s).max(0.0), self.epoch_s)
            .remedy("do not use data of this time; find out who can send on this link");
        self.findings.push(finding);
        self.findings.last()
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
