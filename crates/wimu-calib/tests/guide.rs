//! Which pose next: advice, and what it is worth.

use crate::common;

use common::{DrawModel as _, G, Random, cross, exact, jitter, norm, pose, unit};
use wimu_calib::{Guide, Model, Orientation, Pose, multi_position};
use wimu_testkit::{Coverage, figure, trials};

#[test]
fn twelve_guided_poses_predict_unseen_orientations_better_than_twenty_random_ones() {
    // Mean square of |f| − g over unseen orientations, both ways with the same sensor.
    let mut pairs = Vec::new();
    let (mut refused, mut twelve_refused) = (Coverage::default(), Coverage::default());
    let mut twelve_random = Vec::new();
    for seed in 0..trials(1000) as u64 {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let mut guide = Guide::new(Model::Full9);
        let mut plan = Vec::new();
        for remaining in (1..=12).rev() {
            let next = guide.next_of(remaining, |_| true);
            // As a person puts it down.
            let up = next.expect("one can be reached").up();
            let up = common::misplaced(&mut random, up, 0.05);
            guide.take(up);
            plan.push(up);
        }
        let unseen: Vec<Pose> = (0..100).map(|_| pose(&truth, G, random.direction())).collect();
        let mut score = |ups: &[[f64; 3]]| {
            let mut poses: Vec<Pose> = ups.iter().map(|up| pose(&truth, G, *up)).collect();
            for pose in &mut poses {
                jitter(&mut random, pose, 0.003);
            }
            let estimate = multi_position(&poses, exact(), Model::Full9).ok()?;
            let squares = unseen.iter().map(|p| estimate.residual_mps2(p).powi(2));
            Some(squares.sum::<f64>() / 100.0)
        };
        let mut other = Random::new(seed + 5000);
        let twenty: Vec<_> = (0..20).map(|_| other.direction()).collect();
        let guided = score(&plan).expect("guided poses are never refused");
        let square = score(&twenty);
        refused.count(square.is_none());
        pairs.extend(square.map(|square| (guided, square)));
        let square = score(&twenty[..12]);
        twelve_refused.count(square.is_none());
        twelve_random.extend(square);
    }
    let rms = |squares: &mut dyn Iterator<Item = f64>| {
        let (count, sum) = squares.fold((0.0, 0.0), |(n, sum), square| (n + 1.0, sum + square));
        f64::sqrt(sum / count) * 1e3
    };
    let guided = rms(&mut pairs.iter().map(|pair| pair.0));
    let random = rms(&mut pairs.iter().map(|pair| pair.1));
    let better = pairs.iter().filter(|(guided, random)| guided < random).count();
    println!(
        "unseen orientations, mm/s² rms: 12 guided {guided:.3}, 20 random {random:.3}; guided is \
         better with {better} of {} sensors; left out of both: {refused} whose random poses are \
         refused (guided: 0). 12 random: {:.3}, {twelve_refused} refused",
        pairs.len(),
        rms(&mut twelve_random.iter().copied()),
    );
    figure(
        "12 guided poses against 20 random ones, unseen orientations, rms",
        format!("{guided:.2} : {random:.2} mm/s²"),
        "at most 0.96 : 1",
        guided <= 0.96 * random,
    );
    // The mean difference of the squares by its own standard deviation: guided is not worse by chance.
    let differences: Vec<f64> = pairs.iter().map(|(g, r)| g - 0.96 * 0.96 * r).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n * n);
    assert!(mean < 4.0 * variance.sqrt(), "{mean} {}", variance.sqrt());
    refused.assert_can_be(0.0..=0.05, "random poses refused");
}

#[test]
fn advice_ends_when_more_poses_change_little_and_leaves_out_what_cannot_be_reached() {
    let mut guide = Guide::new(Model::Full9);
    let begin = guide.worth(|_| true);
    assert!((12..25).contains(&begin), "{begin}");
    let upright = |o: Orientation| o.up()[2] >= 0.0;
    for _ in 0..begin {
        let next = guide.next(upright).expect("one can be reached");
        assert!(next.up()[2] >= 0.0);
        guide.take(next.up());
    }
    assert!(guide.worth(upright) <= 3);
    assert!(guide.next(|_| false).is_none() && guide.worth(|_| false) == 0);
    guide.take([f64::NAN; 3]);
    guide.take([0.0; 3]);
    assert!(guide.amplification().is_finite());
}

#[test]
fn instructions_name_the_sides_that_are_down() {
    for orientation in Orientation::ALL {
        let text = orientation.instruction().to_string();
        // "stand it on the corner between +X side, −Y side and −Z side"
        let mut up = [0.0; 3];
        for (k, side) in wimu_calib::Face::SIDES.iter().enumerate() {
            if text.contains(side) {
                up[k / 2] = [-1.0, 1.0][k % 2];
            }
        }
        assert!(norm(cross(unit(up), orientation.up())) < 1e-6, "{text}: {up:?}");
        let along: f64 = (0..3).map(|k| up[k] * orientation.up()[k]).sum();
        assert!(along > 0.0, "{text}: {up:?}");
        assert_eq!(Orientation::ALL[orientation.index()], orientation);
    }
    assert_eq!(
        Orientation::from(wimu_calib::Face::XDown).instruction().to_string(),
        "lay it on its +X side (arrow X down)"
    );
    let sides = ["left", "right", "front", "back", "lid", "bottom"];
    assert_eq!(
        Orientation::ALL[25].instruction_with(&sides).to_string(),
        "stand it on the corner between right, back and bottom"
    );
}
