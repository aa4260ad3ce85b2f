//! The complete workflow on a simulated board in virtual time, for `wimu demo` and the end-to-end test.

mod gyroscope;
mod host;

use std::cell::RefCell;
use std::rc::Rc;

use wimu_host::calibration::{CalibrateOptions, CalibrationReport, calibrate};
use wimu_host::capture::{Boot, Capture};
use wimu_host::decode::TimedSample;
use wimu_host::navigation::{self, Point};
use wimu_host::recording::{self, Selection};
use wimu_host::replay::{self, ReplayReport};
use wimu_host::{Code, Problem, Result};
use wimu_link::auth::DeviceKey;
use wimu_link::hello::Capabilities;
use wimu_link::message::Settings;
use wimu_link::{Hello, LinkRole};
use wimu_model::{
    CalibrationMethod, DeviceTimeUs, ParameterId, ParameterSet, SpecificForceMps2, SpecificForceQ16,
};

use crate::attitude::Attitude;
use crate::board::{Board, BoardConfig, SensorPart, VirtualBoard};
use crate::motion::{Hold, Motion, Poses, Rest, Slide};
use crate::scene::{Scene, World};
use crate::source::Physics;
use crate::truth::{Gauge, SensorTruth};
pub use host::{End, Host};

/// Duration of a pose, s.
const HOLD_S: f64 = 4.0;
/// Rests of a slide, s: in them the sensor's true period is measured.
const REST_S: f64 = 6.0;
/// Duration and end of its move, s.
const MOVE_S: f64 = 3.0;
const MOVED_S: f64 = REST_S + MOVE_S;
/// Placement error by hand, degrees, 1 σ.
const PLACEMENT_DEG: f64 = 2.0;
/// Left out at both ends of a pose, s: the end of the rotation, and a batch.
const MARGIN_S: f64 = 0.3;

/// Method of the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calibration {
    /// Six exact positions, 12 parameters; the hidden misalignment is arbitrary.
    SixPositions,
    /// Twelve poses placed by hand, 2° off, 9 parameters; the hidden misalignment is
    /// lower-triangular, which gravity alone can observe.
    TwelvePoses,
}

/// A run of the workflow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstLight {
    /// Seed of the hidden errors and noise.
    pub seed: u64,
    /// Sensor on the board. With a gyroscope the board also rotates, and the gyroscope is calibrated.
    pub sensor: SensorPart,
    /// Method of the calibration.
    pub calibration: Calibration,
}

/// Errors of the displacement of a 1.000 m slide in 3 s between two rests, 3-D, m. With a gyroscope the board
/// rotates by 90° meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlideErrors {
    /// Uncalibrated, without ZUPT: position at the end of the move.
    pub uncalibrated_m: f64,
    /// Calibrated, without ZUPT: the same.
    pub calibrated_m: f64,
    /// Calibrated, with ZUPT at both ends.
    pub zupt_m: f64,
}

