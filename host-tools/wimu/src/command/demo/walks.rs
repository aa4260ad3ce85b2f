//! The walks of `wimu demo --localize`: what is simulated, what is found of it, its pictures and files.

use std::fmt::Write as _;
use std::path::Path;

use wimu_host::chart::{Chart, Series};
use wimu_host::inertial::{Aids, Choice, InertialPath, PathPoint, Profile, Zupt, navigate};
use wimu_host::localization::{LocalizationChoice, RangePrior, localize};
use wimu_host::motion::MotionRecording;
use wimu_host::{OutputFile, Problem, Result};
use wimu_sim::walk::{HALL_M, RangeWalk, Strides, carried_m, fixes, sensed};

/// Duration of the walk with ranges, s, and fraction of its ranges without line of sight.
pub const WALK_S: f64 = 60.0;
const BLOCKED: f64 = 0.05;
/// Corners of the walk on foot, m, east and north: a closed path of 96 m.
pub const CORNERS_M: [[f64; 2]; 5] =
    [[0.0, 0.0], [34.0, 0.0], [34.0, 14.0], [0.0, 14.0], [0.0, 0.0]];
/// Rate of the inertial samples, Hz: the least that docs/explanation/feet.md names.
const RATE_HZ: f64 = 100.0;
/// Interval of the fixes, s, and their standard deviation, m.
const FIX_S: f64 = 5.0;
pub const FIX_M: f64 = 0.3;

/// Points of a line in a picture, about.
const SHOWN: usize = 1000;

/// What is simulated, and what is found of it.
pub struct Walks {
    pub ranges: RangeWalk,
    pub before: InertialPath,
    pub after: InertialPath,
    walk: MotionRecording,
    pub foot: InertialPath,
    pub integrated: InertialPath,
    pub fixes: Aids,
    pub fixed: InertialPath,
}

impl Walks {
    pub fn new(seed: u64) -> Result<Self> {
        let ranges = RangeWalk::new(seed, &HALL_M, WALK_S, BLOCKED);
        let exact = RangePrior { bias_m: 0.0, ..RangePrior::ULTRA_WIDEBAND };
        let located = |prior| {
            let choice = LocalizationChoice { prior, ..LocalizationChoice::default() };
            localize(&ranges.recording, &choice)
        };
        let (before, after) = (located(Some(exact))?, located(None)?);
        let strides = Strides::along(&CORNERS_M);
        let walk = sensed(&strides, RATE_HZ, seed);
        let foot = Choice { profile: Profile::Foot, limit_m: f64::INFINITY, ..Choice::default() };
        let alone =
            Choice { profile: Profile::Free, zupt: Zupt::Off, smooth: false, ..foot.clone() };
        let fixes = fixes(&strides, FIX_S, FIX_M, seed);
        let aided = Choice { aids: fixes.clone(), ..foot.clone() };
        Ok(Self {
            before,
            after,
            foot: navigate(&walk, &foot)?,
            integrated: navigate(&walk, &alone)?,
            fixed: navigate(&walk, &aided)?,
            ranges,
            walk,
            fixes,
        })
    }

    /// True positions of the walk on foot, m.
    pub fn truth(&self) -> impl DoubleEndedIterator<Item = [f64; 3]> {
        self.walk.truth.iter().flatten().map(|t| t.position_m)
    }

    /// One picture for each guide in docs/explanation.
    pub fn charts(&self) -> [(&'static str, Chart); 3] {
        let level = |p: [f64; 3]| (p[0], p[1]);
        let line = |name: &str, points: &[PathPoint]| {
            let shown = points.iter().step_by((points.len() / SHOWN).max(1));
            Series::line(name, shown.map(|p| level(p.position_m)).collect())
        };
        let times = self.after.points.iter().map(|p| p.time_s);
        let carried = Series::line("truth", times.map(|t| level(carried_m(t))).collect());
        let walked = self.truth().step_by((self.walk.truth.len() / SHOWN).max(1));
        let walked = Series::line("truth", walked.map(level).collect());
        let anchors = HALL_M.map(level).to_vec();
        let fixes = self.fixes.aids.iter().map(|fix| level(fix.value));
        [
            (
                "ranges",
                plan(
                    "Walk in a hall with six anchors",
                    vec![
                        line("biases taken as zero", &self.before.points),
                        line("biases estimated", &self.after.points),
                        carried,
                        Series::dots("anchors", anchors),
                    ],
                ),
            ),
            (
                "feet",
                plan(
                    "Closed path of a unit on a shoe",
                    vec![
                        line("integration alone", &self.integrated.points[..self.begun()]),
                        line("zero velocity in stances", &self.foot.points),
                        walked.clone(),
                    ],
                ),
            ),
            (
                "fixes",
                plan(
                    "The same path with position fixes",
                    vec![
                        line("without fixes", &self.foot.points),
                        line("with fixes", &self.fixed.points),
                        walked,
                        Series::dots("fixes", fixes.collect()),
                    ],
                ),
            ),
        ]
    }

    /// Points until integration alone leaves the picture.
    fn begun(&self) -> usize {
        let far = |p: &PathPoint| p.position_m[..2].iter().any(|c| c.abs() > CORNERS_M[2][1]);
        let points = &self.integrated.points;
        points.iter().position(far).unwrap_or(points.len())
    }

    /// The simulated files, in the formats of the guides.
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder)
            .map_err(|error| Problem::file(&folder.display().to_string(), "create", &error))?;
        let recording = &self.ranges.recording;
        let mut anchors = "Anchor,Position E (m),Position N (m),Position U (m)\n".to_owned();
        for anchor in &recording.anchors {
            let [e, n, u] = anchor.position_m;
            let _ = writeln!(anchors, "{},{e},{n},{u}", anchor.id);
        }
        let mut ranges = "Time (s),Anchor,Range (m)\n".to_owned();
        for range in &recording.ranges {
            let id = &recording.anchors[range.anchor].id;
            let _ = writeln!(ranges, "{:.1},{id},{:.4}", range.time_s, range.range_m);
        }
        let axes = |sensor: &str, unit: &str| {
            ["X", "Y", "Z"].map(|axis| format!(",{sensor} {axis} ({unit})"))
        };
        let mut walk = "Time (s)".to_owned();
        walk.extend(axes("Accelerometer", "m/s²"));
        walk.extend(axes("Gyroscope", "rad/s"));
        for (time_s, sample) in self.walk.times_s.iter().zip(&self.walk.samples) {
            let _ = write!(walk, "\n{time_s:.2}");
            for value in sample.force_mps2.iter().chain(sample.rate_rad_s.iter().flatten()) {
                let _ = write!(walk, ",{value:.5}");
            }
        }
        let mut fixes = "Time (s),Position E (m),Position N (m),Position U (m),\
            Position Sigma E (m),Position Sigma N (m),Position Sigma U (m)\n"
            .to_owned();
        for fix in &self.fixes.aids {
            let ([e, n, u], [de, dn, du]) = (fix.value, fix.sd);
            let _ = writeln!(fixes, "{:.1},{e:.3},{n:.3},{u:.3},{de},{dn},{du}", fix.time_s);
        }
        for (name, text) in [
            ("anchors.csv", anchors),
            ("ranges.csv", ranges),
            ("walk.csv", walk + "\n"),
            ("fixes.csv", fixes),
        ] {
            OutputFile::write(&folder.join(name), text)?;
        }
        Ok(())
    }
}

fn plan(title: &str, series: Vec<Series>) -> Chart {
    Chart { equal: true, ..Chart::new(title, "east, m", "north, m", series) }
}
