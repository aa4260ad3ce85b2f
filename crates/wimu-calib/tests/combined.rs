//! Several sessions of simulated sensors: parameters that differ between sessions by a known standard
//! deviation and depend on temperature.

use crate::common;

use common::{DrawModel as _, G, NINE, Random, exact, parameters, pose, ups};
use wimu_calib::{
    Combined, Estimate, Gravity, MultiPosition, Parameter, Placement, Pose, Reason, Refusal, Term,
    Terms, combine, multi_position, six_position,
};
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_testkit::{Coverage, coverage_figure, draws, figure, rms_ratio_can_be, trials};

/// Standard deviation of a pose, m/s².
const NOISE: f64 = 0.003;
/// Parameters of a nine-parameter fit that differ between sessions.
const FITTED: [usize; 9] = [0, 1, 2, 3, 7, 11, 6, 9, 10];

/// A sensor that is switched on anew for each session.
struct Sensor {
    at_25: ErrorModel,
    /// Temperature coefficients of bias and scale factor.
    slopes: [[f64; 3]; 2],
    /// Standard deviations between sessions, of bias, scale factor and misalignment.
    between: [f64; 3],
    random: Random,
}

impl Sensor {
    fn new(seed: u64, between: [f64; 3], slopes: bool) -> Self {
        let mut random = Random::new(seed);
        let at_25 = random.model(true);
        let sd = if slopes { [0.003, 1e-4] } else { [0.0; 2] };
        Self { at_25, slopes: sd.map(|sd| random.normals(sd)), between, random }
    }

    /// Its model in a new session at a temperature.
    fn switched_on(&mut self, celsius: f64) -> ErrorModel {
        let mut terms: ErrorTerms = self.at_25.into();
        let [bias, scale, misalignment] = self.between;
        for axis in 0..3 {
            let dt = celsius - 25.0;
            terms.bias_mps2[axis] += self.slopes[0][axis] * dt + bias * self.random.normal();
            terms.matrix[axis][axis] += self.slopes[1][axis] * dt + scale * self.random.normal();
            for column in 0..axis {
                terms.matrix[axis][column] += misalignment * self.random.normal();
            }
        }
        ErrorModel::new(terms).expect("within bounds")
    }

    fn poses(&mut self, celsius: Option<f64>, gravity: f64) -> Vec<Pose> {
        let model = self.switched_on(celsius.unwrap_or(25.0));
        let ups = ups(&mut self.random, 8);
        let hold = |up| {
            let mut pose = pose(&model, gravity, up);
            common::jitter(&mut self.random, &mut pose, NOISE);
            pose.temperature_c = celsius;
            pose
        };
        ups.into_iter().map(hold).collect()
    }

    fn session(&mut self, celsius: Option<f64>) -> Estimate {
        multi_position(&self.poses(celsius, G), exact(), NINE).expect("an answer")
    }

    /// `count` sessions, evenly over a range of temperatures about 25 °C; without any for 0 K.
    fn sessions(&mut self, count: usize, range_k: f64) -> Vec<Estimate> {
        let step = range_k / (count - 1) as f64;
        let celsius = |k: usize| (range_k > 0.0).then_some(25.0 - 0.5 * range_k + step * k as f64);
        (0..count).map(|k| self.session(celsius(k))).collect()
    }
}

/// Errors of the predicted parameters of a new session in standard deviations.
fn normalised(sensor: &mut Sensor, found: &Combined) -> [f64; 9] {
    let celsius = match found.model.terms().temperature {
        terms if terms.bias_mps2_per_k == [0.0; 3] => 25.0,
        terms => terms.reference_c,
    };
    let truth = parameters(&sensor.switched_on(celsius));
    let predicted = parameters(&found.model);
    FITTED.map(|i| (predicted[i] - truth[i]) / found.covariance.sd(Parameter::ALL[i]))
}

/// Coverage of bias, scale factor and misalignment of a new session, and of the temperature
/// coefficients, by 1.96 standard deviations.
fn coverage(draws: usize, count: usize, between: [f64; 3], range_k: f64) -> [Coverage; 4] {
    let mut held = [Coverage::default(); 4];
    for seed in 0..draws as u64 {
        let mut sensor = Sensor::new(seed, between, range_k > 0.0);
        let sessions = sensor.sessions(count, range_k);
        let found = combine(&sessions, exact()).expect("an answer");
        for (k, error) in normalised(&mut sensor, &found).into_iter().enumerate() {
            held[k / 3].count(error.abs() < 1.96);
        }
        let (terms, sd) = (found.model.terms(), found.term_sd);
        for axis in 0..3 {
            let scale = terms.matrix[axis][axis];
            let bias = terms.temperature.bias_mps2_per_k[axis] - sensor.slopes[0][axis];
            let scale = terms.temperature.scale_per_k[axis] - sensor.slopes[1][axis] / scale;
            held[3].count(bias.abs() <= 1.96 * sd[1][axis]);
            held[3].count(scale.abs() <= 1.96 * sd[2][axis]);
        }
    }
    held
}

/// Standard deviations between sessions that are far larger than those within.
const LARGE: [f64; 3] = [0.03, 3e-3, 3e-3];

#[test]
fn the_covariance_covers_a_new_session() {
    let mut all = Vec::new();
    for (count, range_k) in [(2, 0.0), (3, 0.0), (5, 0.0), (3, 2.0), (3, 30.0), (5, 30.0)] {
        let held = coverage(draws(2000, 3), count, LARGE, range_k);
        let kinds = ["bias", "scale factor", "misalignment", "slopes"];
        // Over 2 K the slopes are those of the prior, wider than these sensors'.
        let used = if range_k > 2.0 { 4 } else { 3 };
        for (kind, held) in kinds.into_iter().zip(held).take(used) {
            let what = format!("{count} sessions over {range_k} K, {kind}");
            println!("{what}: {held}");
            held.assert_can_be(0.93..=0.97, &what);
            all.push(held);
        }
    }
    coverage_figure(
        "95 % intervals of 2, 3 and 5 sessions hold a new session's parameters and the slopes",
        &all,
        0.93..=0.97,
    );
}

