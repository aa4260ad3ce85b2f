//! The first reading: devices, streams and clocks.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;

use super::holes::Holes;
use super::link::Slicing;
use super::pairing::Heard;
use super::units::Units;
use super::{ROLES, SLICES, UNDER_WAY_NS, index_of, refused};
use crate::Result;
use crate::clock::ClockModel;
use crate::decode::{Event, LinkStatistics};
use crate::mcap_file::{RecordingReader, Wholeness};
use crate::units::RawUnits;
use crate::walk::{Clocks, Start, Step, walk};

/// Result of the first reading.
pub(super) struct Overview {
    pub stream: Stream,
    pub devices: Vec<u64>,
    /// Samples of the stream in each start.
    pub starts: BTreeMap<Start, u64>,
    pub span: (u64, u64),
    pub heard: [Heard; 2],
    pub wholeness: Wholeness,
    pub holes: Holes,
    pub units: Units,
    pub clocks: BTreeMap<Start, ClockModel>,
    pub single: [Option<ClockModel>; 2],
    pub statistics: Vec<(LinkRole, LinkStatistics)>,
}

impl Overview {
    pub fn read<R: Read>(mut reader: RecordingReader<R>, name: &str) -> Result<Self> {
        let mut clocks = Clocks::default();
        let mut devices = BTreeSet::new();
        // By stream and link.
        let mut samples = [[0_u64; 2]; 2];
        let mut starts: BTreeMap<Start, [u64; 2]> = BTreeMap::new();
        let mut span: Option<(u64, u64)> = None;
        // Host times of the opening and the first data of each link, and its first decimation.
        let (mut opened_ns, mut heard_ns, mut every) = ([None; 2], [None; 2], [None; 2]);
        // By stream.
        let mut holes: [Holes; 2] = Default::default();
        let mut raw_units: BTreeMap<Start, RawUnits> = BTreeMap::new();
        let statistics = walk(&mut reader, |role, start, step| {
            clocks.see(role, start, &step);
            if let Step::Sent { host_ns, .. } = step {
                opened_ns[index_of(role)].get_or_insert(host_ns);
            }
            if let Step::Damaged = step {
                holes
                    .iter_mut()
                    .for_each(|holes| holes.open(index_of(role)));
            }
            if let Step::Arrival(arrival) = &step {
                let (first, last) = span.unwrap_or((arrival.host_ns, arrival.host_ns));
                span = Some((first.min(arrival.host_ns), last.max(arrival.host_ns)));
                heard_ns[index_of(role)].get_or_insert(arrival.host_ns);
                match &arrival.event {
                    Event::Hello(hello) => {
                        devices.insert(hello.device_id);
                    }
                    Event::Epoch { epoch, .. } => raw_units.entry(start).or_default().see(epoch),
                    Event::Samples(heard) => {
                        let count = heard.values.len() as u64;
                        every[index_of(role)].get_or_insert(heard.every);
                        holes[heard.stream as usize].take(index_of(role), start, heard);
                        samples[heard.stream as usize][index_of(role)] += count;
                        starts.entry(start).or_default()[heard.stream as usize] += count;
                    }
                    _ => {}
                }
            }
            Ok(())
        })?;
        for (index, role) in ROLES.into_iter().enumerate() {
            if samples[0][index] + samples[1][index] == 0 {
                return Err(refused(
                    name,
                    format!("the {role} link is missing: it has no samples"),
                    "record both links of the board: `wimu record LINK --cable LINK`",
                ));
            }
        }
        if devices.len() > 1 {
            let named: Vec<_> = devices.iter().map(|id| format!("{id:016x}")).collect();
            return Err(refused(
                name,
                format!(
                    "the recording contains different boards: {}",
                    named.join(", ")
                ),
                "record both links of one board; compare two devices by their tables: `wimu compare A.csv B.csv`",
            ));
        }
        let stream = [Stream::Raw, Stream::Corrected]
            .into_iter()
            .find(|stream| samples[*stream as usize].iter().all(|count| *count > 0))
            .ok_or_else(|| {
                refused(
                    name,
                    "one link carries raw samples only, the other one corrected ones only",
                    "set both to the same stream: `wimu settings set LINK --cable raw --wireless raw`",
                )
            })?;
        let mut holes = std::mem::take(&mut holes[stream as usize]);
        holes.close();
        Ok(Self {
            stream,
            devices: devices.into_iter().collect(),
            starts: starts
                .into_iter()
                .map(|(start, counts)| (start, counts[stream as usize]))
                .collect(),
            span: span.unwrap_or_default(),
            heard: [0, 1].map(|link| {
                let heard: u64 = heard_ns[link].unwrap_or_default();
                let opened = opened_ns[link].unwrap_or(heard);
                let was_silent = heard.saturating_sub(opened) > UNDER_WAY_NS;
                Heard {
                    from_ns: if was_silent { opened } else { heard } as i64,
                    every: every[link].unwrap_or(1),
                }
            }),
            wholeness: reader.wholeness(),
            holes,
            units: match stream {
                Stream::Raw => Units::Raw(raw_units),
                Stream::Corrected => Units::Corrected,
            },
            clocks: clocks.models(),
            single: ROLES.map(|role| clocks.of_link(role)),
            statistics,
        })
    }

    pub fn span_ns(&self) -> u64 {
        self.span.1 - self.span.0
    }

    pub fn slicing(&self) -> Slicing {
        Slicing {
            start_ns: self.span.0 as i64,
            span_ns: self.span_ns(),
            count: SLICES,
        }
    }

    pub fn seconds(&self, host_ns: u64) -> f64 {
        host_ns.saturating_sub(self.span.0) as f64 * 1e-9
    }

    /// The start with the most samples.
    pub fn longest(&self) -> Option<Start> {
        let most = self.starts.iter().max_by_key(|(_, samples)| **samples);
        most.map(|(start, _)| *start)
    }

    pub fn statistics(&self, role: LinkRole) -> LinkStatistics {
        let found = self.statistics.iter().find(|(known, _)| *known == role);
        found.map(|(_, statistics)| *statistics).unwrap_or_default()
    }
}
