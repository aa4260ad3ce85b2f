//! First light: the whole loop on a simulated board in virtual time. What `wimu demo` shows and
//! the end-to-end test holds.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::Cursor;
use std::rc::Rc;
use std::time::Duration;

use wimu_host::calibration::{CalibrateOptions, CalibrationReport, MethodChoice, calibrate};
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::dataset::Dataset;
use wimu_host::decode::TimedSample;
use wimu_host::history::{Boot, Recording};
use wimu_host::mcap_file::{ClockAnchor, Recorded, RecordingReader, RecordingWriter};
use wimu_host::navigation::{self, Point};
use wimu_host::recorder::Tap;
use wimu_host::replay::{self, ReplayReport};
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Result};
use wimu_link::auth::DeviceKey;
use wimu_link::message::Settings;
use wimu_link::{Hello, LinkRole};
use wimu_model::{DeviceTimeUs, ParameterId, ParameterSet, SpecificForceMps2, SpecificForceQ16};

use crate::board::{Board, BoardConfig, SimLink, VirtualBoard};
use crate::motion::{Hold, Motion, Poses, Rest, Slide};
use crate::scene::{Scene, World};
use crate::source::Physics;
use crate::truth::{Gauge, SensorTruth};

/// How long a pose is held, s.
const HOLD_S: f64 = 4.0;
/// Rests of a slide, s: the sensor's true period is measured meanwhile.
const REST_S: f64 = 6.0;
/// How long its move takes, s, and when it ends.
const MOVE_S: f64 = 3.0;
const MOVED_S: f64 = REST_S + MOVE_S;
/// How far a hand places a pose off, degrees.
const PLACEMENT_DEG: f64 = 2.0;
/// Left out at both ends of a hold, s: the turn's smooth end, and a batch.
const MARGIN_S: f64 = 0.3;

/// How the board is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calibration {
    /// Six squared positions, 12 parameters; the hidden misalignment is any.
    SixPositions,
    /// Twelve poses placed by hand, 2° off, 9 parameters; the hidden misalignment is
    /// lower-triangular, which is what gravity alone can tell.
    TwelvePoses,
}

/// A scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstLight {
    /// Hidden errors and noise.
    pub seed: u64,
    /// How the board is calibrated.
    pub calibration: Calibration,
}

/// Distance error of a 1.000 m slide in 3 s between two rests, 3-D, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlideErrors {
    /// Uncalibrated, no ZUPT: position when the slide ends.
    pub uncalibrated_m: f64,
    /// Calibrated, no ZUPT, likewise.
    pub calibrated_m: f64,
    /// Calibrated, ZUPT at both ends.
    pub zupt_m: f64,
}

/// What came of it. Everything is as the device sent it.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Who answered on the cable.
    pub hello: Hello,
    /// What is hidden in the sensor.
    pub truth: SensorTruth,
    /// Raw samples recorded on both links before the calibration.
    pub samples: usize,
    /// What `calibrate` made of them.
    pub report: CalibrationReport,
    /// How the device answered a push over the wireless link: before it had a key, without the key
    /// when it had one, and with a wrong one.
    pub refusals: Vec<Option<HostError>>,
    /// What the device holds after the push over the wireless link with its key.
    pub pushed: ParameterId,
    /// How long that took, session and read-back included, s.
    pub push_s: f64,
    /// What it holds after a restart.
    pub after_restart: ParameterId,
    /// Boot counts before and after the restart.
    pub boot_counts: [u32; 2],
    /// |f| − g on each of ten tilts that were not fitted, m/s²: raw at nominal sensitivity, and
    /// corrected.
    pub tilts: Vec<[f64; 2]>,
    /// Position errors.
    pub slide: SlideErrors,
    /// The uncalibrated slide without ZUPT, from the start of its first rest.
    pub uncalibrated_path: Vec<Point>,
    /// The calibrated one without ZUPT.
    pub calibrated_path: Vec<Point>,
    /// The calibrated one with ZUPT.
    pub zupt_path: Vec<Point>,
    /// Everything recorded, replayed on the host, for each link and start of the device.
    pub replays: Vec<ReplayReport>,
    /// Virtual time, s.
    pub duration_s: f64,
    /// The recording of both links, an MCAP file.
    pub recording: Vec<u8>,
}