#[test]
fn the_covariance_is_not_overconfident_if_sessions_differ_as_little_as_their_noise() {
    for count in [2, 3, 5] {
        // Standard deviations within a session: 1.2 mm/s², 2·10⁻⁴, 3·10⁻⁴.
        for factor in [0.0, 0.5, 1.0, 2.0, 4.0] {
            let between = [0.0012, 2e-4, 3e-4].map(|sd| factor * sd);
            for (kind, held) in (0..3).zip(coverage(draws(500, 3), count, between, 0.0)) {
                println!("{count} sessions, {factor} of the noise, {kind}: {held}");
                held.assert_can_be(0.93..=1.0, "a new session");
            }
        }
    }
}

#[test]
fn equal_sessions_have_a_covariance_of_twice_the_needed_deviation_at_most() {
    for count in [2, 3, 5, 20] {
        let mut square = 0.0;
        let sensors = draws(500, 9);
        for seed in 0..sensors as u64 {
            let mut sensor = Sensor::new(seed, [0.0; 3], false);
            let sessions = sensor.sessions(count, 0.0);
            let found = combine(&sessions, exact()).expect("an answer");
            let errors = normalised(&mut sensor, &found);
            square += errors.iter().map(|e| e * e).sum::<f64>() / 9.0;
        }
        let factor = (sensors as f64 / square).sqrt();
        figure(
            &format!("{count} sessions without a difference: standard deviation over the error"),
            format!("{factor:.2}"),
            "1 to 2",
            (1.0..=2.0).contains(&factor),
        );
        assert!(rms_ratio_can_be(1.0 / factor, 9 * sensors, 0.5..=1.0), "{count} {factor}");
    }
}

#[test]
fn the_standard_deviation_between_sessions_is_estimated_without_bias() {
    let sensors = draws(500, 12);
    let mut ratios = [0.0; 3];
    for seed in 0..sensors as u64 {
        let mut sensor = Sensor::new(seed, LARGE, false);
        let found = combine(&sensor.sessions(5, 0.0), exact()).expect("an answer");
        assert_eq!(found.dof, [12.0; 3]);
        for k in 0..3 {
            ratios[k] += (found.between_sd[k] / LARGE[k]).powi(2) / sensors as f64;
        }
    }
    for ratio in ratios {
        assert!(rms_ratio_can_be(ratio.sqrt(), 12 * sensors, 1.0..=1.0), "{ratios:?}");
    }
}

#[test]
fn an_error_of_gravity_is_common_to_all_sessions() {
    let mut held = Coverage::default();
    for seed in 0..trials(2000) as u64 {
        let mut sensor = Sensor::new(seed, LARGE.map(|sd| 0.3 * sd), false);
        let gravity = Gravity::UNKNOWN_PLACE;
        let local = G + gravity.sd_mps2() * sensor.random.normal();
        let sessions: Vec<Estimate> = (0..5)
            .map(|_| multi_position(&sensor.poses(None, local), exact(), NINE))
            .collect::<Result<_, _>>()
            .expect("an answer");
        let found = combine(&sessions, gravity).expect("an answer");
        for error in &normalised(&mut sensor, &found)[3..6] {
            held.count(error.abs() < 1.96);
        }
    }
    held.assert_can_be(0.93..=0.97, "scale factor with unknown gravity");
}

#[test]
fn sessions_that_do_not_go_together_are_refused() {
    let mut sensor = Sensor::new(1, LARGE, true);
    let sessions = sensor.sessions(3, 30.0);
    let combined = combine(&sessions, exact()).expect("an answer");
    let range = combined.temperature.expect("temperatures");
    assert_eq!([range.lowest_c, range.mean_c, range.highest_c], [10.0, 25.0, 40.0]);
    let have = |have| Reason::TooFew { have, need: 2 };
    let reason = |estimates| combine(estimates, exact()).expect_err("too few").reason;
    assert_eq!(reason(&[]), have(0));
    assert_eq!(reason(&sessions[..1]), have(1));

    let poses = sensor.poses(Some(25.0), G);
    let with = |estimate: Estimate| combine(&[sessions[0].clone(), estimate], exact());
    let sides: Vec<Pose> = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .into_iter()
        .flat_map(|up| [up, up.map(|c: f64| -c)])
        .map(|up| pose(&sensor.at_25, G, up))
        .collect();
    let six = six_position(&sides, None, exact(), Placement::BY_HAND).expect("an answer");
    assert!(matches!(with(six.clone()), Err(Refusal { reason: Reason::Input { index: 1 }, .. })));
    let both = combine(&[six.clone(), six], exact()).expect("twelve parameters");
    assert_eq!((both.dof, both.between_sd), ([3.0, 3.0, 6.0], [0.0; 3]));
    let what =
        MultiPosition { terms: Terms::NONE.with(Term::Quadratic), ..MultiPosition::default() };
    let quadratic = multi_position(&poses, exact(), what).expect("an answer");
    assert!(matches!(with(quadratic), Err(Refusal { reason: Reason::Input { index: 1 }, .. })));
    for gravity in [Gravity::UNKNOWN_PLACE, Gravity::new(9.81, 0.0).expect("gravity")] {
        let other = multi_position(&poses, gravity, NINE).expect("an answer");
        assert!(matches!(with(other), Err(Refusal { reason: Reason::Input { index: 1 }, .. })));
    }
}
