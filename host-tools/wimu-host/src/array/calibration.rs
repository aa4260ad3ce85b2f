//! Calibration of an array from the rests in its own recording, or as it is stored.

use wimu_calib::array::ArrayPrior;
use wimu_calib::{Gravity, Pose};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};

use super::fit::{Fitted, at_rests, contradiction};
use super::motion::{check, with_room};
use super::outputs::{
    apart_of, departures, disagreement, is_dead, is_throughout, mean, pose, scale_of,
    steady_stretches,
};
use super::rests::{EvenTurn, REST_BIAS_MPS2, judged};
use super::{ArrayGeometry, ArrayRecording};
use crate::stats::norm;
use crate::{Code, Result};

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
    pub rests: Vec<(usize, usize)>,
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
    /// How well each coordinate of a place is known, m: [`PLACE_SD_M`](Self::PLACE_SD_M) unless set.
    pub place_sd_m: f64,
    /// How well the sensors' times among each other are known, s: [`DELAY_SD_S`](Self::DELAY_SD_S) unless set.
    pub delay_sd_s: f64,
    /// Why the error models are those of perfect sensors, where they are.
    pub uncalibrated: Option<String>,
    /// Whether the geometry had an error model of each sensor, so that none was fitted.
    pub stored: bool,
    /// Fit of each sensor; `None` where the rests do not calibrate it.
    pub fits: Vec<Option<SensorFit>>,
    /// Sensors that are of no use, and why.
    pub left_out: Vec<(usize, String)>,
    /// What each sensor that is used departs from the mean of all by, m/s² rms, before the rests' departures were
    /// taken into the models.
    apart_mps2: Vec<(usize, f64)>,
    /// Prior deviations of biases, m/s², and of the entries of the matrices, and gravity.
    prior: ArrayPrior,
    /// Mean force at each rest, m/s².
    rest_forces: Vec<[f64; 3]>,
    /// What each sensor still adds at each rest, m/s².
    offsets: Vec<Vec<[f64; 3]>>,
}

impl ArrayCalibration {
    /// How well a place is known where it is not given, m.
    pub const PLACE_SD_M: f64 = 5e-4;
    /// How well the sensors' times among each other are known where it is not given, s.
    pub const DELAY_SD_S: f64 = 3e-4;