/// The results, as sent by the device.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Identification on the cable.
    pub hello: Hello,
    /// The hidden errors of the sensor.
    pub truth: SensorTruth,
    /// Raw samples recorded on both links before the calibration.
    pub samples: usize,
    /// The calibration.
    pub report: CalibrationReport,
    /// Errors of a push over the wireless link: before the device had a key, without the key
    /// when it had one, and with a wrong one.
    pub refusals: Vec<Option<Problem>>,
    /// Parameters of the device after the push over the wireless link with its key.
    pub pushed: ParameterId,
    /// Duration of that push, with session and read-back, s.
    pub push_s: f64,
    /// Parameters of the device after a restart.
    pub after_restart: ParameterId,
    /// Boot counts before and after the restart.
    pub boot_counts: [u32; 2],
    /// |f| − g on each of ten tilts that were not used in the fit, m/s²: raw at nominal sensitivity, and
    /// corrected.
    pub tilts: Vec<[f64; 2]>,
    /// Position errors.
    pub slide: SlideErrors,
    /// Attitude errors at the same times, degrees: uncalibrated, calibrated, with ZUPT. `None` without a
    /// gyroscope.
    pub attitude_deg: Option<[f64; 3]>,
    /// The parameters found and pushed.
    pub parameters: ParameterSet,
    /// The uncalibrated slide without ZUPT, from the start of its first rest.
    pub uncalibrated_path: Vec<Point>,
    /// The calibrated one without ZUPT.
    pub calibrated_path: Vec<Point>,
    /// The calibrated one with ZUPT.
    pub zupt_path: Vec<Point>,
    /// Replays of the recording, for each link and start of the device.
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
    /// Those of the host.
    pub fn run(&self) -> Result<Outcome> {
        let config = BoardConfig { sensor: self.sensor, ..BoardConfig::default() };
        self.run_on(|source| Ok(Board::start(config, source)))
    }

    /// Runs it on the board made by `start`, with a sensor whose samples come from
    /// the source.
    ///
    /// # Errors
    /// Those of the host, and of `start`.
    pub fn run_on<R: VirtualBoard>(
        &self,
        start: impl FnOnce(Physics) -> Result<R>,
    ) -> Result<Outcome> {
        let gauge = match self.calibration {
            Calibration::SixPositions => Gauge::Full,
            Calibration::TwelvePoses => Gauge::LowerTriangular,
        };
        let truth = self.sensor.random_truth(self.seed, gauge);
        let scene = Scene::new(World::default());
        let source = Physics::new(truth, scene.clone(), self.seed);
        let board = RefCell::new(start(source)?);
        let mut host = Host::connect(&board, scene)?;
        let hello = *host.cable.hello();

        let has_gyroscope = hello.capabilities.contains(Capabilities::GYROSCOPE);
        let slide = if has_gyroscope { Slide::carry() } else { Slide::default() };
        let uncalibrated = host.slide(slide, false)?;
        host.set_zupt(true)?;
        host.play(Rc::new(match self.calibration {
            Calibration::SixPositions => Poses::six_positions(HOLD_S),
            Calibration::TwelvePoses => Poses::twelve_by_hand(self.seed, PLACEMENT_DEG, HOLD_S),
        }))?;
        let rotations = has_gyroscope.then(|| host.rotate()).transpose()?;
        let recording = host.recording()?;
        let samples = boots(&recording).map(|boot| boot.raw().len()).sum();
        let (report, mut set) = self.calibrate(&recording)?;
        if let Some(rotations) = rotations {
            set.gyroscope = Some(gyroscope::calibrate(rotations, &recording)?);
        }

        let mut refusals = vec![host.wireless.push_parameters(&set).err()];
        // A simulation has no secrets: the key is the same in every run.
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
        let calibrated = host.slide(slide, false)?;
        let with_zupt = host.slide(slide, true)?;

        let recording = host.recording()?;
        let uncalibrated_path = uncalibrated.path(&recording)?;
        let calibrated_path = calibrated.path(&recording)?;
        let zupt_path = with_zupt.path(&recording)?;
        let replays = boots(&recording).map(|boot| replay::verify(boot, 0));
        // Without ZUPT position is only good while it is fresh; with it, at the rest afterwards.
        let paths = [
            (&uncalibrated_path, uncalibrated, MOVED_S),
            (&calibrated_path, calibrated, MOVED_S),
            (&zupt_path, with_zupt, f64::INFINITY),
        ];
        let mut errors_m = [0.0; 3];
        let mut errors_deg = [None; 3];
        for (index, (path, played, end_s)) in paths.into_iter().enumerate() {
            errors_m[index] = host.slide_error_m(path, played, end_s)?;
            errors_deg[index] = host.attitude_error_deg(path, played, end_s)?;
        }
        let [uncalibrated_m, calibrated_m, zupt_m] = errors_m;
        let attitude_deg = match errors_deg {
            [Some(a), Some(b), Some(c)] => Some([a, b, c]),
            _ => None,
        };
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
            slide: SlideErrors { uncalibrated_m, calibrated_m, zupt_m },
            attitude_deg,
            parameters: set,
            uncalibrated_path,
            calibrated_path,
            zupt_path,
            replays: replays.collect(),
            duration_s: host.now_s(),
            recording: host.file()?,
        })
    }

    /// Calibrates from the data of the cable.
    fn calibrate(&self, recording: &Capture) -> Result<(CalibrationReport, ParameterSet)> {
        let options = CalibrateOptions {
            method: match self.calibration {
                Calibration::SixPositions => CalibrationMethod::SixPosition,
                Calibration::TwelvePoses => CalibrationMethod::MultiPosition,
            },
            placement_sd_deg: Some(0.0),
            gravity_mps2: Some(World::default().gravity_mps2),
            ..CalibrateOptions::default()
        };
        let cable = recording.link(Some(LinkRole::Cable))?;
        let data = recording::Recording::of_link(cable, "the simulated board")?;
        let report = calibrate(&data.samples(Selection::default())?, &options)?;
        match report.parameters {
            Some(set) => Ok((report, set)),
            None => Err(Code::DataRefused
                .error(report.outcome.reason.unwrap_or_default(), "choose another seed")),
        }
    }
}

