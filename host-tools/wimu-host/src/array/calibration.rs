//! Calibration of an array from the rests in its own recording, or as it is stored.

use nalgebra::Vector3;
use wimu_calib::{ArrayEstimate, ArrayPrior, ArraySensorEstimate, Gravity, Pose};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};

use super::agreement::contradiction;
use super::directions;
use super::motion::{check, refused};
use super::outputs::{
    AtRests, Span, common, departures, is_dead, is_throughout, pose, rms, scale_of,
    steady_stretches,
};
use super::rests::{EvenTurn, REST_BIAS_MPS2, judged};
use super::{Array, ArrayGeometry};
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Noise that is assumed where there is no rest to see it, m/s².
const ASSUMED_NOISE_MPS2: f64 = 0.05;

/// Bias of a calibrated axis in motion, m/s²: MIMU4444 rests of one run repeat within 0.015 m/s².
pub(super) const BIAS_MPS2: f64 = 0.02;
/// Least error of the scale factors and misalignments of an uncalibrated axis.
pub(super) const LEAST_SCALE: f64 = 0.002;
/// Largest error of scale factors and misalignments: beyond it the axes or the model are not those of the sensor.
const MOST_SCALE: f64 = 0.05;
/// Largest standard deviation of the matrices of a calibrated array: 0.01 m/s² at 1 g.
const CALIBRATED_SCALE: f64 = 0.001;
/// Repeatability of a bias over the rms deviation of the sensors from their mean: eight rests or more leave half of the
/// degrees of freedom.
const REPEATABILITY_TIMES: f64 = 1.5;
/// Least repeatability of a bias, m/s².
const LEAST_REPEATABILITY_MPS2: f64 = 5e-4;
/// Least deviation of a faulty sensor from the others at the rests, m/s² rms.
const FAULTY_MPS2: f64 = 0.1;
/// Least ratio of that deviation to the median of the sensors.
const FAULTY_TIMES: f64 = 5.0;
/// Deviation at the rests beyond which a stored model may be that of another sensor, m/s².
const DOUBTFUL_MPS2: f64 = 0.5;

/// Fit of one sensor to the rests.
#[derive(Clone, Copy, Debug)]
pub struct SensorFit {
    /// Rests in which it has output.
    pub rests: usize,
    /// |f| − g of its corrected output, m/s² rms.
    pub rms_mps2: f64,
    /// Standard deviation of its bias, m/s², body axes.
    pub bias_sd_mps2: [f64; 3],
    /// Standard deviation of its matrix, body axes.
    pub matrix_sd: [[f64; 3]; 3],
}

/// An array's calibration from the rests in its own recording.
#[derive(Clone, Debug)]
pub struct ArrayCalibration {
    /// Error model of each sensor, body axes, with its rotation against the others.
    pub sensors: Vec<ErrorModel>,
    /// Noise of each sensor at rest, m/s² an axis.
    pub noise_mps2: Vec<f64>,
    /// The rests, as first sample and number of samples.
    pub rests: Vec<Span>,
    /// What looks like rests in the mean of the sensors while they turn evenly, which shows among them.
    pub turns: Vec<EvenTurn>,
    /// An even turn about the vertical that is slower, rad/s, looks like a rest to this array: that there
    /// was none is assumed. `None` where the places show no angular rate.
    pub unseen_rad_s: Option<f64>,
    /// What the sensors disagree by at the rests after all, m/s² rms an axis.
    pub disagreement_mps2: f64,
    /// Standard deviation of the bias that is left of each axis, m/s².
    pub bias_mps2: f64,
    /// The same of its sensitivity, as a share, and direction, rad.
    pub scale: f64,
    /// The same of the mean of all sensors.
    pub common_scale: f64,
    /// How well each coordinate of a place is known, m: [`PLACE_SD_M`](Self::PLACE_SD_M) unless the geometry says it.
    pub place_sd_m: f64,
    /// How well the sensors' times among each other are known, s: [`DELAY_SD_S`](Self::DELAY_SD_S) unless the
    /// geometry says it.
    pub delay_sd_s: f64,
    /// Why the error models are those of perfect sensors, where they are.
    pub uncalibrated: Option<String>,
    /// Whether the geometry had an error model of each sensor, so that none was fitted.
    pub stored: bool,
    /// Fit of each sensor; `None` where the rests do not calibrate it.
    pub fits: Vec<Option<SensorFit>>,
    /// Sensors that are of no use, and why.
    pub left_out: Vec<(usize, String)>,
    /// The sensor that departs most from the mean of all at the rests, m/s² rms, before their departures were taken into the
    /// models.
    farthest: (usize, f64),
    /// Prior deviations of biases, m/s², and of the entries of the matrices, and gravity.
    prior: ArrayPrior,
    /// What each sensor still adds at each rest, m/s².
    offsets: Vec<Vec<Vector3<f64>>>,
}

