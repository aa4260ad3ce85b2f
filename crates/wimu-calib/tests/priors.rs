//! `auto`: priors from datasheets beside the poses. What its intervals hold, on simulated sensors whose truth is known.

use crate::common;

use common::{AUTO, G, Random, exact, norm, parameters, pose, unit};
use wimu_calib::{Pose, multi_position};
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws};

/// The upward direction of a pose by its index.
type Held = fn(&mut Random, usize) -> [f64; 3];

/// Sensors of a kind, and how they are held.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    poses: usize,
    held: Held,
    /// Standard deviations: of a pose, m/s², of scale factors, of misalignments, and of the drift of an axis over the
    /// session, m/s².
    noise: f64,
    scale: f64,
    misalignment: f64,
    drift: f64,
    /// Whether there is a thermometer.
    warms: bool,
}

const KIND: Kind = Kind {
    name: "",
    poses: 12,
    held: |random, _| random.direction(),
    noise: 0.005,
    scale: 0.02,
    misalignment: 0.01,
    drift: 0.0,
    warms: false,
};

#[derive(Clone, Copy, Default)]
struct Found {
    answered: Coverage,
    /// Intervals of bias, scale factor and misalignment.
    held: [Coverage; 3],
    /// A bias is off by more than twice the half width.
    far: Coverage,
    rejected: usize,
    /// Squares of |f| − g in unseen orientations and of what was predicted for the worst, m/s².
    unseen: f64,
    predicted: f64,
}

impl std::fmt::Display for Found {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [bias, scale, misalignment] = self.held;
        let [unseen, predicted] = [self.unseen, self.predicted].map(|square| 1e3 * square.sqrt());
        write!(
            out,
            "answered {}; held {bias}, {scale}, {misalignment}; beyond twice the half width {}; unseen {unseen:.1}, \
             predicted for the worst {predicted:.1} mm/s² rms; {} good poses left out",
            self.answered, self.far, self.rejected
        )
    }
}

fn session(random: &mut Random, kind: Kind) -> (ErrorModel, Vec<Pose>) {
    let mut terms = ErrorTerms::default();
    let mut drift = [0.0; 3];
    for row in 0..3 {
        terms.bias_mps2[row] = 0.3 * random.normal();
        drift[row] = kind.drift * random.normal();
        terms.matrix[row][row] += kind.scale * random.normal();
        for column in 0..row {
            terms.matrix[row][column] = kind.misalignment * random.normal();
        }
    }
    let truth = ErrorModel::new(terms).expect("within bounds");
    let last = (kind.poses - 1) as f64;
    let mut celsius = 25.0;
    let poses = (0..kind.poses).map(|k| {
        let up = (kind.held)(random, k);
        let mut pose = pose(&truth, G, up);
        for axis in 0..3 {
            let progress = k as f64 / last - 1.0;
            pose.mean_mps2[axis] += drift[axis] * progress + kind.noise * random.normal();
        }
        celsius += 0.3 * random.normal();
        pose.time_s = 5.0 * k as f64;
        Pose { temperature_c: kind.warms.then_some(celsius), ..pose }
    });
    let poses = poses.collect();
    (truth, poses)
}

fn run(kind: Kind, sensors: usize) -> Found {
    let mut found = Found::default();
    for seed in 0..sensors as u64 {
        let mut random = Random::new(seed * 1000 + kind.poses as u64);
        let (truth, poses) = session(&mut random, kind);
        let answer = multi_position(&poses, exact(), AUTO);
        found.answered.count(answer.is_ok());
        let Ok(estimate) = answer else { continue };
        found.rejected += estimate.rejected.len();
        let (got, true_values) = (parameters(&estimate.model), parameters(&truth));
        let mut far = false;
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let error = (got[i] - true_values[i]).abs();
            let half = estimate.half_width_95(parameter);
            assert!(half > 0.0);
            let group = match i {
                0..3 => 0,
                3 | 7 | 11 => 1,
                _ => 2,
            };
            found.held[group].count(error <= half);
            far |= group == 0 && error > 2.0 * half;
        }
        found.far.count(far);
        let up = random.direction();
        let output = truth.distort(SpecificForceMps2(up.map(|c| c * G)), None);
        found.unseen += (norm(estimate.model.correct(output, None).0) - G).powi(2);
        found.predicted += estimate.worst_sd_mps2.powi(2);
    }
    let answered = found.answered.fraction() * found.answered.total() as f64;
    found.unseen /= answered.max(1.0);
    found.predicted /= answered.max(1.0);
    println!("{}, {} poses: {found}", kind.name, kind.poses);
    found
}

