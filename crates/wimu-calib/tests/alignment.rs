//! Alignments with known truth.

use crate::common;

use common::{Random, cross, norm, unit};
use wimu_calib::{KnownDirection, Reason, Refusal, align, straight_move};
use wimu_model::Alignment;
use wimu_testkit::{Coverage, coverage_figure, trials};

fn rotation(random: &mut Random) -> Alignment {
    let [w, x, y, z] = [0; 4].map(|_| random.normal());
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    Alignment::from_quaternion([w, x, y, z].map(|q| q / norm)).expect("a rotation")
}

fn inverse(rotation: Alignment) -> Alignment {
    let [w, x, y, z] = rotation.quaternion();
    Alignment::from_quaternion([w, -x, -y, -z]).expect("a rotation")
}

/// Small rotation from one to the other, about the axes that they lead to.
fn error(found: Alignment, truth: Alignment) -> [f64; 3] {
    let columns =
        |r: Alignment| [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|e| r.rotate(e));
    let mut sum = [0.0; 3];
    for (t, f) in columns(truth).into_iter().zip(columns(found)) {
        let c = cross(t, f);
        for axis in 0..3 {
            sum[axis] += c[axis] / 2.0;
        }
    }
    sum
}

#[test]
fn the_covariance_holds_the_truth_95_percent_of_the_time() {
    let [mut held, mut axes] = [Coverage::default(); 2];
    for seed in 0..trials(2000) as u64 {
        let mut random = Random::new(seed);
        let truth = rotation(&mut random);
        let sds = [0.3_f64, 1.0].map(f64::to_radians);
        let bodies = [[0.0, 0.0, 1.0], unit([1.0, 0.0, 0.4])];
        let known = [0, 1].map(|k| KnownDirection {
            sensor: inverse(truth).rotate(common::misplaced(&mut random, bodies[k], sds[k])),
            body: bodies[k],
            sd_rad: sds[k],
        });
        let found = align(&known).expect("an answer");
        let e = error(found.alignment, truth);
        // Mahalanobis distance by Cholesky: 7.815 is the 95 % point of three degrees of freedom.
        let [l] = found.covariance.factor();
        let l = l.map(f64::from);
        let a = e[0] / l[0];
        let b = (e[1] - l[1] * a) / l[2];
        let c = (e[2] - l[3] * a - l[4] * b) / l[5];
        held.count(a * a + b * b + c * c <= 7.815);
        for axis in 0..3 {
            axes.count(e[axis].abs() <= 1.96 * found.covariance.sd(axis));
        }
    }
    let claim = "95 % ellipsoids of an alignment hold the truth";
    coverage_figure(claim, &[held], 0.93..=0.97);
    held.assert_can_be(0.95..=0.95, "the ellipsoid");
    axes.assert_can_be(0.95..=0.95, "axes");
}

#[test]
fn what_leaves_the_rotation_open_is_refused() {
    let known = |sensor, body| KnownDirection { sensor, body, sd_rad: 0.01 };
    let level = known([0.0, 0.0, 9.8], [0.0, 0.0, 1.0]);
    assert!(matches!(align(&[level]), Err(Refusal { reason: Reason::TooFew { have: 1, .. }, .. })));
    for other in
        [level, known([0.0, 0.0, -9.8], [0.0, 0.0, -1.0]), known([0.5, 0.0, 9.8], [0.05, 0.0, 1.0])]
    {
        let refused = align(&[level, other]);
        assert!(
            matches!(refused, Err(Refusal { reason: Reason::NotObservable, .. })),
            "{refused:?}"
        );
    }
    // 90° in the body, 60° to the sensor.
    let off = known([8.5, 0.0, 4.9], [1.0, 0.0, 0.0]);
    let refused = align(&[level, off]);
    assert!(matches!(refused, Err(Refusal { reason: Reason::PoorFit { .. }, .. })), "{refused:?}");
    for none in [
        known([0.0; 3], [1.0, 0.0, 0.0]),
        known([1.0, 0.0, 0.0], [f64::NAN; 3]),
        KnownDirection { sd_rad: 0.0, ..known([9.8, 0.0, 0.0], [1.0, 0.0, 0.0]) },
    ] {
        assert!(matches!(
            align(&[level, none]),
            Err(Refusal { reason: Reason::Input { index: 1 }, .. })
        ));
    }
}

/// A push of 1 m in 3 s along `ahead`, with gravity and noise, m/s², 100 Hz.
fn push(random: &mut Random, ahead: [f64; 3], up: [f64; 3], crooked: f64) -> Vec<[f64; 3]> {
    (0..300)
        .map(|k| {
            let t = f64::from(k) / 300.0;
            // Least jerk.
            let a = 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / 9.0;
            let side = cross(ahead, up);
            std::array::from_fn(|i| {
                9.81 * up[i]
                    + a * (ahead[i] + crooked * side[i] * (20.0 * t).sin())
                    + 0.02 * random.normal()
            })
        })
        .collect()
}

#[test]
fn a_straight_push_tells_ahead_and_a_crooked_one_is_refused() {
    let (mut worst, mut held) = (0.0_f64, Coverage::default());
    for seed in 0..trials(1000) as u64 {
        let mut random = Random::new(seed);
        let up = random.direction();
        let ahead = unit(cross(up, random.direction()));
        let rest = up.map(|u| 9.81 * u);
        let samples = push(&mut random, ahead, up, 0.0);
        let (found, sd) = straight_move(rest, rest, samples.into_iter(), 100.0).expect("a move");
        let off = norm(cross(found, ahead));
        assert!((0..3).map(|i| found[i] * ahead[i]).sum::<f64>() > 0.9, "the right way round");
        worst = worst.max(off);
        // Two axes across.
        held.count(off <= 2.45 * sd);
        let crooked = push(&mut random, ahead, up, 1.0);
        let refused = straight_move(rest, rest, crooked.into_iter(), 100.0);
        assert!(
            matches!(refused, Err(Refusal { reason: Reason::PoorFit { .. }, .. })),
            "{refused:?}"
        );
    }
    println!("ahead: worst {:.2}°, within 95 %: {held}", worst.to_degrees());
    // Conservative: σ takes shaking as correlated over eight samples, and here it is white noise.
    let claim = "95 % intervals of the direction of a straight move hold (conservative)";
    coverage_figure(claim, &[held], 0.93..=1.0);
    assert!(worst < 0.02, "{worst}");
    held.assert_can_be(0.93..=1.0, "ahead");
    let still =
        straight_move([0.0, 0.0, 9.8], [0.0, 0.0, 9.8], [[0.0, 0.0, 9.8]; 300].into_iter(), 100.0);
    assert!(matches!(still, Err(Refusal { reason: Reason::NotObservable, .. })));
    let empty = straight_move([0.0, 0.0, 9.8], [0.0, 0.0, 9.8], std::iter::empty(), 100.0);
    assert!(matches!(empty, Err(Refusal { reason: Reason::NotObservable, .. })));
}