impl ArrayCalibration {
    /// How well a place is known where it is not given, m.
    pub const PLACE_SD_M: f64 = 5e-4;
    /// How well the sensors' times among each other are known where it is not given, s.
    pub const DELAY_SD_S: f64 = 3e-4;

    /// From the accelerometers alone, in body axes. A rest is an interval in which the mean of all sensors is steady and
    /// they agree with each other as at every other rest. Biases and matrices of all sensors are fitted to one
    /// gravity vector per rest ([`wimu_calib::calibrate_array`]). A sensor that is dead, or that contradicts the others, is left
    /// out; one that fails on the way counts as long as it lives. Where the geometry has error models,
    /// [`Array::arranged`] has applied them, and the fit finds what they leave.
    ///
    /// # Errors
    /// `data_refused` when there is no rest at all, or no sensor is alive; `usage` when the geometry has
    /// another number of sensors.
    pub fn of(recording: &Array, geometry: &ArrayGeometry, gravity: Gravity) -> Result<Self> {
        check(recording, geometry)?;
        let sensors = recording.sensors();
        let dead: Vec<usize> = (0..sensors).filter(|s| is_dead(recording, *s)).collect();
        if dead.len() == sensors {
            let remedy = "check the sensors and the sensitivity";
            return Err(Code::DataRefused
                .error("no sensor's output moves", remedy)
                .at(&recording.name));
        }
        let stretches = steady_stretches(recording, &dead);
        let mut left_out: Vec<(usize, String)> =
            dead.iter().map(|sensor| (*sensor, "its output never moves".to_owned())).collect();
        left_out.extend(misdirected(recording, &stretches, &dead)?);
        let is_out = |sensor: usize| left_out.iter().any(|(out, _)| *out == sensor);
        // Judged by the sensors that live through all of them.
        let lives = |sensor: usize| {
            !is_out(sensor) && stretches.iter().all(|span| is_throughout(recording, sensor, *span))
        };
        let lives: Vec<bool> = (0..sensors).map(lives).collect();
        let judged = judged(recording, geometry, &stretches, &lives)?;
        if judged.rests.is_empty() {
            return Err(without_rest(!judged.turns.is_empty()).at(&recording.name));
        }
        let at_rest = |span: &Span| (0..sensors).map(|s| pose(recording, s, *span)).collect();
        let mut seen: Vec<Vec<Option<Pose>>> = judged.rests.iter().map(at_rest).collect();
        let mean = |pose: &Option<Pose>| pose.map(|pose| pose.mean_mps2.into());
        let outputs: AtRests = seen.iter().map(|rest| rest.iter().map(mean).collect()).collect();
        let absent = |s: &usize| !is_out(*s) && outputs.iter().all(|rest| rest[*s].is_none());
        let reason = "it has no output at any rest";
        let absent: Vec<usize> = (0..sensors).filter(absent).collect();
        left_out.extend(absent.into_iter().map(|sensor| (sensor, reason.to_owned())));
        let noise_mps2: Vec<f64> = (0..sensors)
            .map(|sensor| {
                let deviations = seen.iter().filter_map(|rest| Some(rest[sensor]?.sd_mps2[0]));
                let variances: Vec<f64> = deviations.map(|sd| sd * sd).collect();
                let noise = (variances.iter().sum::<f64>() / variances.len().max(1) as f64).sqrt();
                if noise > 0.0 { noise } else { ASSUMED_NOISE_MPS2 }
            })
            .collect();
        for (sensor, pose) in seen.iter_mut().flat_map(|rest| rest.iter_mut().enumerate()) {
            if let Some(pose) = pose {
                pose.sd_mps2 = [noise_mps2[sensor]; 3];
            }
        }
        let is_out = |sensor: usize| left_out.iter().any(|(out, _)| *out == sensor);
        let stored = !geometry.sensors.is_empty()
            && (0..sensors).all(|s| geometry.sensors[s].model.is_some() || is_out(s));
        let mut calibration = Self {
            sensors: vec![ErrorModel::default(); sensors],
            noise_mps2,
            rests: judged.rests,
            turns: judged.turns,
            unseen_rad_s: judged.unseen_rad_s,
            disagreement_mps2: 0.0,
            bias_mps2: BIAS_MPS2,
            scale: 0.0,
            common_scale: 0.0,
            place_sd_m: geometry.place_sd_mm.map_or(Self::PLACE_SD_M, |mm| mm * 1e-3),
            delay_sd_s: geometry.delay_sd_us.map_or(Self::DELAY_SD_S, |us| us * 1e-6),
            uncalibrated: None,
            stored,
            fits: vec![None; sensors],
            left_out,
            farthest: (0, 0.0),
            prior: ArrayPrior {
                gravity_mps2: gravity.mps2(),
                gravity_sd_mps2: gravity.sd_mps2(),
                repeatability_mps2: REST_BIAS_MPS2,
                ..ArrayPrior::default()
            },
            offsets: Vec::new(),
        };
        calibration.assume(&outputs);
        calibration.fit(&seen, &outputs)?;
        calibration.take_off_offsets(&outputs);
        Ok(calibration)
    }

