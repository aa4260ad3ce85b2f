//! What one board sent, and whether recordings of its replay hold it.

use std::cell::RefCell;
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use wimu_host::decode::{Decoder, Event, TimedSample};
use wimu_host::mcap_file::{Recorded, RecordingReader};
use wimu_link::message::Streams;
use wimu_link::{Hello, LinkRole};
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::Gauge;

/// What one board sent: frames with their times, and its samples.
pub struct Tape {
    /// Time since the tape's begin, µs, and the bytes of whole frames.
    pub(super) frames: Vec<(u64, Vec<u8>)>,
    pub(super) hello: Hello,
    /// Device time at the begin.
    pub(super) begin_us: u64,
    /// Value of each raw sample by its number.
    samples: HashMap<u32, [i32; 3]>,
    pub bytes: u64,
}

impl Tape {
    /// `seconds` of the raw samples of three axes at 100 Hz of a board in a hand.
    pub fn record(seconds: f64) -> Arc<Self> {
        let scene = Scene::new(World::default());
        let part = SensorPart::default();
        let source = Physics::new(part.random_truth(1, Gauge::LowerTriangular), scene.clone(), 1);
        let config = BoardConfig {
            cable: LinkConfig::default(),
            wireless: LinkConfig::default(),
            ..BoardConfig::default()
        };
        let board = RefCell::new(Board::start(config, source));
        let hello = {
            let mut host = Host::connect(&board, scene).expect("a board");
            let mut settings = host.cable.settings().expect("settings");
            settings.cable = Streams {
                corrected: false,
                navigation: false,
                environment: false,
                ..settings.cable
            };
            settings.wireless = Streams { raw: false, ..settings.cable };
            host.cable.set_settings(settings).expect("settings");
            *host.cable.hello()
        };
        let mut board = board.into_inner();
        board.link(LinkRole::Cable).pull();
        let begin_us = board.now_us();
        let (mut frames, mut open, mut bytes) = (Vec::new(), Vec::new(), 0);
        while board.now_us() < begin_us + (seconds * 1e6) as u64 {
            board.run_until(board.now_us() + 10_000);
            board.link(LinkRole::Wireless).pull();
            open.extend(board.link(LinkRole::Cable).pull());
            if let Some(end) = open.iter().rposition(|byte| *byte == 0) {
                let rest = open.split_off(end + 1);
                bytes += open.len() as u64;
                frames.push((board.now_us() - begin_us, std::mem::replace(&mut open, rest)));
            }
        }
        let mut samples = HashMap::new();
        let mut decoder = Decoder::new();
        for (at, piece) in &frames {
            decoder.push(at * 1000, piece, |arrival| {
                if let Event::Samples(batch) = &arrival.event {
                    samples.extend(batch.iter().map(|sample| (sample.sequence, sample.value)));
                }
            });
        }
        Arc::new(Self { frames, hello, begin_us, samples, bytes })
    }

    /// Bytes of frames a sample.
    pub fn bytes_a_sample(&self) -> f64 {
        self.bytes as f64 / self.samples.len() as f64
    }

    /// Whether it has this sample.
    pub fn has(&self, sample: &TimedSample) -> bool {
        self.samples.get(&sample.sequence) == Some(&sample.value)
    }

    /// Decodes recordings in their order, and asserts that every sample is the tape's and every gap is counted to the sample.
    pub fn verify(&self, files: &[PathBuf]) -> Found {
        let mut decoder = Decoder::new();
        let mut found = Found { files: files.len(), first: u32::MAX, ..Found::default() };
        let mut seen = 0;
        for file in files {
            let mut reader = RecordingReader::open(file).expect("a recording");
            while let Some(entry) = reader.next_entry().expect("readable") {
                match entry {
                    Recorded::Received(received) => {
                        decoder.push(received.host_ns, &received.bytes, |arrival| {
                            if let Event::Samples(batch) | Event::Late(batch) = &arrival.event {
                                for sample in batch.iter() {
                                    assert!(self.has(&sample), "{file:?}: {sample:?}");
                                    found.first = found.first.min(sample.sequence);
                                    found.last = found.last.max(sample.sequence);
                                    seen += 1;
                                }
                            }
                        })
                    }
                    Recorded::Lost { .. } => decoder.interrupt(),
                    _ => {}
                }
            }
        }
        let statistics = decoder.statistics();
        found.received = statistics.raw.received;
        found.missing = statistics.raw.missing;
        found.frames_damaged = statistics.frames_damaged;
        assert_eq!(seen, found.received + statistics.raw.late, "{statistics:?}");
        assert_eq!(
            u64::from(found.last - found.first) + 1,
            found.received + found.missing,
            "{statistics:?}"
        );
        found
    }
}

/// What the files of a board hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Found {
    pub received: u64,
    pub missing: u64,
    pub files: usize,
    pub frames_damaged: u64,
    pub first: u32,
    pub last: u32,
}

/// The files of a board in their order.
pub fn files(recordings: &Path, board: &str) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(recordings.join(board)) else {
        return Vec::new();
    };
    let mut files: Vec<_> = entries.map(|entry| entry.expect("readable").path()).collect();
    files.sort();
    files
}