impl FirstLight {
    /// Runs it on a simulated board.
    ///
    /// # Errors
    /// Whatever a step of the host reports.
    pub fn run(&self) -> Result<Outcome> {
        self.run_on(|source| Ok(Board::start(BoardConfig::default(), source)))
    }

    /// Runs it on the board that `start` gives power, with a sensor that takes its samples from
    /// the source.
    ///
    /// # Errors
    /// Whatever a step of the host, or `start`, reports.
    pub fn run_on<R: VirtualBoard>(
        &self,
        start: impl FnOnce(Physics) -> Result<R>,
    ) -> Result<Outcome> {
        let gauge = match self.calibration {
            Calibration::SixPositions => Gauge::Full,
            Calibration::TwelvePoses => Gauge::LowerTriangular,
        };
        let truth = SensorTruth::random(self.seed, gauge);
        let scene = Scene::new(World::default());
        let source = Physics::new(truth, scene.clone(), self.seed);
        let board = RefCell::new(start(source)?);
        let mut host = Host::connect(&board, scene)?;
        let hello = *host.cable.hello();

        let uncalibrated = host.slide(false)?;
        host.set_zupt(true)?;
        host.play(Rc::new(match self.calibration {
            Calibration::SixPositions => Poses::six_positions(HOLD_S),
            Calibration::TwelvePoses => Poses::twelve_by_hand(self.seed, PLACEMENT_DEG, HOLD_S),
        }))?;
        let recording = host.recording()?;
        let samples = recording
            .links
            .iter()
            .flat_map(|link| &link.boots)
            .map(|boot| boot.raw.len())
            .sum();
        let (report, set) = self.calibrate(&recording)?;

        let mut refusals = vec![host.wireless.push_parameters(&set).err()];
        // What is simulated has no secrets: the same key in every run.
        let mut key = [0; DeviceKey::LENGTH];
        for (byte, seed) in key.iter_mut().zip(self.seed.to_le_bytes()) {
            *byte = seed;
        }
        let key = DeviceKey::new(key);
        host.set_key(key)?;
        for stranger in [None, Some(DeviceKey::new([0xFF; DeviceKey::LENGTH]))] {
            host.wireless.use_key(stranger);
            refusals.push(host.wireless.push_parameters(&set).err());
        }
        host.wireless.use_key(Some(key));
        let began_s = host.now_s();
        let pushed = host.wireless.push_parameters(&set)?;
        let push_s = host.now_s() - began_s;
        let boot_count = host.cable.hello().boot_count;
        host.restart()?;
        let boot_counts = [boot_count, host.cable.hello().boot_count];
        let after_restart = ParameterId(host.cable.parameters()?.id);

        let tilts = Poses::tilts(self.seed, HOLD_S);
        let held = host.play(Rc::new(tilts.clone()))?;
        let calibrated = host.slide(false)?;
        let with_zupt = host.slide(true)?;

        let recording = host.recording()?;
        let uncalibrated_path = uncalibrated.path(&recording)?;
        let calibrated_path = calibrated.path(&recording)?;
        let zupt_path = with_zupt.path(&recording)?;
        let replays = recording
            .links
            .iter()
            .flat_map(|link| &link.boots)
            .map(|boot| replay::verify(boot, 0))
            .collect();
        Ok(Outcome {
            hello,
            truth,
            samples,
            report,
            refusals,
            pushed,
            push_s,
            after_restart,
            boot_counts,
            tilts: held.tilts(&recording, tilts.holds(), &set)?,
            slide: SlideErrors {
                // Without ZUPT position is only good while it is fresh; with it, at the rest afterwards.
                uncalibrated_m: host.slide_error_m(&uncalibrated_path, uncalibrated, MOVED_S)?,
                calibrated_m: host.slide_error_m(&calibrated_path, calibrated, MOVED_S)?,
                zupt_m: host.slide_error_m(&zupt_path, with_zupt, f64::INFINITY)?,
            },
            uncalibrated_path,
            calibrated_path,
            zupt_path,
            replays,
            duration_s: board.borrow().now_us() as f64 * 1e-6,
            recording: host.file()?,
        })
    }