#[test]
fn intervals_hold_the_truth_where_half_of_the_sessions_drift() {
    let (mut each, mut both) = (Vec::new(), Vec::new());
    for poses in [12, 15, 20, 30] {
        let mut all = [Coverage::default(); 3];
        for (name, drift) in [("no drift", 0.0), ("drift of 20 mm/s²", 0.02)] {
            let found = run(Kind { name, poses, drift, ..KIND }, draws(1000, 3));
            for (all, held) in all.iter_mut().zip(found.held) {
                *all += held;
            }
            each.extend(found.held);
        }
        both.extend(all);
    }
    let claim = "`auto`: 95 % intervals hold the truth, half the sensors drift";
    coverage_figure(claim, &both, 0.93..=1.0);
    let claim = "`auto`: the same, those that drift and the others apart";
    coverage_figure(claim, &each, 0.93..=1.0);
    // Twelve poses hardly show their scatter beside a drift: that of other sensors could be larger.
    for held in both.into_iter().chain(each) {
        held.assert_can_be(0.93..=1.0, "both, and each kind");
    }
}

/// Within an angle of Z up.
fn cap(random: &mut Random, least_up: f64) -> [f64; 3] {
    loop {
        let up = random.direction();
        if up[2] >= least_up {
            return up;
        }
    }
}

/// The six sides in turn, placed to 1°.
fn side(random: &mut Random, side: usize) -> [f64; 3] {
    let mut up = [0, 1, 2].map(|_| 0.017 * random.normal());
    up[side % 6 / 2] += if side.is_multiple_of(2) { 1.0 } else { -1.0 };
    unit(up)
}

#[test]
fn intervals_hold_what_few_or_uneven_poses_do_not_determine() {
    let quiet = Kind { noise: 0.001, ..KIND };
    let small = Kind { scale: 0.005, misalignment: 0.003, ..quiet };
    let noisy =
        Kind { name: "noise beyond misalignment", misalignment: 0.003, noise: 0.02, ..KIND };
    let square = Kind { name: "no misalignment", misalignment: 0.0, ..KIND };
    let warm = Kind { name: "a thermometer", warms: true, ..KIND };
    let mut kinds = Vec::new();
    for kind in [noisy, square, warm] {
        kinds.extend([6, 8, 10, 24].map(|poses| Kind { poses, ..kind }));
    }
    let held: [(&str, usize, Held); 6] = [
        ("all in one plane to 0.6°", 18, |random, _| {
            let up = random.direction();
            unit([up[0], up[1], 0.01 * random.normal()])
        }),
        ("within 30° of Z up", 18, |random, _| cap(random, 0.866)),
        ("Z up", 24, |random, _| cap(random, 0.0)),
        ("ten of six sides, Z down once", 10, |random, k| {
            side(random, [0, 1, 2, 3, 4, 5, 0, 1, 2, 4][k])
        }),
        ("six sides twice", 12, side),
        ("six sides thrice, Z down once", 16, |random, k| {
            side(random, if k < 15 { k % 5 } else { 5 })
        }),
    ];
    for (name, poses, held) in held {
        kinds.extend([quiet, small].map(|kind| Kind { name, poses, held, ..kind }));
    }
    let (mut held, mut far) = (Vec::new(), Vec::new());
    for kind in kinds {
        let found = run(kind, draws(400, 3));
        assert!(500 * found.rejected <= 400 * kind.poses, "{}", kind.name);
        if found.answered.fraction() < 0.2 {
            continue;
        }
        for held in &found.held[..2] {
            held.assert_can_be(0.91..=1.0, kind.name);
        }
        found.far.assert_can_be(0.0..=0.05, kind.name);
        assert!(found.unseen <= 1.5 * found.predicted, "{}", kind.name);
        held.extend(&found.held[..2]);
        far.push(found.far);
    }
    let claim = "`auto`, few or uneven poses: 95 % intervals of bias and scale factor";
    coverage_figure(claim, &held, 0.93..=1.0);
    let claim = "`auto`, few or uneven poses: a bias beyond twice its interval";
    coverage_figure(claim, &far, 0.0..=0.05);
}

#[test]
fn what_the_poses_do_not_determine_is_as_uncertain_as_datasheets_have_it() {
    let mut random = Random::new(17);
    // One side up, and all around it to 30°.
    let held: Held = |random, _| cap(random, 0.866);
    let (_, poses) = session(&mut random, Kind { poses: 18, held, noise: 0.001, ..KIND });
    let estimate = multi_position(&poses, exact(), AUTO);
    if let Ok(estimate) = estimate {
        for parameter in estimate.assumed.iter() {
            let usual = if matches!(parameter.index(), 3 | 7 | 11) { 0.03 } else { 0.02 };
            let sd = estimate.covariance.sd(parameter);
            assert!((0.4..1.1).contains(&(sd / usual)), "{parameter}: {sd}");
        }
    }
    let (_, poses) = session(&mut random, Kind { poses: 6, ..KIND });
    let six = multi_position(&poses, exact(), AUTO).expect("an answer");
    assert!(!six.assumed.is_empty());
    let (_, poses) = session(&mut random, Kind { poses: 24, ..KIND });
    let many = multi_position(&poses, exact(), AUTO).expect("an answer");
    assert!(many.assumed.is_empty(), "{:?}", many.assumed);
}