    /// Sensors that are used.
    fn used(&self) -> Vec<usize> {
        (0..self.sensors.len()).filter(|sensor| self.uses(*sensor)).collect()
    }

    /// The sensors that are used with their departures, m/s² rms, the least first.
    fn by_departure(&self, departures: &AtRests) -> Vec<(usize, f64)> {
        let used = self.used().into_iter();
        let mut all: Vec<_> = used.map(|sensor| (sensor, rms(departures, &[sensor]))).collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all
    }

    /// Prior deviations by the method of moments, equation (104), from the mean outputs at the rests.
    fn assume(&mut self, outputs: &AtRests) {
        let used = self.used();
        let departures = departures(outputs, &used);
        let count = used.len() as f64;
        let apart = rms(&departures, &used) * (count / (3.0 * f64::max(count - 1.0, 1.0))).sqrt();
        self.bias_mps2 = apart.max(BIAS_MPS2);
        // In one orientation bias and scale factor cannot be told apart.
        self.scale = scale_of(&departures, outputs, &used)
            .unwrap_or(apart / STANDARD_GRAVITY_MPS2)
            .max(LEAST_SCALE);
        self.farthest = self.by_departure(&departures).last().copied().unwrap_or_default();
        self.prior.bias_mps2 = self.bias_mps2.min(MOST_SCALE * STANDARD_GRAVITY_MPS2);
        self.prior.matrix = self.scale.min(MOST_SCALE);
    }

    /// Fits biases and matrices to the rests; what they leave uncertain stays in `scale`.
    fn fit(&mut self, seen: &[Vec<Option<Pose>>], outputs: &AtRests) -> Result<()> {
        let mut prior = self.prior;
        let fitted = |of: &mut Self, prior: &ArrayPrior| -> Result<ArrayEstimate> {
            let mut rests = seen.to_vec();
            for (sensor, pose) in rests.iter_mut().flat_map(|rest| rest.iter_mut().enumerate()) {
                *pose = pose.filter(|_| of.uses(sensor));
            }
            let found = wimu_calib::calibrate_array(&rests, prior).map_err(refused)?;
            for (model, found) in of.sensors.iter_mut().zip(&found.sensors) {
                *model = found.model.unwrap_or_default();
            }
            Ok(found)
        };
        let mut found = fitted(self, &prior)?;
        while let Some((sensor, apart)) = self.faulty(outputs) {
            let why = format!(
                "no bias and matrix explain its output at the rests: {apart:.2} m/s² rms are left"
            );
            self.left_out.push((sensor, why));
            found = fitted(self, &prior)?;
        }
        if found.matrix_sd < CALIBRATED_SCALE && !self.stored {
            // With as many rests their residuals show how well a bias repeats.
            let departures = departures(&self.corrected(outputs), &self.used());
            let shown = REPEATABILITY_TIMES * rms(&departures, &self.used()) / 3.0_f64.sqrt();
            prior.repeatability_mps2 = shown.clamp(LEAST_REPEATABILITY_MPS2, REST_BIAS_MPS2);
            found = fitted(self, &prior)?;
            for sensor in self.used() {
                self.fits[sensor] = Some(self.fit_of(sensor, outputs, &found));
            }
            (self.bias_mps2, self.scale) = (BIAS_MPS2, 0.0);
            return Ok(());
        }
        let reason = "the rests do not determine its scale factors and misalignments";
        self.uncalibrated = (!self.stored).then(|| reason.to_owned());
        if self.scale < MOST_SCALE {
            // An error that all sensors have is one of the scale in which gravity is measured.
            self.prior.gravity_mps2 = self.mean_length(outputs);
            self.prior.gravity_sd_mps2 = MOST_SCALE * STANDARD_GRAVITY_MPS2;
            found = fitted(self, &self.prior.clone())?;
            let learnt = (self.scale.powi(2) - found.matrix_sd.powi(2)).max(0.0);
            self.common_scale = (learnt / self.used().len().max(1) as f64).sqrt();
            self.scale = found.matrix_sd;
        } else {
            // Beyond what a sensor's error can be, axes or model are wrong, and nothing is corrected.
            self.sensors.fill(ErrorModel::default());
        }
        Ok(())
    }