    /// Calibrates from what the cable brought.
    fn calibrate(&self, recording: &Recording) -> Result<(CalibrationReport, ParameterSet)> {
        let options = CalibrateOptions {
            method: match self.calibration {
                Calibration::SixPositions => MethodChoice::SixPosition,
                Calibration::TwelvePoses => MethodChoice::MultiPosition,
            },
            placement_sd_deg: Some(0.0),
            gravity_mps2: Some(World::default().gravity_mps2),
            ..CalibrateOptions::default()
        };
        let cable = recording.link(Some(LinkRole::Cable))?;
        let report = calibrate(&Dataset::from_link(cable, "the simulated board")?, &options)?;
        match report.parameters {
            Some(set) => Ok((report, set)),
            None => Err(HostError::new(
                ErrorCode::DataRefused,
                report.reason.unwrap_or_default(),
                "choose another seed",
            )),
        }
    }
}

impl Outcome {
    /// |f| − g over the tilts before and after the calibration, m/s² rms.
    pub fn tilts_rms_mps2(&self) -> [f64; 2] {
        [0, 1].map(|which| {
            let squares: f64 = self.tilts.iter().map(|tilt| tilt[which].powi(2)).sum();
            (squares / self.tilts.len() as f64).sqrt()
        })
    }
}

/// A motion that the board has made. Times are since its first start, s.
#[derive(Clone, Copy)]
struct Played {
    /// The board's start in which it did, from 0, and when that was.
    start: usize,
    started_s: f64,
    begin_s: f64,
    end_s: f64,
}

impl Played {
    /// What the cable brought of the start.
    fn boot(self, recording: &Recording) -> Result<&Boot> {
        let boots = &recording.link(Some(LinkRole::Cable))?.boots;
        boots.get(self.start).ok_or_else(|| lacks("a start"))
    }

    /// When a sample or a point was taken, s since the motion began.
    fn since_begin_s(self, time: DeviceTimeUs) -> f64 {
        time.to_seconds() + self.started_s - self.begin_s
    }

    /// The device's path in it.
    fn path(self, recording: &Recording) -> Result<Vec<Point>> {
        let duration_s = self.end_s - self.begin_s;
        let mut path = navigation::device(self.boot(recording)?);
        path.retain(|point| (0.0..duration_s).contains(&self.since_begin_s(point.time)));
        Ok(path)
    }

    /// |f| − g over each hold: raw at nominal sensitivity, and as the device corrected it, m/s².
    fn tilts(
        self,
        recording: &Recording,
        holds: &[Hold],
        set: &ParameterSet,
    ) -> Result<Vec<[f64; 2]>> {
        let boot = self.boot(recording)?;
        let gravity = World::default().gravity_mps2;
        let mean = |samples: &[TimedSample], hold: &Hold, mps2_per_lsb: f64| {
            let held = hold.start_s + MARGIN_S..hold.end_s - MARGIN_S;
            let mut sum = [0.0; 3];
            let mut count = 0.0;
            for sample in samples {
                if !held.contains(&self.since_begin_s(sample.time)) {
                    continue;
                }
                for (sum, value) in sum.iter_mut().zip(sample.value) {
                    *sum += f64::from(value);
                }
                count += 1.0;
            }
            SpecificForceMps2(sum.map(|sum| sum / count * mps2_per_lsb)).norm() - gravity
        };
        Ok(holds
            .iter()
            .map(|hold| {
                let nominal = set.sensitivity.mps2_per_lsb();
                let fixed = 1.0 / SpecificForceQ16::LSB_PER_MPS2;
                [
                    mean(&boot.raw, hold, nominal),
                    mean(&boot.corrected, hold, fixed),
                ]
            })
            .collect())
    }
}

fn lacks(what: &str) -> HostError {
    HostError::new(
        ErrorCode::NoRows,
        format!("the recording of the simulated board lacks {what}"),
        "report this as a fault of wimu",
    )
}

/// A host on both links of a board in virtual time, that records everything.
pub struct Host<'a, R> {
    /// Its client on the cable.
    pub cable: Client<End<'a, R>>,
    /// Its client on the wireless link.
    pub wireless: Client<End<'a, R>>,
    ends: Rc<RefCell<Ends<'a, R>>>,
    board: &'a RefCell<R>,
    scene: Scene,
    key: Option<DeviceKey>,
    /// The board's restarts so far.
    start: usize,
    heard: Vec<Recorded>,
}

