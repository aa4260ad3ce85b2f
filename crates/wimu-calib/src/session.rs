//! Live calibration: recommended orientations and captured poses.

use alloc::vec::Vec;

use crate::{Guide, Orientation, Pose, PoseFinder};

/// Duration of a hold that is captured as a pose, s.
const CAPTURE_S: f64 = 1.5;
/// Distance below which a hold repeats the last pose, m/s²: 2° of gravity.
const SAME_POSE_MPS2: f64 = 0.34;

/// State of a [`Session`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The sensor moves: put it down as [`Session::next`] recommends, or in any other orientation,
    /// and hold it still.
    WaitingForRest,
    /// The sensor is at rest.
    Collecting {
        /// Samples of the hold.
        samples: u32,
    },
    /// A pose was captured with this sample; [`Session::poses`] holds it at this index. Holding
    /// longer improves it.
    Captured {
        /// Its index.
        pose: usize,
    },
    /// The pose is captured: move the sensor to another orientation.
    WaitingForMotion,
    /// Enough poses were captured.
    Done,
}

/// Captures the poses of a sensor that is turned by hand, and recommends orientations, until there
/// are enough for a calibration.
///
/// ```
/// use wimu_calib::{Gravity, MultiPosition, Phase, Session, multi_position};
///
/// let mut session = Session::new(100.0, 12);
/// let mut noise = 0.01;
/// while let Some(next) = session.next() {
///     // A person who follows the advice: half a second of motion, three of holding still.
///     let up = next.up();
///     for k in 0..350 {
///         noise = -noise;
///         let wild = if k < 50 { f64::from(k % 7) } else { 0.0 };
///         let sample = up.map(|axis| 9.80665 * axis + wild + noise);
///         if let Phase::Captured { pose } = session.push(sample) {
///             println!("pose {pose} taken; next: {:?}", session.next());
///         }
///     }
/// }
/// assert_eq!(session.push([0.0, 0.0, 9.8]), Phase::Done);
/// let estimate = multi_position(session.poses(), Gravity::UNKNOWN_PLACE, MultiPosition::default())?;
/// assert_eq!(estimate.poses, 12);
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    finder: PoseFinder,
    guide: Guide,
    poses: Vec<Pose>,
    wanted: usize,
    capture_samples: u32,
    /// Whether the current hold was captured.
    taken: bool,
    /// Whether the current hold is left out because its pose was removed.
    ignored: bool,
    unreachable: Vec<Orientation>,
}

impl Session {
    /// A session of samples at `rate_hz` for `wanted` poses.
    pub fn new(rate_hz: f64, wanted: usize) -> Self {
        Self {
            finder: PoseFinder::new(rate_hz),
            guide: Guide::default(),
            poses: Vec::new(),
            wanted,
            // NaN becomes 0.
            capture_samples: ((CAPTURE_S * rate_hz) as u32).max(1),
            taken: false,
            ignored: false,
            unreachable: Vec::new(),
        }
    }

    /// Takes one sample y, m/s², sensor axes.
    pub fn push(&mut self, output_mps2: [f64; 3]) -> Phase {
        // Poses are captured during the hold, so the completed ones are not needed.
        self.finder.push(output_mps2);
        let Some(hold) = self.finder.held() else {
            self.taken = false;
            self.ignored = false;
            return self.waiting(Phase::WaitingForRest);
        };
        if self.ignored {
            return Phase::WaitingForMotion;
        }
        if self.taken {
            if let Some(pose) = self.poses.last_mut() {
                *pose = hold;
            }
            return self.waiting(Phase::WaitingForMotion);
        }
        if self.poses.len() >= self.wanted {
            return Phase::Done;
        }
        if self.is_again(&hold) {
            return Phase::WaitingForMotion;
        }
        if hold.samples < self.capture_samples {
            return Phase::Collecting { samples: hold.samples };
        }
        Phase::Captured { pose: self.take(hold) }
    }

    /// Captures the current hold before it is long enough; returns its index. `None` if the sensor
    /// moves, the hold is already captured, or there are enough.
    pub fn capture(&mut self) -> Option<usize> {
        let hold = self.finder.held()?;
        let is_new =
            !self.taken && !self.ignored && !self.is_again(&hold) && self.poses.len() < self.wanted;
        is_new.then(|| self.take(hold))
    }

    /// Removes the latest pose and returns it. If the sensor still rests, that hold is not captured again.
    pub fn undo(&mut self) -> Option<Pose> {
        let removed = self.poses.pop()?;
        self.guide = Guide::after(&self.poses);
        self.taken = false;
        self.ignored = self.finder.held().is_some();
        Some(removed)
    }

    /// Whether the sensor still rests as in a pose that was removed.
    pub fn ignores_hold(&self) -> bool {
        self.ignored
    }

    /// Number of samples of a hold at which it is captured.
    pub fn capture_samples(&self) -> u32 {
        self.capture_samples
    }

    /// The design of the poses so far.
    pub fn guide(&self) -> &Guide {
        &self.guide
    }

    fn is_again(&self, hold: &Pose) -> bool {
        self.poses().last().is_some_and(|last| {
            let apart = (0..3).map(|axis| last.mean_mps2[axis] - hold.mean_mps2[axis]);
            apart.map(|d| d * d).sum::<f64>() < SAME_POSE_MPS2 * SAME_POSE_MPS2
        })
    }

    fn take(&mut self, hold: Pose) -> usize {
        let pose = self.poses.len();
        self.taken = true;
        self.poses.push(hold);
        self.guide.take(hold.mean_mps2);
        pose
    }

    /// The recommended orientation, planned together with the remaining ones; `None` when there are
    /// enough poses, or none that can be reached adds information. Costs 0.5 million operations.
    pub fn next(&self) -> Option<Orientation> {
        let remaining = self.wanted.checked_sub(self.poses.len()).filter(|n| *n > 0)?;
        self.guide.next_of(remaining, |orientation| !self.unreachable.contains(&orientation))
    }

    /// Sets the number of poses to capture.
    pub fn want(&mut self, wanted: usize) {
        self.wanted = wanted;
    }

    /// Excludes the recommended orientation: it cannot be reached.
    pub fn skip(&mut self) {
        self.unreachable.extend(self.next());
    }

    /// The poses captured so far.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn waiting(&self, phase: Phase) -> Phase {
        if self.poses.len() >= self.wanted { Phase::Done } else { phase }
    }
}
