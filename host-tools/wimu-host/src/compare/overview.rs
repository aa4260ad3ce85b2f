//! The first reading: devices, streams and clocks.

use std::collections::BTreeMap;
use std::io::Read;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;

use super::delivery::Heard;
use super::link::Slicing;
use super::{ROLES, SLICES, UNDER_WAY_NS, index_of, refused};
use crate::Result;
use crate::capture::{Capture, Link};
use crate::clock::ClockModel;
use crate::decode::{Event, LinkStatistics, Samples};
use crate::mcap_file::{Recorded, RecordingReader};
use crate::units::SampleUnit;
use crate::walk::{Start, Step};

/// Result of the first reading.
pub(super) struct Overview {
    pub stream: Stream,
    pub recording: Capture,
    /// Samples of the stream in each start.
    pub starts: BTreeMap<Start, usize>,
    pub span: (u64, u64),
    pub heard: [Heard; 2],
}

impl Overview {
    pub fn read<R: Read>(reader: RecordingReader<R>, name: &str) -> Result<Self> {
        let mut span: Option<(u64, u64)> = None;
        // Host times of the opening and the first data of each link, and its first decimation.
        let (mut opened_ns, mut heard_ns, mut every) = ([None; 2], [None; 2], [None; 2]);
        let recording = Capture::survey_of(reader, name, |role, _, step| {
            let link = index_of(role);
            match step {
                Step::Other(Recorded::Sent { host_ns, .. }) => {
                    opened_ns[link].get_or_insert(*host_ns);
                }
                Step::Arrival(arrival) => {
                    let (first, last) = span.unwrap_or((arrival.host_ns, arrival.host_ns));
                    span = Some((first.min(arrival.host_ns), last.max(arrival.host_ns)));
                    heard_ns[link].get_or_insert(arrival.host_ns);
                    if let Event::Samples(heard) = &arrival.event
                        && heard.sensor == 0
                    {
                        every[link].get_or_insert(heard.every);
                    }
                }
                Step::Other(_) => {}
            }
        })?;
        let links = ROLES.map(|role| recording.links.get(&role));
        for (link, role) in links.into_iter().zip(ROLES) {
            if link.is_none_or(|link| {
                link.count(0, Stream::Raw) + link.count(0, Stream::Corrected) == 0
            }) {
                return Err(refused(
                    name,
                    format!("the {role} link is missing: it has no samples"),
                    "record both links of the board: `wimu record LINK LINK`",
                ));
            }
        }
        if recording.devices.len() > 1 {
            let named = recording.devices.iter().map(|id| format!("{id:016x}"));
            return Err(refused(
                name,
                format!(
                    "the recording contains different boards: {}",
                    Vec::from_iter(named).join(", ")
                ),
                "record both links of one board; compare two devices by their tables: `wimu compare A.csv B.csv`",
            ));
        }
        let stream = [Stream::Raw, Stream::Corrected]
            .into_iter()
            .find(|stream| {
                let has = |link: &Link| link.count(0, *stream) > 0;
                links.into_iter().flatten().all(has)
            })
            .ok_or_else(|| {
                refused(
                    name,
                    "one link carries raw samples only, the other one corrected ones only",
                    "set both to the same stream: `wimu device settings set LINK --cable raw --wireless raw`",
                )
            })?;
        let mut starts: BTreeMap<Start, usize> = BTreeMap::new();
        for boot in links.into_iter().flatten().flat_map(|link| &link.boots) {
            let counts = [Stream::Raw, Stream::Corrected].map(|stream| boot.counts.of(0, stream));
            if let (Some(start), true) = (boot.start, counts != [0; 2]) {
                *starts.entry(start).or_default() += boot.counts.of(0, stream);
            }
        }
        Ok(Self {
            stream,
            starts,
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
            recording,
        })
    }

    /// Whether these samples are of the compared stream.
    pub fn is_compared(&self, samples: &Samples) -> bool {
        (samples.sensor, samples.stream) == (0, self.stream)
    }

    /// The device's clock in a start, from both links.
    pub fn clock(&self, start: Start) -> Option<&ClockModel> {
        self.recording.starts.get(&start)?.clock()
    }

    /// The unit of a sample of the stream; `None` if unknown.
    pub fn unit(&self, start: Start, sequence: u32) -> Option<SampleUnit> {
        let start = self.recording.starts.get(&start)?;
        start.unit(self.stream, 0, sequence)
    }

    pub fn link(&self, role: LinkRole) -> Option<&Link> {
        self.recording.links.get(&role)
    }

    pub fn span_ns(&self) -> u64 {
        self.span.1 - self.span.0
    }

    pub fn slicing(&self) -> Slicing {
        Slicing { start_ns: self.span.0 as i64, span_ns: self.span_ns(), count: SLICES }
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
        let link = self.link(role);
        link.map(|link| link.statistics).unwrap_or_default()
    }
}
