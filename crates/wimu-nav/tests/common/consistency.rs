//! NEES of the position over simulated motions, each with errors that are drawn from what the navigator assumes.

use super::Random;
use super::navigated::{Navigated, navigate};
use super::travel::{Errors, Travel};
use wimu_nav::navigator::{Profile, Settings};
use wimu_testkit::Coverage;

/// Kinds of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Moves of 0.7 m with rotations, and rests between.
    StopAndGo,
    /// A hand's oscillation.
    Hand,
    /// Strides of 1.2 m, the profile of a foot.
    Foot,
}

pub const KINDS: [Kind; 3] = [Kind::StopAndGo, Kind::Hand, Kind::Foot];

impl Kind {
    /// With a gyroscope, and without; a foot has one.
    pub fn gyroscopes(self) -> impl Iterator<Item = bool> {
        let foot = self == Self::Foot;
        [true, false].into_iter().filter(move |with| *with || !foot)
    }

    /// Times after the start, s, at which the error counts: in motion, and at a rest.
    fn times_s(self) -> [f64; 3] {
        match self {
            Self::StopAndGo => [4.75, 8.25, 10.8],
            Self::Hand => [5.0, 6.0, 9.0],
            Self::Foot => [4.3, 7.9, 9.6],
        }
    }

    fn travel(self, random: &mut Random) -> Travel {
        match self {
            Self::StopAndGo => Travel::stop_and_go(random, 2, 0.7, 0.7),
            Self::Hand => Travel::oscillation(random, [4.0, 20.0], 0.06, 0.3),
            Self::Foot => (0..6).fold(Travel::rest(), |travel, k| {
                let pitch = if k % 2 == 0 { 0.8 } else { -0.8 };
                travel.leg(2.8 + 1.2 * f64::from(k), 0.6, [1.2, 0.0, 0.0], [0.0, pitch, 0.0])
            }),
        }
    }
}

/// At one time of a draw.
struct Found {
    nees: f64,
    error_m: f64,
}

/// What draws of one kind show.
pub struct Consistency {
    name: String,
    /// At the three times: NEES below 7.81, and median NEES.
    pub below: [Coverage; 3],
    pub median: [f64; 3],
    /// NEES of all draws at all three times.
    pub nees: Vec<f64>,
    /// Median error, m.
    pub error: [f64; 3],
}

impl Consistency {
    pub fn over(kind: Kind, gyroscope: bool, draws: u64) -> Self {
        let profile = if kind == Kind::Foot { Profile::Foot } else { Profile::Hand };
        let settings = Settings::of(profile);
        let points: Vec<[Found; 3]> = (0..draws)
            .map(|seed| {
                let mut random = Random::new(seed * 7919 + 17);
                let errors = Errors::drawn(&settings.errors, &mut random);
                let travel = kind.travel(&mut random);
                let how = Navigated {
                    settings,
                    until_s: kind.times_s()[2],
                    gyroscope,
                    detector: false,
                    ..Navigated::default()
                };
                let points = navigate(&travel, &errors, how, seed);
                kind.times_s().map(|t| {
                    let point = points.iter().rfind(|p| p.time_s <= t + 1e-6).unwrap();
                    Found { nees: point.nees(), error_m: point.position_error.norm() }
                })
            })
            .collect();
        let median = |value: &dyn Fn(&[Found; 3]) -> f64| {
            let mut all: Vec<f64> = points.iter().map(value).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        Self {
            name: format!("{kind:?}, {} gyroscope", if gyroscope { "with" } else { "without" }),
            below: std::array::from_fn(|k| points.iter().map(|p| p[k].nees < 7.815).collect()),
            nees: points.iter().flatten().map(|found| found.nees).collect(),
            median: std::array::from_fn(|k| median(&|p| p[k].nees)),
            error: std::array::from_fn(|k| median(&|p| p[k].error_m)),
        }
    }
}

impl std::fmt::Display for Consistency {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { name, below, median: n, error: e, .. } = self;
        let b = below.map(|b| 100.0 * b.fraction());
        write!(
            f,
            "{name:<28} {:.3} {:.3} {:.3} m | {:4.0} {:4.0} {:4.0} % | {:.2} {:.2} {:.2}",
            e[0], e[1], e[2], b[0], b[1], b[2], n[0], n[1], n[2]
        )
    }
}