    /// The sensor that departs most from the others after the fit, where that is no error of its model.
    fn faulty(&self, outputs: &AtRests) -> Option<(usize, f64)> {
        let apart = self.by_departure(&departures(&self.corrected(outputs), &self.used()));
        let (worst, median) = (*apart.last()?, apart.get(apart.len() / 2)?.1);
        let alone = apart.len() > 3 && 2 * self.left_out.len() < self.sensors.len();
        (alone && worst.1 > FAULTY_MPS2 && worst.1 > FAULTY_TIMES * median).then_some(worst)
    }

    /// Specific force of a sensor by its model.
    fn model_force(&self, sensor: usize, output: Vector3<f64>) -> Vector3<f64> {
        self.sensors[sensor].correct(SpecificForceMps2(output.into()), None).0.into()
    }

    fn corrected(&self, outputs: &AtRests) -> AtRests {
        let of_rest = |rest: &Vec<Option<Vector3<f64>>>| {
            let sensors = rest.iter().enumerate();
            sensors.map(|(k, output)| output.map(|output| self.model_force(k, output))).collect()
        };
        outputs.iter().map(of_rest).collect()
    }

    fn fit_of(&self, sensor: usize, outputs: &AtRests, found: &ArrayEstimate) -> SensorFit {
        let outputs = outputs.iter().filter_map(|rest| rest[sensor]);
        let off = outputs.map(|o| self.model_force(sensor, o).norm() - self.prior.gravity_mps2);
        let off: Vec<f64> = off.collect();
        let ArraySensorEstimate { bias_sd_mps2, matrix_sd, .. } = found.sensors[sensor];
        SensorFit {
            rests: off.len(),
            rms_mps2: (off.iter().map(|o| o * o).sum::<f64>() / off.len().max(1) as f64).sqrt(),
            bias_sd_mps2,
            matrix_sd,
        }
    }

    /// By how much each sensor still departs from the mean of all at each rest. A rest at which a sensor has no output takes the
    /// departure of the rest before, or of the first.
    fn take_off_offsets(&mut self, outputs: &AtRests) {
        let used = self.used();
        let departures = departures(&self.corrected(outputs), &used);
        self.disagreement_mps2 = rms(&departures, &used) / 3.0_f64.sqrt();
        self.offsets = vec![vec![Vector3::zeros(); self.sensors.len()]; departures.len()];
        for sensor in 0..self.sensors.len() {
            let mut last = departures.iter().find_map(|rest| rest[sensor]);
            for (rest, offsets) in departures.iter().zip(&mut self.offsets) {
                last = rest[sensor].or(last);
                offsets[sensor] = last.unwrap_or_default();
            }
        }
    }

    /// Mean length of the mean output at the rests, m/s².
    pub fn mean_rest_mps2(&self, recording: &Array) -> f64 {
        let mean =
            |span: &Span, sensor: usize| Some(pose(recording, sensor, *span)?.mean_mps2.into());
        let sensors = recording.sensors();
        let of_rest = |span: &Span| (0..sensors).map(|sensor| mean(span, sensor)).collect();
        self.mean_length(&self.rests.iter().map(of_rest).collect())
    }

    fn mean_length(&self, outputs: &AtRests) -> f64 {
        let used = self.used();
        let lengths = outputs.iter().map(|rest| common(rest, &used).norm());
        lengths.sum::<f64>() / outputs.len() as f64
    }

    /// Refuses sensors that differ at the rests by more than errors of sensors.
    ///
    /// # Errors
    /// `data_refused`, with what to check.
    pub fn check(&self, name: &str) -> Result<()> {
        if self.scale < MOST_SCALE {
            return Ok(());
        }
        let differ = "at rest they differ by more than usual biases and scale factors explain: by";
        Err(contradiction(name, &format!("{differ} {:.2} m/s²", self.bias_mps2)))
    }