    /// From the accelerometers alone, in body axes. A rest is an interval in which the mean of all sensors is steady and
    /// they agree with each other as at every other rest. Biases and matrices of all sensors are fitted to one
    /// gravity vector per rest ([`wimu_calib::array`]). A sensor that is dead, or that contradicts the others, is left
    /// out; one that fails on the way counts as long as it lives. Where the geometry has error models,
    /// [`ArrayRecording::arranged`] has applied them, and the fit finds what they leave.
    ///
    /// # Errors
    /// `data_refused` when there is no rest at all, or no sensor is alive; `usage` when the geometry has
    /// another number of sensors, or more than 16.
    pub fn of(
        recording: &ArrayRecording,
        geometry: &ArrayGeometry,
        gravity: Gravity,
    ) -> Result<Self> {
        check(recording, geometry)?;
        let sensors = recording.sensors();
        let refused = |message: &str, remedy: &str| {
            Code::DataRefused.error(message, remedy).at(&recording.name)
        };
        let mut left_out: Vec<(usize, String)> = (0..sensors)
            .filter(|sensor| is_dead(recording, *sensor))
            .map(|sensor| (sensor, "its output never moves".to_owned()))
            .collect();
        if left_out.len() == sensors {
            return Err(refused(
                "no sensor's output moves",
                "check the sensors and the sensitivity",
            ));
        }
        let dead: Vec<usize> = left_out.iter().map(|(sensor, _)| *sensor).collect();
        let stretches = steady_stretches(recording, &dead);
        // Judged by the sensors that live through all of them.
        let lives: Vec<bool> = (0..sensors)
            .map(|sensor| {
                let seen = |span: &(usize, usize)| is_throughout(recording, sensor, *span);
                !dead.contains(&sensor) && stretches.iter().all(seen)
            })
            .collect();
        let judged = judged(recording, geometry, &stretches, &lives)?;
        let rests = judged.rests;
        if rests.is_empty() {
            return Err(if judged.turns.is_empty() {
                refused(
                    "there is no rest in the recording, so neither biases nor gravity are known",
                    "hold the array still for two seconds, in several orientations",
                )
            } else {
                refused(
                    "wherever the sensors are steady they show an even turn, so there is no rest, and \
                     neither biases nor gravity are known",
                    "hold the array still for two seconds, in several orientations; check the places of \
                     the sensors",
                )
            });
        }
        let per_sensor: Vec<Vec<Option<Pose>>> = (0..sensors)
            .map(|sensor| {
                let of_rest = |rest: &(usize, usize)| pose(recording, sensor, *rest);
                rests.iter().map(of_rest).collect()
            })
            .collect();
        let seen = |sensor: usize| per_sensor[sensor].iter().flatten();
        for sensor in 0..sensors {
            if !dead.contains(&sensor) && seen(sensor).next().is_none() {
                left_out.push((sensor, "it has no output at any rest".to_owned()));
            }
        }
        let noise_mps2 = (0..sensors)
            .map(|sensor| {
                let square = |p: &Pose| p.sd_mps2.iter().map(|s| s * s).sum::<f64>() / 3.0;
                let count = seen(sensor).count().max(1) as f64;
                let noise = (seen(sensor).map(square).sum::<f64>() / count).sqrt();
                if noise > 0.0 { noise } else { ASSUMED_NOISE_MPS2 }
            })
            .collect();
        let stored = !geometry.sensors.is_empty()
            && (0..sensors).all(|s| {
                geometry.sensors[s].model.is_some() || left_out.iter().any(|(out, _)| *out == s)
            });
        let mut calibration = Self {
            sensors: vec![ErrorModel::default(); sensors],
            noise_mps2,
            rests,
            turns: judged.turns,
            unseen_rad_s: judged.unseen_rad_s,
            disagreement_mps2: 0.0,
            bias_mps2: BIAS_MPS2,
            scale: 0.0,
            common_scale: 0.0,
            place_sd_m: Self::PLACE_SD_M,
            delay_sd_s: Self::DELAY_SD_S,
            uncalibrated: None,
            stored,
            fits: vec![None; sensors],
            left_out,
            apart_mps2: Vec::new(),
            prior: ArrayPrior {
                gravity_mps2: gravity.mps2(),
                gravity_sd_mps2: gravity.sd_mps2(),
                repeatability_mps2: REST_BIAS_MPS2,
                ..ArrayPrior::default()
            },
            rest_forces: Vec::new(),
            offsets: Vec::new(),
        };
        let outputs: Vec<Vec<Option<[f64; 3]>>> = (per_sensor.iter())
            .map(|poses| poses.iter().map(|p| p.as_ref().map(|p| p.mean_mps2)).collect())
            .collect();
        calibration.assume(&outputs);
        calibration.fit(recording, geometry, &outputs)?;
        calibration.take_off_offsets(&outputs);
        Ok(calibration)
    }

    /// Sensors that are used.
    fn used(&self) -> Vec<usize> {
        (0..self.sensors.len()).filter(|sensor| self.uses(*sensor)).collect()
    }

    /// Prior deviations by the method of moments, equation (104), from the mean outputs at the rests.
    fn assume(&mut self, outputs: &[Vec<Option<[f64; 3]>>]) {
        let used = self.used();
        let offsets = departures(outputs, self.rests.len(), &used);
        let count = used.len() as f64;
        let apart = disagreement(&offsets, &used) * (count / f64::max(count - 1.0, 1.0)).sqrt();
        self.bias_mps2 = apart.max(BIAS_MPS2);
        // In one orientation bias and scale factor cannot be told apart.
        self.scale = scale_of(&offsets, outputs, &used)
            .unwrap_or(apart / STANDARD_GRAVITY_MPS2)
            .max(LEAST_SCALE);
        self.apart_mps2 = used.iter().map(|k| (*k, apart_of(*k, &offsets))).collect();
        let (bias, scale) = (MOST_SCALE * STANDARD_GRAVITY_MPS2, MOST_SCALE);
        self.prior.bias_mps2 = self.bias_mps2.min(bias);
        self.prior.matrix = self.scale.min(scale);
    }