/// All starts of the board, on both links.
fn boots(recording: &Capture) -> impl Iterator<Item = &Boot> {
    recording.links.values().flat_map(|link| &link.boots)
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

/// A motion made by the board. Times are since its first start, s.
#[derive(Clone, Copy)]
struct Played {
    /// Index of the board's start from 0, and its time.
    start: usize,
    started_s: f64,
    begin_s: f64,
    end_s: f64,
}

impl Played {
    /// The data of that start on the cable.
    fn boot(self, recording: &Capture) -> Result<&Boot> {
        let boots = &recording.link(Some(LinkRole::Cable))?.boots;
        boots.get(self.start).ok_or_else(|| lacks("a start"))
    }

    /// Time of a sample or a point, s since the motion began.
    fn since_begin_s(self, time: DeviceTimeUs) -> f64 {
        time.to_seconds() + self.started_s - self.begin_s
    }

    /// The first point of a path at least `time_s` after the motion began, or its last one.
    fn point(self, path: &[Point], time_s: f64) -> Result<&Point> {
        let reached = |point: &&Point| self.since_begin_s(point.time) >= time_s;
        let point = path.iter().find(reached).or(path.last());
        point.ok_or_else(|| lacks("a position"))
    }

    /// The path computed by the device.
    fn path(self, recording: &Capture) -> Result<Vec<Point>> {
        let duration_s = self.end_s - self.begin_s;
        let mut path = navigation::device(self.boot(recording)?);
        path.retain(|point| (0.0..duration_s).contains(&self.since_begin_s(point.time)));
        Ok(path)
    }

    /// |f| − g over each hold: raw at nominal sensitivity, and as the device corrected it, m/s².
    fn tilts(
        self,
        recording: &Capture,
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
                [mean(boot.raw(), hold, nominal), mean(boot.corrected(), hold, fixed)]
            })
            .collect())
    }
}

fn lacks(what: &str) -> Problem {
    Code::NoRows.error(
        format!("the recording of the simulated board lacks {what}"),
        "report this as a fault of wimu",
    )
}

impl<R: VirtualBoard> Host<'_, R> {
    fn set_zupt(&mut self, zupt: bool) -> Result<()> {
        let settings = self.cable.settings()?;
        self.cable.set_settings(Settings { zupt, ..settings })?;
        Ok(())
    }

    /// Makes the board perform a motion.
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

    /// Moves as `slide` does, between two rests.
    fn slide(&mut self, slide: Slide, zupt: bool) -> Result<Played> {
        // Level first: a change of settings restarts navigation, with body x as east.
        self.play(Rc::new(Rest::level(0.5)))?;
        self.set_zupt(zupt)?;
        self.play(Rc::new(Slide {
            rest_before_s: REST_S,
            move_s: MOVE_S,
            rest_after_s: REST_S,
            ..slide
        }))
    }

    /// Error of the displacement of a slide, from a second before its move to `end_s`, m.
    fn slide_error_m(&self, path: &[Point], slide: Played, end_s: f64) -> Result<f64> {
        let at = |time_s: f64| {
            let point = slide.point(path, time_s)?;
            Ok::<_, Problem>(point.navigation.position.to_m())
        };
        let truth = |time_s| self.scene.state(slide.begin_s + time_s).position_m;
        let moved = |from: [f64; 3], to: [f64; 3]| [0, 1, 2].map(|axis| to[axis] - from[axis]);
        let measured = moved(at(REST_S - 1.0)?, at(end_s)?);
        let true_move = moved(truth(0.0), truth(MOVED_S));
        Ok(navigation::distance_m(measured, true_move))
    }

    /// Error of the attitude at `end_s`, degrees; `None` without one.
    fn attitude_error_deg(&self, path: &[Point], slide: Played, end_s: f64) -> Result<Option<f64>> {
        let point = slide.point(path, end_s)?;
        let truth = self.scene.state(point.time.to_seconds() + slide.started_s);
        Ok(point.navigation.attitude.map(|quaternion| {
            let quaternion = quaternion.map(|q| f64::from(q) / (1_u64 << 30) as f64);
            let found = Attitude::from_quaternion(quaternion);
            found.angle_to(truth.attitude).to_degrees()
        }))
    }
}
