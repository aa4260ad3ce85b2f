//! Sensors whose counts are coarser than their noise.

use crate::common;

use crate::common::DrawModel as _;
use common::{NINE, Random};
use wimu_calib::{
    Face, Gravity, Parameter, Placement, Pose, find_poses, multi_position, six_position,
};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws};

const RATE_HZ: f64 = 100.0;
/// 64 LSB/g.
const STEP_MPS2: f64 = STANDARD_GRAVITY_MPS2 / 64.0;

/// Poses that the finder sees in holds of 3 s, half a second of motion between.
fn held(random: &mut Random, model: &ErrorModel, ups: &[[f64; 3]], noise: f64) -> Vec<Pose> {
    let mut samples = Vec::new();
    for up in ups {
        for k in 0..350 {
            let force = SpecificForceMps2(up.map(|c| c * STANDARD_GRAVITY_MPS2));
            let shaken = if k < 50 { 3.0 } else { 0.0 };
            let output = model.distort(force, None).0.map(|y| {
                let y = y + noise * random.normal() + shaken * random.normal();
                (y / STEP_MPS2).round() * STEP_MPS2
            });
            samples.push((output, None));
        }
    }
    find_poses(samples.iter().copied(), RATE_HZ)
}

#[test]
fn intervals_hold_where_counts_are_coarser_than_the_noise() {
    let mut random = Random::new(5);
    let gravity = Gravity::new(STANDARD_GRAVITY_MPS2, 0.0).expect("gravity");
    let mut all = [Vec::new(), Vec::new()];
    for share_of_step in [0.02, 0.15, 0.4] {
        let noise = share_of_step * STEP_MPS2;
        let mut covered = [Coverage::default(); 2];
        let mut refused = Coverage::default();
        for _ in 0..draws(600, 9) {
            let model = random.model(true);
            let ups: Vec<_> = (0..20).map(|_| random.direction()).collect();
            let poses = held(&mut random, &model, &ups, noise);
            let squared = Face::ALL.map(|face| {
                let mut up = [0.0; 3];
                up[face as usize / 2] = [1.0, -1.0][face as usize % 2];
                up
            });
            let full = random.model(false);
            let sides = held(&mut random, &full, &squared, noise);
            let exact = Placement::new(1e-6).expect("a placement");
            let estimates = [
                (model, multi_position(&poses, gravity, NINE)),
                (full, six_position(&sides, None, gravity, exact)),
            ];
            for (method, (truth, estimate)) in estimates.into_iter().enumerate() {
                refused.count(estimate.is_err());
                let Ok(estimate) = estimate else {
                    continue;
                };
                for parameter in estimate.fitted.iter() {
                    let of = |model: &ErrorModel| {
                        let place = Parameter::ALL.iter().position(|p| *p == parameter);
                        let place = place.expect("one of twelve");
                        let terms = model.terms();
                        match place.checked_sub(3) {
                            None => terms.bias_mps2[place],
                            Some(place) => terms.matrix[place / 3][place % 3],
                        }
                    };
                    let off = of(&estimate.model) - of(&truth);
                    covered[method].count(off.abs() <= estimate.half_width_95(parameter));
                }
            }
        }
        let kind = format!("noise {share_of_step} of a step");
        let [multi, six] = covered;
        println!("{kind}: multi-position {multi}, six-position {six} hold, refused {refused}");
        refused.assert_can_be(0.0..=0.02, &kind);
        multi.assert_can_be(0.93..=0.97, &kind);
        six.assert_can_be(0.93..=1.0, &kind);
        all[0].push(multi);
        all[1].push(six);
    }
    let [multi, six] = all;
    coverage_figure("95 % intervals in coarse counts, multi-position", &multi, 0.93..=0.97);
    coverage_figure("95 % intervals in coarse counts, six-position", &six, 0.93..=0.97);
}