    /// Fits biases and matrices to the rests; what they leave uncertain stays in `scale`.
    fn fit(
        &mut self,
        recording: &ArrayRecording,
        geometry: &ArrayGeometry,
        outputs: &[Vec<Option<[f64; 3]>>],
    ) -> Result<()> {
        let mut prior = self.prior();
        let fitted = |of: &mut Self, prior: &ArrayPrior| -> Result<Fitted> {
            let found =
                with_room!(geometry.sensors.len(), at_rests(recording, geometry, of, prior))?;
            for (model, found) in of.sensors.iter_mut().zip(&found.models) {
                *model = found.unwrap_or_default();
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
            let offsets = departures(&self.corrected(outputs), self.rests.len(), &self.used());
            let shown = REPEATABILITY_TIMES * disagreement(&offsets, &self.used());
            prior.repeatability_mps2 = shown.clamp(LEAST_REPEATABILITY_MPS2, REST_BIAS_MPS2);
            found = fitted(self, &prior)?;
            for sensor in self.used() {
                self.fits[sensor] = Some(self.fit_of(sensor, &outputs[sensor], &found));
            }
            (self.bias_mps2, self.scale) = (BIAS_MPS2, 0.0);
            return Ok(());
        }
        let reason = "the rests do not determine its scale factors and misalignments";
        self.uncalibrated = (!self.stored).then(|| reason.to_owned());
        if self.scale < MOST_SCALE {
            // An error that all sensors have is one of the scale in which gravity is measured.
            self.prior.gravity_mps2 = self.mean_rest_mps2(recording);
            self.prior.gravity_sd_mps2 = MOST_SCALE * STANDARD_GRAVITY_MPS2;
            found = fitted(self, &self.prior())?;
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
    fn faulty(&self, outputs: &[Vec<Option<[f64; 3]>>]) -> Option<(usize, f64)> {
        let used = self.used();
        let forces = self.corrected(outputs);
        let offsets = departures(&forces, self.rests.len(), &used);
        let mut apart: Vec<(usize, f64)> =
            used.iter().map(|k| (*k, apart_of(*k, &offsets))).collect();
        apart.sort_by(|a, b| a.1.total_cmp(&b.1));
        let (worst, median) = (*apart.last()?, apart.get(apart.len() / 2)?.1);
        let alone = apart.len() > 3 && 2 * self.left_out.len() < self.sensors.len();
        (alone && worst.1 > FAULTY_MPS2 && worst.1 > FAULTY_TIMES * median).then_some(worst)
    }

    fn corrected(&self, outputs: &[Vec<Option<[f64; 3]>>]) -> Vec<Vec<Option<[f64; 3]>>> {
        let all = outputs.iter().zip(&self.sensors);
        all.map(|(outputs, model)| {
            let force = |output: [f64; 3]| model.correct(SpecificForceMps2(output), None).0;
            outputs.iter().map(|output| output.map(force)).collect()
        })
        .collect()
    }

    fn fit_of(&self, sensor: usize, outputs: &[Option<[f64; 3]>], found: &Fitted) -> SensorFit {
        let lengths: Vec<f64> = (outputs.iter().flatten())
            .map(|output| self.sensors[sensor].correct(SpecificForceMps2(*output), None).norm())
            .collect();
        let squares = lengths.iter().map(|l| (l - self.prior.gravity_mps2).powi(2)).sum::<f64>();
        let (bias_sd_mps2, matrix_sd) = found.model_sd[sensor];
        SensorFit {
            rests: lengths.len(),
            rms_mps2: (squares / lengths.len().max(1) as f64).sqrt(),
            bias_sd_mps2,
            matrix_sd,
        }
    }

    /// Mean force of all sensors at each rest, and by how much each sensor departs from it.
    fn take_off_offsets(&mut self, outputs: &[Vec<Option<[f64; 3]>>]) {
        let (used, forces) = (self.used(), self.corrected(outputs));
        self.rest_forces = (0..self.rests.len())
            .map(|rest| mean(used.iter().filter_map(|k| forces[*k][rest])))
            .collect();
        let mut offsets = departures(&forces, self.rests.len(), &used);
        self.disagreement_mps2 = disagreement(&offsets, &used);
        // A rest at which a sensor has no output takes the departure of the rest before, or of the first.
        for sensor in 0..self.sensors.len() {
            let mut last = offsets.iter().find_map(|all| all[sensor]);
            for all in &mut offsets {
                last = all[sensor].or(last);
                all[sensor] = last;
            }
        }
        self.offsets = (offsets.iter())
            .map(|all| all.iter().map(|o| o.unwrap_or_default()).collect())
            .collect();
    }

    /// Prior of a fit of the whole recording.
    pub(super) fn prior(&self) -> ArrayPrior {
        ArrayPrior { position_m: self.place_sd_m, delay_s: self.delay_sd_s, ..self.prior }
    }

    /// Mean length of the mean output at the rests, m/s².
    pub fn mean_rest_mps2(&self, recording: &ArrayRecording) -> f64 {
        let length = |rest: &(usize, usize)| {
            let used = (0..recording.sensors()).filter(|sensor| self.uses(*sensor));
            norm(mean(used.filter_map(|k| Some(pose(recording, k, *rest)?.mean_mps2))))
        };
        self.rests.iter().map(length).sum::<f64>() / self.rests.len() as f64
    }

    /// Refuses sensors that differ at the rests by more than errors of sensors.
    ///
    /// # Errors
    /// `data_refused`, with what to check.
    pub fn check(&self, name: &str) -> Result<()> {
        if self.scale < MOST_SCALE {
            return Ok(());
        }
        let differ = "at rest they differ by more than biases and scale factors of sensors do: by";
        Err(contradiction(name, &format!("{differ} {:.2} m/s²", self.bias_mps2)))
    }

    /// What was assumed, found wrong and left out.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(fastest) = self.turns.iter().map(|t| t.rate_rad_s).reduce(f64::max) {
            remarks.push(format!(
                "{} stretches with a steady mean are no rests: among each other the sensors show an even turn, \
                 at up to {fastest:.1} rad/s",
                self.turns.len()
            ));
        }
        if let Some(unseen) = self.unseen_rad_s {
            let rests = match self.rests.len() {
                1 => "the one rest".to_owned(),
                many => format!("the {many} rests"),
            };
            remarks.push(format!(
                "that the array did not turn evenly about the vertical at {rests} is assumed: below \
                 {unseen:.1} rad/s it would look the same"
            ));
        }
        if let Some(why) = &self.uncalibrated {
            remarks.push(format!(
                "the array is not calibrated: {why}. As its sensors differ, biases of ± {:.3} m/s² are allowed for; \
                 what the rests tell of each one is taken off, which leaves sensitivities and directions wrong by ± {:.2} %. \
                 Rests in a dozen orientations tell all: `wimu calibrate RESTS.csv --geometry PLACES.csv -o ARRAY.json`",
                self.bias_mps2,
                self.scale * 100.0
            ));
        }
        if self.stored {
            remarks.push(format!(
                "the sensors have error models of their own: at the rests they differ by {:.3} m/s² after all, so that \
                 biases of ± {:.3} m/s² and sensitivities and directions wrong by ± {:.2} % are allowed for",
                self.disagreement_mps2,
                self.bias_mps2,
                self.scale * 100.0
            ));
            if let Some((sensor, apart)) = self.farthest()
                && apart > DOUBTFUL_MPS2
            {
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

    /// The sensor that departs most from the mean of all at the rests, and by how much, m/s² rms.
    fn farthest(&self) -> Option<(usize, f64)> {
        let all = self.apart_mps2.iter().copied();
        all.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The rest whose departures are taken off sample `index`: the latest before it, or the first.
    pub(super) fn offset_of(&self, index: usize) -> usize {
        let rest = self.rests.partition_point(|(first, _)| *first <= index);
        rest.saturating_sub(1)
    }

    /// Whether a sensor is of use.
    pub fn uses(&self, sensor: usize) -> bool {
        self.left_out.iter().all(|(out, _)| *out != sensor)
    }

    /// Specific force of sensor `sensor` in body axes, m/s², without what it added at the latest rest
    /// before sample `index`: that part of its bias which the other sensors show.
    pub fn force(&self, sensor: usize, output_mps2: [f64; 3], index: usize) -> [f64; 3] {
        self.force_since(sensor, output_mps2, self.offset_of(index))
    }

    /// The same without what it added at rest `rest`.
    pub(super) fn force_since(
        &self,
        sensor: usize,
        output_mps2: [f64; 3],
        rest: usize,
    ) -> [f64; 3] {
        let Some(model) = self.sensors.get(sensor) else {
            return output_mps2;
        };
        let force = model.correct(SpecificForceMps2(output_mps2), None).0;
        let offset = self.offsets[rest][sensor];
        core::array::from_fn(|axis| force[axis] - offset[axis])
    }
}
