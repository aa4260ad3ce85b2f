//! What a path is, and how it is written.

use std::collections::BTreeMap;
use std::io::BufWriter;
use std::path::Path as FilePath;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Serialize, Serializer};
use wimu_nav::filter::Filter;
use wimu_nav::state::{ATTITUDE, POSITION, VELOCITY};

use super::summary::Figures;
use super::truth::{Nees, consistency};
use super::{AidUse, Method, Move};
use crate::csv::CsvWriter;
use crate::digits::significant;
use crate::localization::Ranged;
use crate::mcap_file::RosFile;
use crate::navigation::distance_m;
use crate::ros::path::{PathTopics, Pose};
use crate::stats::norm;
use crate::{Code, OutputFile, Problem, Result, Severity};

/// Where the unit was at a sample, as JSON with standard deviations in place of covariances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PathPoint {
    /// Time, s, as in the file.
    pub time_s: f64,
    /// Position, m, east-north-up.
    pub position_m: [f64; 3],
    /// Covariance of the position, m².
    #[serde(rename = "sigma_m", serialize_with = "deviations")]
    pub covariance_m2: [[f64; 3]; 3],
    /// Velocity, m/s.
    #[serde(rename = "velocity_m_s")]
    pub velocity_mps: [f64; 3],
    /// Standard deviation of the velocity, m/s, and of the attitude about east, north and up, rad; 0 where it is not
    /// estimated.
    #[serde(rename = "velocity_sigma_m_s")]
    pub velocity_sd_mps: [f64; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
    /// See [`velocity_sd_mps`](Self::velocity_sd_mps).
    #[serde(rename = "attitude_sigma_rad")]
    pub attitude_sd_rad: [f64; 3],
    /// Angular rate, rad/s, body axes.
    #[serde(skip)]
    pub rate_rad_s: [f64; 3],
    /// Its covariance, (rad/s)²; `None` without an array.
    #[serde(skip)]
    pub rate_covariance: Option<[[f64; 3]; 3]>,
    /// Standard deviation of the position in space, m, from the samples up to this one alone.
    #[serde(skip)]
    pub filtered_sd_m: f64,
    /// Whether it is taken to rest: never with ZUPT off.
    pub resting: bool,
    /// Whether the position is of use: known to the limit, no gap since the last rest.
    pub valid: bool,
}

/// Standard deviation of each component; NaN where the variance is unknown.
fn sigma(covariance: &[[f64; 3]; 3]) -> [f64; 3] {
    let variance = |i: usize| covariance[i][i];
    // `max` would make 0 of what is not a number.
    std::array::from_fn(|i| if variance(i) < 0.0 { 0.0 } else { variance(i).sqrt() })
}

fn deviations<S: Serializer>(
    covariance: &[[f64; 3]; 3],
    to: S,
) -> std::result::Result<S::Ok, S::Error> {
    sigma(covariance).serialize(to)
}

impl PathPoint {
    /// What a filter estimates at a time, s.
    pub(crate) fn of(time_s: f64, filter: &Filter) -> Self {
        let deviation = |block| {
            let variance = filter.covariance::<3>(block).diagonal();
            variance.map(|v| v.max(0.0).sqrt()).into()
        };
        let attitude = UnitQuaternion::from_rotation_matrix(&filter.state.attitude);
        let mut point = Self {
            time_s,
            position_m: filter.state.get(POSITION).into(),
            velocity_mps: filter.state.get(VELOCITY).into(),
            velocity_sd_mps: deviation(VELOCITY),
            attitude_sd_rad: deviation(ATTITUDE),
            quaternion: [attitude.w, attitude.i, attitude.j, attitude.k],
            rate_rad_s: [0.0; 3],
            rate_covariance: None,
            covariance_m2: filter.covariance(POSITION).into(),
            filtered_sd_m: 0.0,
            resting: false,
            valid: true,
        };
        point.filtered_sd_m = point.sd_m();
        point
    }

    /// Standard deviation of each component, m; NaN where the variance is unknown.
    pub fn sigma_m(&self) -> [f64; 3] {
        sigma(&self.covariance_m2)
    }

    fn is_finite(&self) -> bool {
        let vectors = [self.position_m, self.velocity_mps, self.rate_rad_s];
        let numbers = vectors.iter().chain(&self.covariance_m2).flatten();
        numbers.chain(&self.quaternion).all(|v| v.is_finite())
    }

    /// Standard deviation of each component of the angular rate, rad/s.
    pub fn rate_sigma_rad_s(&self) -> Option<[f64; 3]> {
        let covariance = self.rate_covariance?;
        Some(std::array::from_fn(|i| covariance[i][i].sqrt()))
    }

    /// Makes it one of two points that are equally probable, the other one off by a vector, m: half of its square is added to
    /// the covariance.
    pub(crate) fn or_at(&mut self, off_m: Vector3<f64>) {
        let both = Matrix3::from(self.covariance_m2) + off_m * off_m.transpose() * 0.5;
        self.covariance_m2 = both.into();
    }