    /// What was assumed, found wrong and left out.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(fastest) = self.turns.iter().map(|t| t.rate_rad_s).reduce(f64::max) {
            remarks.push(format!(
                "not rests: {} with a steady mean, in which the sensors show a constant angular rate of up to {fastest:.1} rad/s",
                counted(self.turns.len(), "interval")
            ));
        }
        if let Some(unseen) = self.unseen_rad_s {
            let rests = match self.rests.len() {
                1 => "the one rest".to_owned(),
                many => format!("the {many} rests"),
            };
            remarks.push(format!(
                "a constant rotation about the vertical below {unseen:.1} rad/s cannot be excluded at {rests}"
            ));
        }
        if let Some(why) = &self.uncalibrated {
            remarks.push(format!(
                "the array is not calibrated: {why}. Biases of ± {:.3} m/s² are assumed; offsets at the rests are subtracted, scale \
                 factors and misalignments are uncertain by ± {:.2} %. Calibrate with rests in a dozen orientations: \
                 `wimu calibrate RESTS.csv --setup geometry=PLACES.csv -o ARRAY.json`",
                self.bias_mps2,
                self.scale * 100.0
            ));
        }
        if self.stored {
            remarks.push(format!(
                "the sensors have error models; at the rests they differ by {:.3} m/s². Biases of ± {:.3} m/s² are assumed, \
                 scale factors and misalignments are uncertain by ± {:.2} %",
                self.disagreement_mps2,
                self.bias_mps2,
                self.scale * 100.0
            ));
            let (sensor, apart) = self.farthest;
            if apart > DOUBTFUL_MPS2 {
                remarks.push(format!(
                    "sensor {sensor} (from 0) departs by {apart:.2} m/s² from the others at the rests: is its error model \
                     that of this sensor, and given in its place?"
                ));
            }
        }
        for (sensor, why) in &self.left_out {
            remarks.push(format!("sensor {sensor} (from 0) is left out: {why}"));
        }
        remarks
    }

    /// The rest whose departures are taken off sample `index`: the latest before it, or the first.
    pub(super) fn offset_of(&self, index: usize) -> usize {
        let rest = self.rests.partition_point(|(first, _)| *first <= index);
        rest.saturating_sub(1)
    }

    /// Whether a sample is one of a rest.
    pub(super) fn is_rest(&self, index: usize) -> bool {
        self.rests[..self.rests.partition_point(|(first, _)| *first <= index)]
            .last()
            .is_some_and(|(first, count)| index < first + count)
    }

    /// Whether a sensor is of use.
    pub fn uses(&self, sensor: usize) -> bool {
        self.left_out.iter().all(|(out, _)| *out != sensor)
    }

    /// Specific force of a sensor in body axes, m/s², without what it added at rest `rest`: that part of its bias which the other
    /// sensors show.
    pub(super) fn force_since(
        &self,
        sensor: usize,
        output_mps2: Vector3<f64>,
        rest: usize,
    ) -> [f64; 3] {
        (self.model_force(sensor, output_mps2) - self.offsets[rest][sensor]).into()
    }
}

/// The sensors with an axis of a wrong direction.
///
/// # Errors
/// `data_refused` where they are as many as the others: which are wrong is not known.
fn misdirected(
    recording: &Array,
    stretches: &[Span],
    dead: &[usize],
) -> Result<Vec<(usize, String)>> {
    let alive: Vec<usize> = (0..recording.sensors()).filter(|s| !dead.contains(s)).collect();
    let mean = |span: &Span, sensor| pose(recording, sensor, *span).map(|p| p.mean_mps2.into());
    let of = |span: &Span| (0..recording.sensors()).map(|sensor| mean(span, sensor)).collect();
    let wrong = directions::wrong(&stretches.iter().map(of).collect(), &alive);
    let Some((sensor, how)) = wrong.first().filter(|_| 2 * wrong.len() >= alive.len()) else {
        return Ok(wrong);
    };
    let message = format!("the sensors contradict each other: sensor {sensor} (from 0): {how}");
    let remedy =
        "correct order and signs of the axes, in the driver or by the directions of the geometry";
    Err(Code::DataRefused.error(message, remedy).at(&recording.name))
}

/// Refusal of a recording without a rest.
fn without_rest(turns: bool) -> Problem {
    let (message, remedy) = if turns {
        (
            "wherever its sensors are steady they differ as in a rotation at a constant rate, or contradict each other: without a rest neither biases nor gravity are observable",
            "hold the array still for two seconds, in several orientations; if it was, check places, signs and directions of the sensors",
        )
    } else {
        (
            "the recording has no rest: neither biases nor gravity are observable",
            "hold the array still for two seconds, in several orientations",
        )
    };
    Code::DataRefused.error(message, remedy)
}
