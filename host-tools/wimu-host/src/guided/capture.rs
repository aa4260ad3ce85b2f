//! The poses of a board as they are held.

use serde::Serialize;
use wimu_calib::{Orientation, Phase, Pose, Session};
use wimu_link::message::Epoch;
use wimu_model::Sensitivity;

/// First part of a hold that its pose leaves out, s.
const FIRST_BLOCK_S: f64 = 0.1;

/// Whether the board rests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Hold {
    /// No sample arrived yet.
    #[default]
    Waiting,
    /// It moves.
    Moving,
    /// At rest for this long, of the duration of a capture, s.
    Holding(f64, f64),
    /// Captured: another orientation is needed.
    Captured,
}

/// The poses of a board: those that were found, and where their samples are in the recording.
pub(super) struct Capture {
    pub session: Session,
    /// m/s² of a count.
    scale: f64,
    rate_hz: f64,
    phase: Phase,
    /// The suggested orientation.
    pub next: Option<Orientation>,
    /// Samples that were pushed to the session, and those of them that are kept.
    pushed: u64,
    pub kept: u64,
    /// Number of kept samples before each pose.
    starts: Vec<u64>,
    /// The present output, m/s², smoothed over about ten samples.
    pub output_mps2: Option<[f64; 3]>,
}

impl Capture {
    /// From the start of an epoch on; `None` without a sensitivity.
    pub fn new(epoch: &Epoch, wanted: usize) -> Option<Self> {
        let sensitivity = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok()?;
        let rate_hz = 1e9 / f64::from(epoch.period_ns.max(1));
        Some(Self {
            session: Session::new(rate_hz, wanted),
            scale: sensitivity.mps2_per_lsb(),
            rate_hz,
            phase: Phase::WaitingForRest,
            next: None,
            pushed: 0,
            kept: 0,
            starts: Vec::new(),
            output_mps2: None,
        })
    }

    /// Takes a sample; returns whether a pose was captured.
    pub fn push(&mut self, counts: [f64; 3]) -> bool {
        let output = counts.map(|axis| axis * self.scale);
        let smooth = self.output_mps2.get_or_insert(output);
        (0..3).for_each(|axis| smooth[axis] += 0.1 * (output[axis] - smooth[axis]));
        self.pushed += 1;
        self.kept += 1;
        self.phase = self.session.push(output);
        matches!(self.phase, Phase::Captured { .. })
    }

    /// The pose that was captured now; its samples begin with its hold.
    pub fn captured(&mut self) -> Option<Pose> {
        let pose = *self.session.poses().last()?;
        let since = self.pushed.saturating_sub(pose.first_sample);
        self.starts.push(self.kept.saturating_sub(since));
        Some(pose)
    }

    /// Removes the latest pose; returns how many samples to remove with it.
    pub fn undo(&mut self) -> Option<u64> {
        self.session.undo()?;
        let start = self.starts.pop()?.saturating_sub((FIRST_BLOCK_S * self.rate_hz) as u64);
        Some(self.kept.saturating_sub(start))
    }

    pub fn hold(&self) -> Hold {
        let seconds = |samples: u32| f64::from(samples) / self.rate_hz;
        match self.phase {
            Phase::WaitingForRest => Hold::Moving,
            Phase::Collecting { samples } => {
                Hold::Holding(seconds(samples), seconds(self.session.capture_samples()))
            }
            _ => Hold::Captured,
        }
    }
}