    /// That of the position in space, m.
    pub fn sd_m(&self) -> f64 {
        norm(self.sigma_m())
    }
}

/// Innovation of a measurement by another system.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Residual {
    /// Time, s.
    pub time_s: f64,
    /// Name of the kind of measurement, and where it comes from: of a range the index of the anchor.
    pub aid: &'static str,
    /// See [`aid`](Self::aid).
    pub source: usize,
    /// Measured less predicted value in SI units; of a vector its length.
    pub value: f64,
    /// Normalised innovation squared, and its degrees of freedom: χ² distributed if the filter is consistent.
    pub statistic: f64,
    /// See [`statistic`](Self::statistic).
    pub dof: usize,
    /// Weight: 1 or 0, and of a range the probability of a line of sight.
    pub weight: f64,
    /// Whether it was used. A range without line of sight has little weight.
    pub accepted: bool,
}

/// A state that an aid has added, at the end of the path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StateFound {
    /// Kind of the aid, and name of the state.
    pub name: String,
    /// SI unit.
    pub unit: &'static str,
    /// Estimate, and its standard deviation.
    pub value: f64,
    /// See [`value`](Self::value).
    pub sigma: f64,
}

/// A path: the JSON of `wimu navigate`, from which text, page, tables and Python come. Axes are east-north-up, from the origin or
/// in the frame of the aids.
#[derive(Clone, Debug, Serialize)]
pub struct InertialPath {
    /// Where the recording came from.
    pub source: String,
    /// How it was found.
    pub method: Method,
    /// Value of the option `--zupt`; null for ranges.
    pub zupt: Option<&'static str>,
    /// Value of the option `--profile`; null for an array and for ranges.
    pub profile: Option<&'static str>,
    /// Whether the points rest on all samples ([`Choice::smooth`](super::Choice::smooth)).
    pub smoothed: bool,
    /// Whether the angular rate of an array rests on all samples.
    #[serde(skip)]
    pub smoothed_rate: bool,
    /// One point a sample.
    #[serde(skip)]
    pub points: Vec<PathPoint>,
    /// Index of the point from which position is measured: the last of the first rest.
    #[serde(skip)]
    pub origin: usize,
    /// Points known no better than this, m, are not valid.
    #[serde(skip)]
    pub limit_m: f64,
    /// What the points show.
    #[serde(flatten)]
    pub figures: Figures,
    /// What happened to the aids, by their kind.
    pub aids: BTreeMap<&'static str, AidUse>,
    /// States that aids have added.
    pub states: Vec<StateFound>,
    /// The moves between rests.
    pub moves: Vec<Move>,
    /// What aids measured less what the forward filter predicted, used or not.
    #[serde(skip)]
    pub residuals: Vec<Residual>,
    /// What ranges show of their anchors, of a path from ranges.
    #[serde(flatten)]
    pub ranging: Option<Ranged>,
    /// NEES of the position at each valid sample that has truth and moves, which is taken to be right to 1 mm; both
    /// begin at the same place and heading.
    pub nees: Nees,
    /// NEES of an array's angular rate at each valid sample that moves, where the truth tells it.
    pub rate_nees: Nees,
    /// Where the unit truly was, m, in the path's axes, at each sample that has truth; empty without.
    #[serde(skip)]
    pub truth_m: Vec<Option<[f64; 3]>>,
    /// What was noticed on the way.
    #[serde(skip)]
    pub findings: Vec<Problem>,
}

impl InertialPath {
    /// A path without moves, not yet compared with any truth.
    pub(crate) fn new(method: Method, points: Vec<PathPoint>, origin: usize, limit_m: f64) -> Self {
        Self {
            source: String::new(),
            method,
            zupt: None,
            profile: None,
            smoothed: false,
            smoothed_rate: false,
            points,
            origin,
            limit_m,
            figures: Figures::default(),
            aids: BTreeMap::new(),
            states: Vec::new(),
            moves: Vec::new(),
            residuals: Vec::new(),
            ranging: None,
            nees: Nees::default(),
            rate_nees: Nees::default(),
            truth_m: Vec::new(),
            findings: Vec::new(),
        }
    }