impl<'a, R: VirtualBoard> Host<'a, R> {
    /// Connects to `board`, whose sensor is in `scene`.
    ///
    /// # Errors
    /// Those of [`Client::connect`].
    pub fn connect(board: &'a RefCell<R>, scene: Scene) -> Result<Self> {
        let ends = Rc::new(RefCell::new(Ends::of(board)));
        Ok(Self {
            board,
            scene,
            cable: client(&ends, LinkRole::Cable)?,
            wireless: client(&ends, LinkRole::Wireless)?,
            ends,
            key: None,
            start: 0,
            heard: Vec::new(),
        })
    }

    /// Gives the board a key over the cable; both clients sign with it.
    ///
    /// # Errors
    /// Those of [`Client::set_key`].
    pub fn set_key(&mut self, key: DeviceKey) -> Result<()> {
        self.cable.set_key(key)?;
        self.wireless.use_key(Some(key));
        self.key = Some(key);
        Ok(())
    }

    /// Restarts the board, once all that it has sent is read, and connects anew.
    ///
    /// # Errors
    /// Those of [`Client::connect`]; when the board does not start.
    pub fn restart(&mut self) -> Result<()> {
        while self.cable.next_event(Duration::ZERO)?.is_some() {}
        while self.wireless.next_event(Duration::ZERO)?.is_some() {}
        self.keep();
        self.board.borrow_mut().restart()?;
        self.start += 1;
        *self.ends.borrow_mut() = Ends::of(self.board);
        self.cable = client(&self.ends, LinkRole::Cable)?;
        self.wireless = client(&self.ends, LinkRole::Wireless)?;
        self.cable.use_key(self.key);
        self.wireless.use_key(self.key);
        Ok(())
    }

    /// Time since the board's first start, s.
    pub fn now_s(&self) -> f64 {
        self.board.borrow().now_us() as f64 * 1e-6
    }

    /// Lets time pass and listens on both links.
    ///
    /// # Errors
    /// When a link fails.
    pub fn run_until(&mut self, end_s: f64) -> Result<()> {
        while self.now_s() < end_s {
            self.cable.next_event(Duration::from_millis(20))?;
            while self.wireless.next_event(Duration::ZERO)?.is_some() {}
            self.keep();
        }
        Ok(())
    }

    /// Keeps what both links have brought, for the recording.
    fn keep(&mut self) {
        for (role, link) in ROLES.into_iter().zip(&mut self.ends.borrow_mut().links) {
            let tapped = link.take().into_iter();
            self.heard.extend(tapped.map(|entry| entry.of(role)));
        }
    }

    /// Everything received so far as a recording's bytes.
    ///
    /// # Errors
    /// Those of writing a recording.
    pub fn file(&mut self) -> Result<Vec<u8>> {
        self.keep();
        self.heard.sort_by_key(Recorded::host_ns);
        let anchor = ClockAnchor {
            monotonic_ns: 0,
            utc_ns: 0,
        };
        let sink = Cursor::new(Vec::new());
        let mut writer = RecordingWriter::new(sink, "the recording", anchor)?;
        for entry in &self.heard {
            writer.record(entry)?;
        }
        Ok(writer.finish()?.into_inner())
    }

    /// Everything received so far, sorted.
    ///
    /// # Errors
    /// Those of reading a recording.
    pub fn recording(&mut self) -> Result<Recording> {
        let file = self.file()?;
        let name = "the recording";
        Recording::read(RecordingReader::new(Cursor::new(file), name)?, name)
    }

    fn set_zupt(&mut self, zupt: bool) -> Result<()> {
        let settings = self.cable.settings()?;
        self.cable.set_settings(Settings { zupt, ..settings })?;
        Ok(())
    }

    /// Has the board make a motion.
    fn play(&mut self, motion: Rc<dyn Motion>) -> Result<Played> {
        let duration_s = motion.duration();
        let begin_s = self.scene.play(self.now_s(), motion);
        let end_s = begin_s + duration_s;
        self.run_until(end_s)?;
        Ok(Played {
            start: self.start,
            started_s: self.board.borrow().started_us() as f64 * 1e-6,
            begin_s,
            end_s,
        })
    }