    /// Makes not valid what is not finite and all after it, and reports it.
    ///
    /// # Errors
    /// `data_refused` with the remedy where nothing is valid.
    pub(crate) fn checked(mut self, name: &str, remedy: &str) -> Result<Self> {
        let diverged = self.points.iter().position(|p| !p.is_finite());
        for point in self.points.iter_mut().skip(diverged.unwrap_or(usize::MAX)) {
            point.valid = false;
        }
        let diverged = diverged.map(|k| {
            format!(
                "the filter diverged at {:.2} s: position is not valid from there on. Check axes, signs and units of the \
                 sensors there",
                self.points[k].time_s
            )
        });
        let finding = (diverged.clone()).map(|text| Code::Navigation.warning(text));
        self.findings.extend(finding);
        if self.points.iter().any(|p| p.valid) {
            return Ok(self);
        }
        let lost = self.findings.iter().find(|finding| finding.severity == Severity::Error);
        if let Some(lost) = lost {
            let error = Code::DataRefused.error(&lost.text, &lost.remedy);
            return Err(error.at(name));
        }
        let sigmas = self.points.iter().map(PathPoint::sd_m);
        let best_m = sigmas.filter(|sd| sd.is_finite()).fold(f64::INFINITY, f64::min);
        let message = diverged.unwrap_or_else(|| {
            if best_m > self.limit_m {
                format!(
                    "no position is known to {} m: σ is {} m at best",
                    self.limit_m,
                    significant(best_m, 3)
                )
            } else {
                "no position could be found to the limit".to_owned()
            }
        });
        Err(Code::DataRefused.error(message, remedy).at(name))
    }

    /// Length of the path over its valid points, m.
    pub fn distance_m(&self) -> f64 {
        self.points
            .windows(2)
            .filter(|w| w[0].valid && w[1].valid)
            .map(|w| distance_m(w[0].position_m, w[1].position_m))
            // An empty sum is −0.
            .sum::<f64>()
            + 0.0
    }

    /// Median NEES of the moving samples and the share below 7.81 (95 % of a right covariance), where there is truth.
    pub fn consistency(&self) -> Option<(f64, f64)> {
        consistency(&self.nees.all)
    }

    /// Writes the points as CSV, or as [`write_mcap`](Self::write_mcap) where the file's name ends in `.mcap`.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write(&self, file: &FilePath) -> Result<()> {
        let extension = file.extension();
        if extension.is_some_and(|e| e.eq_ignore_ascii_case("mcap")) {
            return self.write_mcap(file);
        }
        self.write_csv(file)
    }

    /// Writes the valid points as ROS 2 messages: `/odom`, `/path` (at most 1000 poses, 1 s apart or more), `/tf` from
    /// `map` to `base_link`, and `/tf_static` to `imu_link`. Stamps are the times of the recording. Covariances that are
    /// not estimated are 0.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write_mcap(&self, file: &FilePath) -> Result<()> {
        let (output, sink) = OutputFile::create(file)?;
        let mut out = RosFile::new(sink, output.name())?;
        let mut topics = PathTopics::new("", true);
        for point in self.points.iter().filter(|point| point.valid) {
            let stamp_ns = (point.time_s * 1e9).round() as u64;
            let pose = Pose {
                stamp_ns,
                position_m: point.position_m,
                position_covariance: point.covariance_m2,
                quaternion: point.quaternion,
                attitude_sd_rad: point.attitude_sd_rad,
                velocity_mps: point.velocity_mps,
                velocity_sd_mps: point.velocity_sd_mps,
                rate_rad_s: point.rate_rad_s,
            };
            topics.push(&mut out, stamp_ns, &pose)?;
        }
        topics.finish(&mut out)?;
        out.finish()?;
        output.finish()
    }

    /// Writes the points as CSV.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write_csv(&self, file: &FilePath) -> Result<()> {
        let (output, sink) = OutputFile::create(file)?;
        let mut header = vec!["Time (s)".to_owned()];
        header.extend(["E", "N", "U"].map(|a| format!("Position {a} (m)")));
        header.extend(["E", "N", "U"].map(|a| format!("Velocity {a} (m/s)")));
        header.extend(["W", "X", "Y", "Z"].map(|a| format!("Quaternion {a}")));
        header.extend(["X", "Y", "Z"].map(|a| format!("Angular Rate {a} (rad/s)")));
        header.extend(["E", "N", "U"].map(|a| format!("Sigma {a} (m)")));
        if self.points.iter().any(|p| p.rate_covariance.is_some()) {
            header.extend(["X", "Y", "Z"].map(|a| format!("Angular Rate Sigma {a} (rad/s)")));
        }
        header.push("Valid".to_owned());
        let mut out = CsvWriter::new(BufWriter::new(sink), output.name(), &header)?;
        for point in &self.points {
            let time_s = (point.time_s * 1e9).round() / 1e9;
            out.field(time_s);
            let (sigma, rate_sigma) = (point.sigma_m(), point.rate_sigma_rad_s());
            let values = point
                .position_m
                .iter()
                .chain(&point.velocity_mps)
                .chain(&point.quaternion)
                .chain(&point.rate_rad_s)
                .chain(&sigma)
                .chain(rate_sigma.iter().flatten());
            for value in values {
                out.field(format!("{value:.6}"));
            }
            out.field(u8::from(point.valid)).end_row()?;
        }
        out.finish()?;
        output.finish()
    }
}