    /// Slides by a metre along body x between two rests.
    fn slide(&mut self, zupt: bool) -> Result<Played> {
        // Level first: a change of settings begins navigation anew, with body x as east.
        self.play(Rc::new(Rest::level(0.5)))?;
        self.set_zupt(zupt)?;
        self.play(Rc::new(Slide {
            rest_before_s: REST_S,
            move_s: MOVE_S,
            rest_after_s: REST_S,
            ..Slide::default()
        }))
    }

    /// How far the move of a slide is wrong, from a second before it to its `end_s`, m.
    fn slide_error_m(&self, path: &[Point], slide: Played, end_s: f64) -> Result<f64> {
        let at = |time_s: f64| {
            let reached = |point: &&Point| slide.since_begin_s(point.time) >= time_s;
            let point = path.iter().find(reached).or(path.last());
            point
                .map(|point| point.navigation.position.to_m())
                .ok_or_else(|| lacks("a position"))
        };
        let truth = |time_s| self.scene.state(slide.begin_s + time_s).position_m;
        let moved = |from: [f64; 3], to: [f64; 3]| [0, 1, 2].map(|axis| to[axis] - from[axis]);
        let measured = moved(at(REST_S - 1.0)?, at(end_s)?);
        let true_move = moved(truth(0.0), truth(MOVED_S));
        Ok(navigation::distance_m(measured, true_move))
    }
}

fn client<'a, R: VirtualBoard>(
    ends: &Rc<RefCell<Ends<'a, R>>>,
    role: LinkRole,
) -> Result<Client<End<'a, R>>> {
    let options = ConnectOptions {
        // Not at random: the same bytes in every run.
        session: Some(1),
        ..ConnectOptions::default()
    };
    let end = End {
        ends: Rc::clone(ends),
        link: usize::from(role != LinkRole::Cable),
    };
    Client::connect(end, &format!("the simulated {role} link"), options)
}

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// The host's ends of both links. Who waits for one listens to both, so that each byte is recorded
/// when it arrives.
struct Ends<'a, R> {
    links: [Tap<SimLink<'a, R>>; 2],
    /// Arrived, not yet read.
    arrived: [VecDeque<u8>; 2],
}

impl<'a, R: VirtualBoard> Ends<'a, R> {
    fn of(board: &'a RefCell<R>) -> Self {
        Self {
            links: ROLES.map(|role| Tap::on(SimLink::new(board, role))),
            arrived: Default::default(),
        }
    }

    /// Takes what both links bring, until there is some for `link`, for `timeout` at most.
    fn listen(&mut self, link: usize, timeout: Duration) -> Result<()> {
        let deadline = self.links[link].now() + timeout;
        loop {
            let left = deadline.saturating_sub(self.links[link].now());
            let waits = self.arrived[link].is_empty();
            for (index, end) in self.links.iter_mut().enumerate() {
                let wait = if index == link && waits {
                    left.min(TICK)
                } else {
                    Duration::ZERO
                };
                let mut buffer = [0; 4096];
                match end.read(&mut buffer, wait) {
                    Ok(count) => self.arrived[index].extend(&buffer[..count]),
                    // The other's fault is told to who reads it.
                    Err(error) if index == link && waits => return Err(error),
                    Err(_) => {}
                }
            }
            if left.is_zero() || !self.arrived[link].is_empty() {
                return Ok(());
            }
        }
    }
}

/// How long the host looks at one link before it looks at the other.
const TICK: Duration = Duration::from_millis(1);

/// The host's end of one link, see [`Host`].
pub struct End<'a, R> {
    ends: Rc<RefCell<Ends<'a, R>>>,
    link: usize,
}

impl<R: VirtualBoard> Transport for End<'_, R> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let mut ends = self.ends.borrow_mut();
        ends.listen(self.link, timeout)?;
        let arrived = &mut ends.arrived[self.link];
        let count = arrived.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(arrived.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.ends.borrow_mut().links[self.link].write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.ends.borrow().links[self.link].now()
    }

    fn baud(&self) -> Option<u32> {
        self.ends.borrow().links[self.link].baud()
    }

    fn set_baud(&mut self, baud: u32) -> Result<()> {
        let mut ends = self.ends.borrow_mut();
        ends.arrived[self.link].clear();
        ends.links[self.link].set_baud(baud)
    }
}
